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

    That is the centre of the lens which a calibration in water finds: whatever the lens, its rays from one centre to
    the points of a pixel at several distances differ least, weighted by how many px a change of direction is.
    """
    from scipy.optimize import minimize_scalar

    if camera.port_m is None:
        return 0.0
    sizes = zip((camera.width, camera.height), GRID, strict=True)
    columns, rows = np.meshgrid(*(np.linspace(0.0, n - 1.0, k) for n, k in sizes))
    x, y, crossing = rays_at(camera, columns, rows).transpose(2, 0, 1)
    slope = np.maximum(np.hypot(x, y), 1e-9)
    outwards = rays_at(camera, columns + x / slope, rows + y / slope)  # by a pixel
    px_per_slope = 1.0 / np.maximum(np.hypot(outwards[..., 0], outwards[..., 1]) - slope, 1e-9)
    near, far = WORKING_M
    depths = (1 / np.linspace(1 / near, 1 / far, DISTANCES))[:, None, None]
    off_axis = slope * (depths - crossing)

    def spread(centre: float) -> float:
        directions = off_axis / (depths - centre) * px_per_slope
        return float(np.nanmean(np.var(directions, axis=0)))

    return float(
        minimize_scalar(spread, bounds=(-5.0 * camera.port_m, 0.0), method="bounded", options={"xatol": 1e-7}).x
    )


def seen_from(given: CameraCalibration, true: CameraCalibration) -> Array:
    """T_base_cam (4, 4) of the place from which an image that was undistorted with the given lens is truly seen: the
    centre of that lens, which behind a flat port lies behind the pupil, by the true calibration."""
    centre_m = lens_centre_m(true) if given.port_m is None else 0.0
    return true.T_base_cam @ transform(np.eye(3), np.array([0.0, 0.0, centre_m]))
