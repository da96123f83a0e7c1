"""Pixels to rays and back, through lens and flat port."""

from __future__ import annotations

import cv2
import numpy as np

from oysterbench.core.geometry import Array
from oysterbench.core.lens import undistort
from oysterbench.sequence.types import CameraCalibration


class Lens:
    """Lens of one camera. Rays are (N, 2) normalised coordinates x / z, y / z in the water.

    A flat port bends the rays by Snell's law, sin(air) = n sin(water). That they then seem to come from points along
    the axis instead of one pupil is ignored: the shift is a fraction of the distance to the port, millimetres.
    """

    def __init__(self, calibration: CameraCalibration) -> None:
        self.calibration = calibration
        self.index = calibration.port_index if calibration.port_m is not None else 1.0
        self.focal_px = float(calibration.matrix[0, 0] + calibration.matrix[1, 1]) / 2 * self.index

    def rays(self, pixels: Array) -> Array:
        """Rays (N, 2) of pixels (N, 2)."""
        if len(pixels) == 0:
            return np.empty((0, 2))
        known = self.calibration
        rays = undistort(pixels, known.matrix, known.distortion, known.distortion_model == "equidistant")
        return self._bent(rays, 1 / self.index)

    def pixels(self, rays: Array) -> Array:
        """Pixels (N, 2) of rays (N, 2)."""
        if len(rays) == 0:
            return np.empty((0, 2))
        known, air = self.calibration, self._bent(rays, self.index)
        if known.distortion_model == "equidistant":
            pixels = cv2.fisheye.distortPoints(air.reshape(-1, 1, 2), known.matrix, known.distortion[:4])
        else:
            points = np.column_stack([air, np.ones(len(air))]).reshape(-1, 1, 3)
            pixels, _ = cv2.projectPoints(points, np.zeros(3), np.zeros(3), known.matrix, known.distortion)
        return np.asarray(pixels, dtype=np.float64).reshape(-1, 2)

    @staticmethod
    def _bent(rays: Array, factor: float) -> Array:
        """Rays whose sine to the axis is `factor` times as great; at grazing angles no more than 0.99."""
        if factor == 1.0:
            return rays
        radius = np.linalg.norm(rays, axis=1, keepdims=True)
        sine = np.minimum(factor * radius / np.hypot(radius, 1.0), 0.99)
        return np.asarray(rays * (sine / np.sqrt(1 - sine**2)) / np.maximum(radius, 1e-12))
