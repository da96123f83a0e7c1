"""Reading of a user's own images and videos: upright, 8 bits, RGB, in bounded memory."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from oysterbench.core.errors import LabelError
from oysterbench.core.pictures import LARGEST_IMAGE_PX, decode_picture, upper_bits
from oysterbench.counting.edits import shown_share
from oysterbench.counting.faults import counts_frames, picture_fault, picture_size, video_fault

# FFmpeg's own messages on a broken file would break up the progress bar; the error is reported in one line here.
os.environ.setdefault("OPENCV_FFMPEG_LOGLEVEL", "-8")

COMPLETE = 0.95
"""Share of the frames, or of the duration, that a video claims to have below which it is truncated: the claim is often
off by a frame or two."""

SHOWN = 0.99
"""Share of a video's duration from which on its edit list counts as showing all of it: many are off by a tick of a
clock, or by a frame."""

PTS = getattr(cv2, "CAP_PROP_PTS", 71)
"""OpenCV's property of a frame's timestamp from the container's start, in frames at the nominal rate; always 0 before
OpenCV 4.11."""

ROUNDING_S = 1e-3
"""Rounding of timestamps, s: some containers have them in whole milliseconds."""
RESTART_S = 1.0
"""Step back of a video's timestamps, s, above which they began again, as where recordings were joined; frames that are
merely out of order step back by less."""


MOST_WIDENING = 4.0
"""Maximum ratio of the sides of a pixel: cameras have at most 2, and more is a mistake in the file."""


@dataclass(frozen=True)
class Sampling:
    """Which frames of a video are used: so many per second, or every N-th if that is given."""

    per_second: float = 1.0
    every: int | None = None


@dataclass(frozen=True)
class VideoFrame:
    """A frame of a video. index: from 0, over all frames of the video; time_s: from its start; pixels: (H, W, 3) uint8
    RGB, square, None if they were not needed; stored_width: px, before they were made square."""

    index: int
    time_s: float
    pixels: NDArray[np.uint8] | None
    stored_width: int | None = None


def decode(data: bytes, where: str) -> NDArray[np.uint8]:
    """Decode an image file to (H, W, 3) uint8 RGB, rotated by its EXIF orientation; grey becomes RGB, alpha is dropped,
    and of more than 8 bits the upper 8 that are used are kept (`upper_bits`). Raises LabelError, starting with `where`,
    for an image that cannot be decoded completely, and for several images in one file."""
    if fault := picture_fault(data):
        raise LabelError(f"{where}: {fault}")
    with _quiet():  # not directly as RGB: for a 16-bit TIFF, OpenCV 5.0 then returns uninitialised memory
        pixels = decode_picture(data, cv2.IMREAD_COLOR | cv2.IMREAD_ANYDEPTH)
    if pixels is None:
        most = f"{LARGEST_IMAGE_PX // 1_000_000} megapixels"
        width, height = picture_size(data) or (0, 0)
        if width * height > LARGEST_IMAGE_PX:
            raise LabelError(f"{where}: expected at most {most}, got {width} x {height} px: cut it into tiles")
        raise LabelError(
            f"{where}: cannot be decoded as an image ({len(data)} bytes): it is damaged, of another format than its "
            f"name says{'' if width else f', or has more than {most} (then cut it into tiles)'}"
        )
    if pixels.dtype not in (np.uint8, np.uint16):
        raise LabelError(f"{where}: expected an image of 8 or 16 bits, got {pixels.dtype}: save it as one of these")
    if pixels.dtype == np.uint16:
        pixels = upper_bits(pixels)
    return np.asarray(cv2.cvtColor(pixels, cv2.COLOR_BGR2RGB), dtype=np.uint8)


@contextmanager
def _quiet() -> Iterator[None]:
    """Silence OpenCV's messages on stderr."""
    before = cv2.utils.logging.getLogLevel()
    cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)
    try:
        yield
    finally:
        cv2.utils.logging.setLogLevel(before)


class Video:
    """A video file. Raises LabelError if it cannot be opened. claimed: number of frames by its header; 0 if unknown.

    Of Matroska and others that store no number of frames, `claimed` is their duration in frames at the nominal rate.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        with _quiet():
            self._capture = cv2.VideoCapture(str(path.absolute()), cv2.CAP_FFMPEG)
        if not self._capture.isOpened():
            raise LabelError(f"{path}: the video cannot be read, none of its frames were: {video_fault(path)}")
        rate = self._capture.get(cv2.CAP_PROP_FPS)
        self.rate_hz = float(rate) if 0 < rate < 10_000 else 0.0
        self.claimed = max(0, int(self._capture.get(cv2.CAP_PROP_FRAME_COUNT)))
        self._counts = counts_frames(path)  # whether `claimed` is a number of frames rather than a duration
        if self._counts and (share := shown_share(path)) < SHOWN:
            # By duration: how many of the frames are hidden depends on their rate there, which may vary.
            self._counts, self.claimed = False, round(self.claimed * share)
        self._widening = _widening(self._capture)
        self._reached = 0.0

    def estimate(self, sampling: Sampling) -> int:
        """Estimate how many frames will be used."""
        step = sampling.every or (self.rate_hz / sampling.per_second if self.rate_hz else 1.0)
        return max(1, round(self.claimed / max(step, 1.0)))

    def frames(self, sampling: Sampling, done: Callable[[int], bool] = lambda index: False) -> Iterator[VideoFrame]:
        """Yield the frames to use, in order; those for whose index `done` is true come without pixels.

        Raises LabelError, after all frames that could be read, if there is none, or the video is truncated.
        """
        index, due_s, step_s = 0, 0.0, 1 / sampling.per_second
        for time_s in self._times_s():
            wanted = index % sampling.every == 0 if sampling.every else time_s >= due_s - ROUNDING_S
            if wanted:
                # What fell due in a gap is not made up for by frames close together behind it.
                due_s = due_s + step_s if due_s + step_s > time_s - ROUNDING_S else time_s + step_s
                pixels, stored_width = (None, None) if done(index) else self._pixels()
                yield VideoFrame(index, time_s, pixels, stored_width)
            index += 1
        self._capture.release()
        if index == 0:
            raise LabelError(
                f"{self.path}: the video cannot be read, none of its frames were: {video_fault(self.path)}"
            )
        if max(index, 0 if self._counts else self._reached) < COMPLETE * self.claimed:
            what = f"{index} of {self.claimed} frames were"
            if not self._counts and self.rate_hz:
                what = f"{self._reached / self.rate_hz:.1f} of {self.claimed / self.rate_hz:.1f} s were"
            raise LabelError(
                f"{self.path}: the video cannot be read to its end: {what}; these are counted; copy it again from the "
                "camera"
            )

    def _times_s(self) -> Iterator[float]:
        """Grab the frames one by one and yield their times, s, by their timestamps or, without one, by the frame rate.
        Where timestamps begin again, time goes on."""
        period_s = 1 / self.rate_hz if self.rate_hz else 0.0
        time_s, offset_s = -period_s, 0.0
        while self._capture.grab():
            # The container's duration, too, is measured from its start, which need not be the first frame.
            self._reached = max(self._reached, self._capture.get(PTS) + 1)
            stamp_s = self._capture.get(cv2.CAP_PROP_POS_MSEC) / 1e3
            if stamp_s <= 0 and self.rate_hz:
                time_s += period_s
            else:
                if stamp_s + offset_s < time_s - RESTART_S:
                    offset_s = time_s + period_s - stamp_s
                time_s = stamp_s + offset_s
            yield time_s

    def _pixels(self) -> tuple[NDArray[np.uint8], int]:
        """Pixels of the frame that was grabbed last, made square, and its width before, px."""
        read, pixels = self._capture.retrieve()
        if not read:
            raise LabelError(f"{self.path}: a frame could not be decoded")
        height, stored_width = pixels.shape[:2]
        if self._widening != 1:
            size = (max(1, round(stored_width * self._widening)), height)
            pixels = cv2.resize(pixels, size, interpolation=cv2.INTER_LINEAR)
        return np.asarray(cv2.cvtColor(pixels, cv2.COLOR_BGR2RGB), dtype=np.uint8), stored_width


def _widening(capture: cv2.VideoCapture) -> float:
    """Factor by which the frames of a video must become wider for square pixels, as players show them."""
    wide, high = capture.get(cv2.CAP_PROP_SAR_NUM), capture.get(cv2.CAP_PROP_SAR_DEN)
    ratio = wide / high if wide > 0 and high > 0 else 1.0
    if not 1 / MOST_WIDENING <= ratio <= MOST_WIDENING:
        return 1.0
    on_its_side = round(capture.get(cv2.CAP_PROP_ORIENTATION_META)) % 180 == 90  # the ratio is that before turning
    return 1 / ratio if on_its_side else ratio
