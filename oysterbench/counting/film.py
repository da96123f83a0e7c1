"""Overlays of a video's frames, encoded as a video."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np

from oysterbench.core.errors import OysterbenchError
from oysterbench.core.permissions import umask

LEAST_HZ = 4.0
"""Minimum frame rate at which overlays are shown: one frame per second is too slow to watch."""

CODEC = "mp4v"
"""MPEG-4 Part 2, which OpenCV's wheels encode in 10 ms per frame, and which desktop players support, but browsers do
not. VP9, which browsers support, takes half a second per frame."""


def film_rate(times_s: Sequence[float]) -> float:
    """Frame rate, Hz, of a film of video frames at these times: their mean rate, or `LEAST_HZ` if that is greater."""
    if len(times_s) < 2 or times_s[-1] <= times_s[0]:
        return LEAST_HZ
    return max(LEAST_HZ, (len(times_s) - 1) / (times_s[-1] - times_s[0]))


def write_film(path: Path, frames: Sequence[Path], rate_hz: float) -> None:
    """Write JPEGs of one size as an MP4 file, atomically."""
    path.parent.mkdir(parents=True, exist_ok=True)
    handle, temporary = tempfile.mkstemp(dir=path.parent, prefix=f".{path.stem}.", suffix=".mp4")
    os.close(handle)
    try:
        _encode(temporary, frames, rate_hz)
        os.chmod(temporary, 0o666 & ~umask())
        os.replace(temporary, path)
    except BaseException:
        os.unlink(temporary)
        raise


def _encode(path: str, frames: Sequence[Path], rate_hz: float) -> None:
    writer: cv2.VideoWriter | None = None
    for frame in frames:
        pixels = cv2.imdecode(np.frombuffer(frame.read_bytes(), np.uint8), cv2.IMREAD_COLOR)
        if pixels is None:
            raise OysterbenchError(f"{frame}: cannot be read; `oysterbench segment --again` recreates it")
        pixels = pixels[: pixels.shape[0] // 2 * 2, : pixels.shape[1] // 2 * 2]  # even sides, as chroma is halved
        if writer is None:
            size = (pixels.shape[1], pixels.shape[0])
            writer = cv2.VideoWriter(path, cv2.CAP_FFMPEG, cv2.VideoWriter.fourcc(*CODEC), rate_hz, size)
            if not writer.isOpened():
                raise OysterbenchError(
                    f"a film of {size[0]} x {size[1]} px could not be written by OpenCV {cv2.__version__}"
                )
        writer.write(np.ascontiguousarray(pixels))
    if writer is not None:
        writer.release()
