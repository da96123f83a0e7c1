"""The centre of a lens that is fitted to a camera behind a flat port."""

from __future__ import annotations

import numpy as np

from oysterbench.core.geometry import Array, transform
from oysterbench.sequence.export.ply import rays_at
from oysterbench.sequence.types import CameraCalibration

WORKING_M = (0.5, 2.0)  # of `sensors.port`, between which the given lens is fitted
DISTANCES = 8
GRID = (33, 25)


def lens_centre_m(camera: CameraCalibration) -> float:
    """z, m in the optical frame of a true calibration, of the pinhole through which its rays in water pass best;
    0 without a port.

    That is the centre of the lens which a calibration in water finds: an equidistant one (Kannala-Brandt k1 to k4) that
    misses the pixels of points at several distances least. For a given centre, its coefficients are linear.
    """
    from scipy.optimize import minimize_scalar

    if camera.port_m is None:
        return 0.0
    sizes = zip((camera.width, camera.height), GRID, strict=True)
    columns, rows = np.meshgrid(*(np.linspace(0.0, n - 1.0, k) for n, k in sizes))
    matrix = camera.matrix
    across, down = (columns - matrix[0, 2]) / matrix[0, 0], (rows - matrix[1, 2]) / matrix[1, 1]
    px = matrix[0, 0] * np.hypot(across, down).ravel()
    x, y, crossing = rays_at(camera, columns, rows).reshape(-1, 3).T
    near, far = WORKING_M
    depths = (1 / np.linspace(1 / near, 1 / far, DISTANCES))[:, None]
    off_axis = np.hypot(x, y) * (depths - crossing)
    seen = np.isfinite(off_axis).all(axis=0)
    wanted = np.tile(px[seen], DISTANCES)

    def miss(centre: float) -> float:
        angle = np.arctan2(off_axis[:, seen], depths - centre).ravel()
        powers = angle[:, None] ** np.arange(1, 10, 2)
        return float(np.mean(np.square(powers @ np.linalg.lstsq(powers, wanted)[0] - wanted)))

    return float(
        minimize_scalar(miss, bounds=(-10.0 * camera.port_m, 0.0), method="bounded", options={"xatol": 1e-7}).x
    )


def seen_from(given: CameraCalibration, true: CameraCalibration) -> Array:
    """T_base_cam (4, 4) of the place from which an image that was undistorted with the given lens is truly seen: the
    centre of that lens, which behind a flat port lies behind the pupil, by the true calibration."""
    centre_m = lens_centre_m(true) if given.port_m is None else 0.0
    return true.T_base_cam @ transform(np.eye(3), np.array([0.0, 0.0, centre_m]))
