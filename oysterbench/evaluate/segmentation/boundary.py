"""The border of a mask."""

from __future__ import annotations

import math

import cv2
import numpy as np
from numpy.typing import NDArray


def boundary_depth(shape: tuple[int, ...], share: float) -> int:
    """Depth of a border in an image (H, W), px: a share of its diagonal, at least 1."""
    return max(1, round(share * math.hypot(*shape)))


def inner_boundary(mask: NDArray[np.bool_], depth: int) -> NDArray[np.bool_]:
    """Pixels of a mask (H, W) with a pixel outside it, or outside the image, at most `depth` px away in x and y.

    Cheng et al. 2021 (Boundary IoU); their code erodes `depth` times by 3 x 3, here once by a square of 2 depth + 1.
    """
    eroded = cv2.erode(
        mask.view(np.uint8),
        np.ones((2 * depth + 1, 2 * depth + 1), np.uint8),
        borderType=cv2.BORDER_CONSTANT,
        borderValue=0.0,
    )
    return np.asarray(mask & (eroded == 0))
