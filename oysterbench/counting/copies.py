"""One picture under two names: files of the same bytes, and a picture in two formats, as when PNG was saved as JPEG."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

SIDE = 32
"""px, of the small grey pictures that are compared."""
MOST_DIFFERENCE = 0.12
"""Grey levels of 255, root mean square over the small pictures, up to which two formats hold one picture. Measured
between PNG and JPEG 90: 0.054 at most on frames of slam-mini (640 x 480), 0.062 on 40 photos of oysters (416 x 416),
and 0.104 there at JPEG 85. Between frames of slam-mini while the vehicle is at rest, where the light of waves and noise
alone differ, 0.25 at least at 10 Hz and 0.157 at 20 Hz; between neighbouring photos of a reef 2.7."""
LEAST_CONTRAST = 1.0
"""Grey levels, standard deviation of a small picture, below which all pictures look the same, as in the dark."""
SAME = {".jpeg": ".jpg", ".tiff": ".tif"}


def thumbnail(pixels: NDArray[np.uint8]) -> NDArray[np.float32]:
    """(SIDE, SIDE) mean grey levels of a picture (H, W, 3) RGB."""
    grey = cv2.cvtColor(pixels, cv2.COLOR_RGB2GRAY)
    return np.asarray(cv2.resize(grey.astype(np.float32), (SIDE, SIDE), interpolation=cv2.INTER_AREA), np.float32)


class Copies:
    """Of pictures and videos as they are read. found: names of files, each with that of an earlier one that is it.

    Only pictures of one size in different formats are compared by what they show: frames of a video that hardly moves
    differ by less than a JPEG of low quality from its original, and are of one format.
    """

    def __init__(self) -> None:
        self.found: list[tuple[str, str]] = []
        self._bytes: dict[str, str] = {}  # digest -> name
        self._shown: dict[tuple[int, int, int], list[tuple[str, str, NDArray[np.float32]]]] = {}

    def bytes_of(self, name: str, digest: str) -> bool:
        """Look at a file by the SHA-256 of its bytes; whether an earlier one had the same."""
        first = self._bytes.setdefault(digest, name)
        if first != name:
            self.found.append((name, first))
        return first != name

    def picture(self, name: str, path: Path, size: tuple[int, int], small: NDArray[np.float32]) -> None:
        """Look at a picture by what it shows. size: height and width in px; small: its `thumbnail`"""
        if small.std() < LEAST_CONTRAST:
            return
        suffix = path.suffix.lower()
        form = SAME.get(suffix, suffix)
        # No two small pictures differ by less than their means do: others need not be looked at.
        step = int(small.mean() / MOST_DIFFERENCE)
        near = (one for k in (step - 1, step, step + 1) for one in self._shown.get((*size, k), ()))
        for first, other, shown in near:
            if other != form and np.sqrt(np.mean((small - shown) ** 2)) <= MOST_DIFFERENCE:
                self.found.append((name, first))
                return
        self._shown.setdefault((*size, step), []).append((name, form, small))
