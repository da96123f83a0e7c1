"""Preparation of images for corner detection: removal of veil, uneven contrast and what all images share."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from oysterbench_baselines.gtsam_vi.settings import FrontEndSettings


def without_veil(grey: NDArray[np.uint8], settings: FrontEndSettings) -> NDArray[np.float32]:
    """Subtract from a grey image (H, W) the mean around each pixel: the veil of scattered light, the slow part of
    caustics, and a lamp's cone."""
    mean = cv2.boxFilter(grey, cv2.CV_32F, (settings.veil_px, settings.veil_px))
    return np.subtract(grey, mean, out=mean)


def even_contrast(detail: NDArray[np.float32], settings: FrontEndSettings) -> NDArray[np.uint8]:
    """Give an image (H, W) without its veil the same contrast everywhere: divide it by its own spread in a wider
    surrounding, plus a floor for the sensor's noise."""
    square = cv2.sqrBoxFilter(detail, cv2.CV_32F, (settings.contrast_px, settings.contrast_px))
    # In place, as images do not fit into the processor's cache. OpenCV's running sums may come out slightly negative
    # where all is black.
    spread = np.sqrt(np.maximum(square, 0.0, out=square), out=square)
    spread += settings.contrast_floor_grey
    even = np.asarray(cv2.divide(detail, spread, scale=settings.contrast_grey, dst=spread), dtype=np.float32)
    return np.asarray(cv2.convertScaleAbs(np.maximum(even, -128.0, out=even), beta=128.0), dtype=np.uint8)


class FixedPattern:
    """Pattern that images share however the camera moves: hot pixels, spots on the port, its reflections.

    Corners on it do not move, agree with each other, and suggest that the vehicle is at rest. Whatever in the mean of
    images from different places stands out from its own standard error is taken as fixed.
    """

    def __init__(self, settings: FrontEndSettings) -> None:
        self._settings = settings
        self._count = 0
        self._moved_px = 0.0  # since the last image that was added
        self._mean = self._square = np.zeros((1, 1), dtype=np.float32)
        self._pattern: NDArray[np.float32] | None = None  # (H, W)

    def taken_from(self, detail: NDArray[np.float32]) -> NDArray[np.float32]:
        """Subtract the fixed pattern from an image (H, W) without its veil."""
        return detail if self._pattern is None else detail - self._pattern

    def add(self, detail: NDArray[np.float32], moved_px: float) -> None:
        """Add an image (H, W) without its veil, which has moved by `moved_px` since the last one."""
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
