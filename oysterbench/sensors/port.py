"""What a calibration in the water finds of a camera behind a flat port: a lens in water that comes close to it.

Behind flat glass no two rays share a centre (Treibitz et al. 2012), and the published systems have no such model: their
users take pictures of a target in the water and fit a pinhole with distortion, as here to the refracted rays.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from oysterbench.core.geometry import Array
from oysterbench.recipe import CameraRecipe

WORKING_M = (0.5, 2.0)  # distances along the axis between which a target is shown
DISTANCES = 5  # planes of it, evenly in 1 / distance, as parallax goes
GRID = (25, 19)  # of its corners over the picture
PX_DIGITS, DIGITS = 3, 6  # to which results are rounded, so that a processor's last bits do not show
COEFFICIENT_DIGITS = (5, 4, 3, 2)  # of k1 to k4: those of high orders are determined worse, and stand for less


@dataclass(frozen=True)
class InWater:
    """A lens in water: matrix (3, 3) in px, coefficients of its distortion, and how far before the pupil its centre
    lies on the axis, m. rms_px, worst_px: by how much it misses the refracted rays within WORKING_M."""

    matrix: Array
    distortion: tuple[float, ...]
    axial_m: float
    rms_px: float
    worst_px: float


@lru_cache
def fit_in_water(camera: CameraRecipe) -> InWater:
    """The equidistant lens (Kannala-Brandt k1 to k4) that fits a camera behind a flat port best: least squares in px.

    What a port leaves is a strong pincushion: Brown-Conrady fits it no better, and the usual way to undo that, a fixed
    number of fixed-point steps (cv2.undistortPoints), is tens of pixels off in the corners. The coefficients stand in
    for one another, so that the fit leaves digits of them to a processor's rounding: each is rounded in turn, from k4
    on, and what is left is fitted again, which makes up for it.
    """
    from scipy.optimize import least_squares  # a third of a second, where no camera is behind a port

    from oysterbench.render.lens import distort, pixel_rays

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
