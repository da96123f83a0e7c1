"""Connected parts of a mask, each taken for an oyster if a method does not separate oysters."""

from __future__ import annotations

import math
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

SHORTEST_MM = 25.0
"""Shell height of the smallest of 1122 oysters measured in Virginia (24.9 mm), and of those on rendered reefs."""

NARROWNESS = 2 / 3
"""Ratio of a shell's length to its height (Galtsoff 1964, ch. 2)."""

WIDEST_MM = 1650.0
"""Width of the bottom assumed to be in an image of unknown scale: from 1.2 m above, as high as surveys go, with a field
of view of 69 degrees under water."""


def connected_parts(
    mask: NDArray[np.bool_], probability: NDArray[np.floating[Any]] | None = None
) -> tuple[NDArray[np.int32], NDArray[np.float64] | None]:
    """Number the parts of a mask (H, W) that are connected by edges or corners. Returns their numbers (H, W), from 1,
    and the mean probability (N,) over each part; None without probabilities (H, W)."""
    count, labels = cv2.connectedComponents(np.ascontiguousarray(mask).view(np.uint8), connectivity=8)
    numbers = np.asarray(labels, np.int32)
    if probability is None:
        return numbers, None
    flat = numbers.ravel()
    sums = np.bincount(flat, weights=probability.ravel(), minlength=count)
    return numbers, (sums / np.maximum(np.bincount(flat, minlength=count), 1))[1:]


def without_specks(numbers: NDArray[np.int32]) -> NDArray[np.int32]:
    """Set the numbers (H, W) of parts with fewer pixels than the smallest oyster (`speck_px`) to 0."""
    areas = np.bincount(numbers.ravel())
    return np.where(areas[numbers] < speck_px(numbers.shape), 0, numbers).astype(np.int32)


def speck_px(shape: tuple[int, ...]) -> float:
    """Area in px of the smallest oyster in an image (H, W) that shows `WIDEST_MM` along its longer side."""
    area_mm2 = math.pi / 4 * SHORTEST_MM * (NARROWNESS * SHORTEST_MM)
    return area_mm2 * (max(shape) / WIDEST_MM) ** 2
