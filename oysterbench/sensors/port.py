"""Calibration in water of a camera behind a flat port: the lens in water that approximates it best.

Behind flat glass rays do not share a centre (Treibitz et al. 2012), and the published systems have no model for that:
their users take images of a target in the water and fit a pinhole with distortion, as is done here to refracted rays.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from oysterbench.core.geometry import Array
from oysterbench.recipe import CameraRecipe

WORKING_M = (0.5, 2.0)  # range of distances along the axis at which a target is shown
DISTANCES = 5  # planes of the target, evenly spaced in 1 / distance, as parallax is
GRID = (25, 19)  # corners of the target over the image
PX_DIGITS, DIGITS = 3, 6  # to which results are rounded, so that a processor's last bits do not show
COEFFICIENT_DIGITS = (5, 4, 3, 2)  # of k1 to k4: high orders are less well determined, and have less effect


@dataclass(frozen=True)
class InWater:
    """A lens in water: matrix (3, 3) in px, distortion coefficients, and distance of its centre in front of the pupil
    along the axis, m. rms_px, worst_px: residuals to the refracted rays within WORKING_M."""

    matrix: Array
    distortion: tuple[float, ...]
    axial_m: float
    rms_px: float
    worst_px: float


@lru_cache
def fit_in_water(camera: CameraRecipe) -> InWater:
    """Fit an equidistant lens (Kannala-Brandt k1 to k4) to a camera behind a flat port: least squares in px.

    A port leaves a strong pincushion distortion: Brown-Conrady fits it no better, and the usual way to invert that
    model, a fixed number of fixed-point iterations (cv2.undistortPoints), is tens of pixels off in the corners. The
    coefficients are correlated, so their last digits would depend on the processor's rounding: they are rounded one by
    one, from k4 down, and the remaining parameters are fitted again to compensate.
    """
    from scipy.optimize import least_squares  # a third of a second, where no camera is behind a port

    from oysterbench.recipe.lens import distort
    from oysterbench.render.lens import pixel_rays

    columns, rows = np.meshgrid(*(np.linspace(0, n - 1, k) for n, k in zip(_size(camera), GRID, strict=True)))
    columns, rows = np.rint(columns).astype(int).ravel(), np.rint(rows).astype(int).ravel()
    rays = pixel_rays(camera)[rows + 1, columns + 1].astype(float)
    near, far = WORKING_M
    z = (1 / np.linspace(1 / near, 1 / far, DISTANCES))[:, None]
    x, y = rays[:, 0] * (z - rays[:, 2]), rays[:, 1] * (z - rays[:, 2])
    pixels = np.broadcast_to(np.stack([columns, rows], axis=-1), (DISTANCES, len(rows), 2))
    focal = camera.width / 2 / np.tan(np.radians(camera.hfov_deg) / 2)

    def miss(free: Array, *known: float) -> Array:
        parameters = np.concatenate([free, known])
        fx, fy, cx, cy, axial = parameters[:5] * [focal, focal, focal, focal, 0.01]
        points = np.stack([x / (z - axial), y / (z - axial)], axis=-1).reshape(-1, 2)
        bent = distort(points, dataclasses.replace(camera, lens="fisheye", distortion=tuple(parameters[5:])))
        found = bent * [fx, fy] + [cx, cy]
        return np.asarray((found.reshape(pixels.shape) - pixels).ravel())

    middle = [(n - 1) / 2 / focal for n in _size(camera)]
    start = np.array([1.0, 1.0, *middle, 0.0, *np.zeros(4)])
    known: tuple[float, ...] = ()
    for digits in (*reversed(COEFFICIENT_DIGITS), None):
        found = least_squares(miss, start, args=known, method="lm", xtol=1e-14, ftol=1e-14, gtol=1e-14)
        if digits is not None:
            start, known = found.x[:-1], (float(np.round(found.x[-1], digits)), *known)
    apart = np.hypot(*found.fun.reshape(-1, 2).T)
    fx, fy, cx, cy = np.round(found.x[:4] * focal, PX_DIGITS)
    return InWater(
        np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]]),
        known,
        float(np.round(found.x[4] * 0.01, DIGITS)),
        float(np.round(np.sqrt(np.mean(apart**2)), 4)),
        float(np.round(apart.max(), 4)),
    )


def _size(camera: CameraRecipe) -> tuple[int, int]:
    return camera.width, camera.height
