"""Copies: files of the same bytes, and the same image in two formats, such as a PNG also saved as JPEG."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

SIDE = 32
"""Side of the grey thumbnails that are compared, px."""
MOST_DIFFERENCE = 0.12
"""Maximum root mean square difference of two thumbnails, in grey levels of 255, at which two formats hold the same
image. Measured between PNG and JPEG 90: at most 0.054 on frames of slam-mini (640 x 480), 0.062 on 40 photos of oysters
(416 x 416), and 0.104 there at JPEG 85. Between frames of slam-mini while the vehicle is at rest, where only the light
of waves and noise differ, at least 0.25 at 10 Hz and 0.157 at 20 Hz; between neighbouring photos of a reef 2.7."""
LEAST_CONTRAST = 1.0
"""Standard deviation of a thumbnail, in grey levels, below which all images look the same, as in the dark."""
SAME = {".jpeg": ".jpg", ".tiff": ".tif"}


def thumbnail(pixels: NDArray[np.uint8]) -> NDArray[np.float32]:
    """Thumbnail (SIDE, SIDE) of an image (H, W, 3) RGB: mean grey levels."""
    grey = cv2.cvtColor(pixels, cv2.COLOR_RGB2GRAY)
    return np.asarray(cv2.resize(grey.astype(np.float32), (SIDE, SIDE), interpolation=cv2.INTER_AREA), np.float32)


class Copies:
    """Detector of copies among images and videos as they are read. found: names of files, each with that of the earlier
    one of which it is a copy.

    Content is compared only between images of the same size in different formats: frames of a nearly static video may
    differ by less than a low-quality JPEG from its original, and are all in one format.
    """

    def __init__(self) -> None:
        self.found: list[tuple[str, str]] = []
        self._bytes: dict[str, str] = {}  # digest -> name
        self._shown: dict[tuple[int, int, int], list[tuple[str, str, NDArray[np.float32]]]] = {}

    def bytes_of(self, name: str, digest: str) -> bool:
        """Check a file by the SHA-256 of its bytes, and return whether an earlier one had the same."""
        first = self._bytes.setdefault(digest, name)
        if first != name:
            self.found.append((name, first))
        return first != name

    def picture(self, name: str, path: Path, size: tuple[int, int], small: NDArray[np.float32]) -> None:
        """Check an image by its content. size: height and width in px; small: its `thumbnail`"""
        if small.std() < LEAST_CONTRAST:
            return
        suffix = path.suffix.lower()
        form = SAME.get(suffix, suffix)
        # The RMS difference of two thumbnails is at least that of their means: only bins of similar mean can match.
        step = int(small.mean() / MOST_DIFFERENCE)
        near = (one for k in (step - 1, step, step + 1) for one in self._shown.get((*size, k), ()))
        for first, other, shown in near:
            if other != form and np.sqrt(np.mean((small - shown) ** 2)) <= MOST_DIFFERENCE:
                self.found.append((name, first))
                return
        self._shown.setdefault((*size, step), []).append((name, form, small))
