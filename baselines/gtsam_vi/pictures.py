"""Pictures as corners are looked for in them: veil, uneven contrast and what all of them share taken away."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from oysterbench_baselines.gtsam_vi.settings import FrontEndSettings


def without_veil(grey: NDArray[np.uint8], settings: FrontEndSettings) -> NDArray[np.float32]:
    """A grey picture (H, W) less the mean around each pixel: the veil of scattered light, the slower part of caustics,
    and a lamp's cone."""
    picture = grey.astype(np.float32)
    picture -= cv2.blur(picture, (settings.veil_px, settings.veil_px))
    return picture


def even_contrast(detail: NDArray[np.float32], settings: FrontEndSettings) -> NDArray[np.uint8]:
    """A picture (H, W) without its veil, with the same contrast everywhere: divided by its own spread in a wider
    surrounding, and by no less than the sensor's noise."""
    square = cv2.sqrBoxFilter(detail, cv2.CV_32F, (settings.contrast_px, settings.contrast_px))
    # In place, as pictures do not fit into the processor's cache. Its running sums leave a little less than nothing
    # where all is black.
    spread = np.sqrt(np.maximum(square, 0.0, out=square), out=square)
    spread += settings.contrast_floor_grey
    even = settings.contrast_grey * detail
    even /= spread
    even += 128
    return np.asarray(cv2.convertScaleAbs(np.maximum(even, 0.0, out=even)), dtype=np.uint8)


class FixedPattern:
    """What pictures share however the camera moves: hot pixels, spots on the port, its reflections.

    Corners on them do not move, agree with each other, and say that the vehicle is at rest. Taken as fixed is what the
    mean of pictures from different places has beyond its own standard error.
    """

    def __init__(self, settings: FrontEndSettings) -> None:
        self._settings = settings
        self._count = 0
        self._moved_px = 0.0  # since the last picture that was added
        self._mean = self._square = np.zeros((1, 1), dtype=np.float32)
        self._pattern: NDArray[np.float32] | None = None  # (H, W)

    def taken_from(self, detail: NDArray[np.float32]) -> NDArray[np.float32]:
        """A picture (H, W) without its veil, without what is fixed as well."""
        return detail if self._pattern is None else detail - self._pattern

    def add(self, detail: NDArray[np.float32], moved_px: float) -> None:
        """A picture (H, W) without its veil, in which all has moved by so much since the last one."""
        limits = self._settings
        self._moved_px += moved_px
        if self._moved_px < limits.pattern_step_px and self._count:
            return
        self._moved_px = 0.0
        self._count += 1
        share = 1.0 / min(self._count, limits.pattern_pictures)
        change = detail - self._mean
        change *= share
        self._mean = self._mean + change
        change = detail * detail
        change -= self._square
        change *= share
        self._square = self._square + change
        if self._count < limits.pattern_pictures // 2:
            return
        error = self._mean * self._mean
        np.maximum(np.subtract(self._square, error, out=error), 0.0, out=error)
        error *= share
        np.sqrt(error, out=error)
        error *= limits.pattern_sigmas
        self._pattern = np.where(np.abs(self._mean) > error, self._mean, 0.0)
