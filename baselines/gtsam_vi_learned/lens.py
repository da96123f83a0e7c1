"""The true lens of a rendered camera, which the calibration given to methods only approximates."""

from __future__ import annotations

import cv2
import numpy as np

from oysterbench.core.geometry import Array
from oysterbench.sequence.types import CameraCalibration

PORT_ITERATIONS = 8  # for a ray behind a flat port: each leaves a fifth of the error


class TrueLens:
    """A camera's true lens, behind a flat port where there is one.

    A ray leaves the pupil at the angle a to the axis, meets the port at the distance p, and goes on in water at the
    angle w, n sin w = sin a (Snell): at depth z it is r = p tan a + (z - p) tan w off the axis.
    """

    def __init__(self, calibration: CameraCalibration) -> None:
        self.calibration = calibration
        self._lens = cv2.fisheye if calibration.distortion_model == "equidistant" else cv2

    def points(self, pixels: Array, depths: Array) -> Array:
        """Points (N, 3) m in the optical frame of pixels (N, 2) at depths (N,) m along the axis."""
        if not len(pixels):
            return np.zeros((0, 3))
        c = self.calibration
        flat = self._lens.undistortPoints(pixels.reshape(-1, 1, 2), c.matrix, c.distortion).reshape(-1, 2)
        tangent = np.linalg.norm(flat, axis=1)
        share = self._radius(tangent, depths) / np.maximum(tangent, 1e-12)
        return np.column_stack([flat * share[:, None], depths])

    def pixels(self, points: Array) -> Array:
        """Pixels (N, 2) of points (N, 3) m in the optical frame, in front of the camera."""
        if not len(points):
            return np.zeros((0, 2))
        c, depths = self.calibration, np.maximum(points[:, 2], 0.02)
        radius = np.linalg.norm(points[:, :2], axis=1)
        tangent = radius / depths
        for _ in range(PORT_ITERATIONS if c.port_m is not None else 0):
            tangent = tangent * radius / np.maximum(self._radius(tangent, depths), 1e-12)
        flat = points[:, :2] * (tangent / np.maximum(radius, 1e-12))[:, None]
        rays = np.column_stack([flat, np.ones(len(flat))]).reshape(-1, 1, 3)
        found, _ = self._lens.projectPoints(rays, np.zeros(3), np.zeros(3), c.matrix, c.distortion)
        return np.asarray(found.reshape(-1, 2), dtype=float)

    def _radius(self, tangent: Array, depths: Array) -> Array:
        """Distances (N,) m off the axis, at depths (N,), of rays that leave the pupil at angles of tangents (N,)."""
        c = self.calibration
        if c.port_m is None:
            return tangent * depths
        sine = tangent / np.sqrt(1 + tangent**2) / c.port_index
        return np.asarray(c.port_m * tangent + (depths - c.port_m) * sine / np.sqrt(1 - sine**2), dtype=float)
