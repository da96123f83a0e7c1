"""The border of a mask."""

from __future__ import annotations

import math

import cv2
import numpy as np
from numpy.typing import NDArray


def boundary_depth(shape: tuple[int, ...], share: float) -> int:
    """How many pixels deep a border is in an image (H, W): a share of its diagonal, one at least."""
    return max(1, round(share * math.hypot(*shape)))


def inner_boundary(mask: NDArray[np.bool_], depth: int) -> NDArray[np.bool_]:
    """Pixels of a mask (H, W) that a pixel outside it, or outside the image, is near: at most `depth` off in x and y.

    Cheng et al. 2021 (Boundary IoU), whose program erodes `depth` times by 3 x 3; a square of 2 depth + 1 does it once.
    """
    eroded = cv2.erode(
        mask.view(np.uint8),
        np.ones((2 * depth + 1, 2 * depth + 1), np.uint8),
        borderType=cv2.BORDER_CONSTANT,
        borderValue=0.0,
    )
    return np.asarray(mask & (eroded == 0))
