"""Lens models: from a pixel to a ray and back, for pinhole, Brown-Conrady and fisheye, also behind a flat port.

Conventions and coefficients are those of OpenCV (`cv2.projectPoints`, `cv2.fisheye.projectPoints`).
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from oysterbench.core.geometry import Array
from oysterbench.recipe import CameraRecipe
from oysterbench.recipe.lens import PORT_INDEX, distort, undistort
from oysterbench.scene.rig import camera_matrix

PORT_STEPS = 8  # of Newton's method, through a port: converges to 1e-12, even for points that almost touch the glass
RAY_STEP = 2.0**-24  # rays are rounded to this, so that the last bits of a processor's mathematics do not show


@lru_cache(maxsize=4)
def pixel_rays(camera: CameraRecipe) -> NDArray[np.float32]:
    """Rays (H + 2, W + 2, 3) float32 in water through the pixels' centres and a border of one pixel; read-only, as they
    are cached.

    x and y at z = 1 in the optical frame, and z at which the ray meets the optical axis: 0 except behind a flat port
    (Snell's law; the port is thin), where every ray has its own centre (Treibitz et al. 2012).
    """
    columns, rows = np.meshgrid(np.arange(-1, camera.width + 1), np.arange(-1, camera.height + 1))
    matrix = camera_matrix(camera)
    images = np.stack([(columns - matrix[0, 2]) / matrix[0, 0], (rows - matrix[1, 2]) / matrix[1, 1]], axis=-1)
    points = undistort(images.reshape(-1, 2).astype(float), camera)
    shift = np.zeros(len(points))
    if camera.port_mm is not None:
        air = np.sqrt((points**2).sum(axis=1))
        sine = air / np.sqrt(1.0 + air**2) / PORT_INDEX
        water = sine / np.sqrt(1.0 - sine**2)
        shrink = np.where(air > 1e-9, water / np.maximum(air, 1e-9), 1.0 / PORT_INDEX)
        shift = camera.port_mm * 1e-3 * (1.0 - 1.0 / shrink)
        points = points * shrink[:, None]
    rays = np.concatenate([points, shift[:, None]], axis=1).reshape(*columns.shape, 3)
    found = (np.round(rays / RAY_STEP) * RAY_STEP).astype(np.float32)
    found.flags.writeable = False
    return found


def project(points: Array, camera: CameraRecipe) -> Array:
    """Project points (N, 3), m, in the optical frame, with z > 0 and in the water, to pixels (N, 2)."""
    flat = points[:, :2] / points[:, 2:]
    if camera.port_mm is not None:
        flat = _through_port(points, camera.port_mm * 1e-3)
    matrix = camera_matrix(camera)
    return np.asarray(distort(flat, camera) * matrix[0, 0] + matrix[:2, 2])


def _through_port(points: Array, port: float) -> Array:
    """Tangents (N, 2), in air, of the rays from the pupil that a flat port refracts to points (N, 3) in the water."""
    radius = np.sqrt((points[:, :2] ** 2).sum(axis=1))
    depth = np.maximum(points[:, 2] - port, 1e-6)
    tangent = radius / points[:, 2]
    for _ in range(PORT_STEPS):
        sine2 = tangent**2 / (1 + tangent**2) / PORT_INDEX**2
        water = np.sqrt(sine2 / (1 - sine2))
        slope = port + depth / (PORT_INDEX * ((1 + tangent**2) * (1 - sine2)) ** 1.5)
        tangent = np.maximum(tangent - (port * tangent + depth * water - radius) / slope, 0.0)
    return np.asarray(points[:, :2] * (tangent / np.maximum(radius, 1e-12))[:, None])
