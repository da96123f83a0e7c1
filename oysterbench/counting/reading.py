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
    16 bits are divided by 256. Raises LabelError, beginning with `where`, for what cannot be decoded as a whole."""
    if not data:
        raise LabelError(f"{where}: empty file")
    if cut := _cut_short(data):
        raise LabelError(f"{where}: {cut}: copy it again from the camera")
    pixels = decode_picture(data, cv2.IMREAD_COLOR_RGB)
    if pixels is None:
        raise LabelError(
            f"{where}: cannot be decoded as a picture ({len(data)} bytes), or has more than "
            f"{LARGEST_IMAGE_PX // 1_000_000} megapixels: cut larger images into tiles"
        )
    return np.asarray(pixels, dtype=np.uint8)


def _cut_short(data: bytes) -> str:
    """Why a JPEG or PNG is no whole file; decoders fill in the rest in grey, without a word."""
    if data.startswith(b"\xff\xd8") and not _jpeg_ends(data):
        return "the JPEG is damaged or ends before its end marker"
    if data.startswith(b"\x89PNG") and b"IEND" not in data[-64:]:
        return "the PNG ends before its end marker"
    return ""


def _jpeg_ends(data: bytes) -> bool:
    """Whether an end marker follows the first scan. Before it there may be that of a thumbnail, and behind it what
    cameras append, so that it need not be the end of the file."""
    at = 2
    while at + 4 <= len(data) and data[at] == 0xFF:
        kind = data[at + 1]
        if kind == 0xFF:  # fill
            at += 1
            continue
        at += 2 + int.from_bytes(data[at + 2 : at + 4], "big")
        if kind == 0xDA:
            return data.find(b"\xff\xd9", at) >= 0
    return False


@contextmanager
def _quiet() -> Iterator[None]:
    """OpenCV without its warnings on stderr."""
    before = cv2.utils.logging.getLogLevel()
    cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_ERROR)
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
            raise LabelError(f"{path}: the video cannot be read, none of its frames were: {_why_unreadable(path)}")
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
                f"{self.path}: the video cannot be read, none of its frames were: {_why_unreadable(self.path)}"
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


def _why_unreadable(path: Path) -> str:
    size = path.stat().st_size
    if size == 0:
        return "empty file"
    kinds = _boxes(path, size)
    if "ftyp" in kinds and "moov" not in kinds:
        return (
            f"it ends before its index (moov) after {size} bytes, as a recording or copy that was cut short: copy it "
            "again from the camera, or have a repair program rebuild the index"
        )
    return f"{size} bytes of no known video format, or of one that is damaged: copy it again from the camera"


def _boxes(path: Path, size: int) -> list[str]:
    """Kinds of the whole outermost boxes of an MP4 or MOV (ISO 14496-12, 4.2); those of another file mean nothing."""
    kinds, at = [], 0
    with open(path, "rb") as file:
        while at + 8 <= size:
            file.seek(at)
            head = file.read(16)
            length = int.from_bytes(head[:4], "big")
            length = int.from_bytes(head[8:], "big") if length == 1 else length
            length = length or size - at  # 0: to the end of the file
            if length < 8 or at + length > size:
                break
            kinds.append(head[4:8].decode("latin-1"))
            at += length
    return kinds
