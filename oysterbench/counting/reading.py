"""Pixels of people's own pictures and videos: upright, 8 bits, RGB, in bounded memory."""

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
from oysterbench.core.pictures import LARGEST_IMAGE_PX, decode_picture
from oysterbench.counting.faults import picture_fault, video_fault

# What FFmpeg says of a broken file on its own goes between the lines of a progress bar; it is said in one line here.
os.environ.setdefault("OPENCV_FFMPEG_LOGLEVEL", "-8")

COMPLETE = 0.95
"""Share of the frames that a video claims to have, below which it is called cut short: the claim is often a frame or
two off."""


@dataclass(frozen=True)
class Sampling:
    """Which frames of a video are looked at: so many a second, or, where it is given, every N-th."""

    per_second: float = 1.0
    every: int | None = None


@dataclass(frozen=True)
class VideoFrame:
    """index: from 0, over all frames of the video; time_s: from its begin; pixels: (H, W, 3) uint8 RGB, None where they
    were not wanted."""

    index: int
    time_s: float
    pixels: NDArray[np.uint8] | None


def decode(data: bytes, where: str) -> NDArray[np.uint8]:
    """(H, W, 3) uint8 RGB of an image file, turned as its EXIF orientation says; grey becomes RGB, alpha is left out,
    and of more than 8 bits the upper 8 that are used remain (`used_bits`). Raises LabelError, beginning with `where`,
    for what cannot be decoded as a whole, and for several images in one file."""
    if fault := picture_fault(data):
        raise LabelError(f"{where}: {fault}")
    with _quiet():  # not as RGB at once: of a TIFF with 16 bits OpenCV 5.0 then leaves the memory as it was
        pixels = decode_picture(data, cv2.IMREAD_COLOR | cv2.IMREAD_ANYDEPTH)
    if pixels is None:
        raise LabelError(
            f"{where}: cannot be decoded as an image ({len(data)} bytes): it is damaged, of another format than its "
            f"name says, or has more than {LARGEST_IMAGE_PX // 1_000_000} megapixels (then cut it into tiles)"
        )
    if pixels.dtype not in (np.uint8, np.uint16):
        raise LabelError(f"{where}: expected an image of 8 or 16 bits, got {pixels.dtype}: save it as one of these")
    if pixels.dtype == np.uint16:
        pixels = (pixels >> (used_bits(pixels) - 8)).astype(np.uint8)
    return np.asarray(cv2.cvtColor(pixels, cv2.COLOR_BGR2RGB), dtype=np.uint8)


def used_bits(pixels: NDArray[np.uint16]) -> int:
    """Bits that the numbers of an image use: 8, or what cameras have, kept in 16: 10, 12, 14 or 16. Taken for 16, those
    of 12 would be almost black.

    >>> used_bits(np.array([0, 4095], np.uint16)), used_bits(np.array([0, 255], np.uint16))
    (12, 8)
    """
    bits = int(pixels.max(initial=0)).bit_length()
    return max(8, bits + bits % 2)


@contextmanager
def _quiet() -> Iterator[None]:
    """OpenCV without what it writes on stderr."""
    before = cv2.utils.logging.getLogLevel()
    cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)
    try:
        yield
    finally:
        cv2.utils.logging.setLogLevel(before)


class Video:
    """A video file. Raises LabelError where it cannot be opened. claimed: frames, as its head says; 0 where not."""

    def __init__(self, path: Path) -> None:
        self.path = path
        with _quiet():
            self._capture = cv2.VideoCapture(str(path.absolute()), cv2.CAP_FFMPEG)
        if not self._capture.isOpened():
            raise LabelError(f"{path}: the video cannot be read, none of its frames were: {video_fault(path)}")
        rate = self._capture.get(cv2.CAP_PROP_FPS)
        self.rate_hz = float(rate) if 0 < rate < 10_000 else 0.0
        self.claimed = max(0, int(self._capture.get(cv2.CAP_PROP_FRAME_COUNT)))

    def estimate(self, sampling: Sampling) -> int:
        """About how many frames will be looked at."""
        step = sampling.every or (self.rate_hz / sampling.per_second if self.rate_hz else 1.0)
        return max(1, round(self.claimed / max(step, 1.0)))

    def frames(self, sampling: Sampling, done: Callable[[int], bool] = lambda index: False) -> Iterator[VideoFrame]:
        """The frames that are looked at, in order; those that are done, by their index, without their pixels.

        Raises LabelError, after all that could be read, where there is no frame, or the video breaks off.
        """
        index, due_s = 0, 0.0
        while self._capture.grab():
            time_s = self._time_s(index)
            wanted = index % sampling.every == 0 if sampling.every else time_s >= due_s - 1e-6
            if wanted:
                due_s = max(due_s + 1 / sampling.per_second, time_s)
                yield VideoFrame(index, time_s, None if done(index) else self._pixels())
            index += 1
        self._capture.release()
        if index == 0:
            raise LabelError(
                f"{self.path}: the video cannot be read, none of its frames were: {video_fault(self.path)}"
            )
        if index < COMPLETE * self.claimed:
            raise LabelError(
                f"{self.path}: the video cannot be read to its end: {index} of {self.claimed} frames were; these are "
                "counted; copy it again from the camera"
            )

    def _time_s(self, index: int) -> float:
        """Of the frame that was grabbed last; by the rate, where the file has no stamps."""
        stamp_s = self._capture.get(cv2.CAP_PROP_POS_MSEC) / 1e3
        return stamp_s if stamp_s > 0 or not self.rate_hz else index / self.rate_hz

    def _pixels(self) -> NDArray[np.uint8]:
        read, pixels = self._capture.retrieve()
        if not read:
            raise LabelError(f"{self.path}: a frame could not be decoded")
        return np.asarray(cv2.cvtColor(pixels, cv2.COLOR_BGR2RGB), dtype=np.uint8)
