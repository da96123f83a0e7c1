"""Pixels to rays through a lens without its inverse in closed form."""

from __future__ import annotations

import cv2
import numpy as np

from oysterbench.core.geometry import Array

CONVERGED = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 100, 1e-9)
"""At most 100 iterations, until a pixel is met to 1e-9 px. By default OpenCV takes 5, which leaves half a pixel at the
edges of EuRoC's images, and three pixels in the corners of a wide webcam."""


def undistort(pixels: Array, matrix: Array, distortion: Array, equidistant: bool = False) -> Array:
    """Normalised coordinates (N, 2), x / z and y / z, of pixels (N, 2) of a camera (3, 3) with a Brown-Conrady lens, or
    an equidistant one (Kannala-Brandt)."""
    if not len(pixels):
        return np.empty((0, 2))
    points = np.ascontiguousarray(pixels, dtype=np.float64).reshape(-1, 1, 2)
    if equidistant:
        found = cv2.fisheye.undistortPoints(points, matrix, distortion[:4])
    elif hasattr(cv2, "undistortPointsIter"):  # OpenCV 4
        found = cv2.undistortPointsIter(points, matrix, distortion, np.eye(3), np.eye(3), CONVERGED)
    else:
        found = cv2.undistortPoints(points, matrix, distortion, criteria=CONVERGED)
    return np.asarray(found, dtype=float).reshape(-1, 2)
