"""Lens models: from a pixel to a ray and back, for pinhole, Brown-Conrady and fisheye, also behind a flat port.

Conventions and coefficients are those of OpenCV (`cv2.projectPoints`, `cv2.fisheye.projectPoints`).
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from oysterbench.core.errors import RecipeError
from oysterbench.core.geometry import Array
from oysterbench.recipe import CameraRecipe
from oysterbench.recipe.lens import PORT_INDEX, unfolded
from oysterbench.scene.rig import camera_matrix

NEWTON_STEPS = 30
RESIDUAL = 1e-9
STILL = 1e-13  # steps below this end the iteration: far less than the rounding of rays
PORT_STEPS = 8  # of Newton's method, through a port: converges to 1e-12, even for points that almost touch the glass
NEARBY = 1e-6  # step of finite differences
RAY_STEP = 2.0**-24  # rays are rounded to this, so that the last bits of a processor's mathematics do not show


def distort(points: Array, camera: CameraRecipe) -> Array:
    """Image points (N, 2), in units of the focal length, of points (N, 2) in the plane z = 1.

    Brown 1966 as in OpenCV; Kannala & Brandt 2006: theta (1 + k1 theta^2 + ... + k4 theta^8) along the radius.
    """
    x, y = points[:, 0], points[:, 1]
    r2 = x * x + y * y
    if camera.lens == "brown-conrady":
        k1, k2, p1, p2, k3 = (*camera.distortion, 0.0, 0.0, 0.0, 0.0, 0.0)[:5]
        radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
        return np.stack(
            [
                x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x),
                y * radial + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y,
            ],
            axis=1,
        )
    if camera.lens == "fisheye":
        k1, k2, k3, k4 = (*camera.distortion, 0.0, 0.0, 0.0, 0.0)[:4]
        r = np.sqrt(r2)
        theta = np.arctan(r)
        t2 = theta * theta
        bent = theta * (1.0 + t2 * (k1 + t2 * (k2 + t2 * (k3 + t2 * k4))))
        return points * np.where(r > 1e-12, bent / np.maximum(r, 1e-12), 1.0)[:, None]
    return points


def undistort(images: Array, camera: CameraRecipe) -> Array:
    """Points (N, 2) in the plane z = 1 that a lens images at (N, 2): the inverse of `distort`, by Newton's method.

    Raises RecipeError where the lens folds its image over inside the frame.
    """
    if camera.lens == "pinhole":
        return images
    points = images.copy()
    if camera.lens == "fisheye":
        r = np.sqrt((images**2).sum(axis=1))
        angles, radii = unfolded(camera.distortion)
        points = images * (np.tan(np.interp(r, radii, angles)) / np.maximum(r, 1e-12))[:, None]
    steps = NEARBY * np.eye(2)
    for _ in range(NEWTON_STEPS):
        miss = distort(points, camera) - images
        dx, dy = ((distort(points + h, camera) - distort(points - h, camera)) / (2 * NEARBY) for h in steps)
        determinant = dx[:, 0] * dy[:, 1] - dy[:, 0] * dx[:, 1]
        safe = np.where(np.abs(determinant) > 1e-12, determinant, 1e-12)
        step = np.stack([dy[:, 1] * miss[:, 0] - dy[:, 0] * miss[:, 1], dx[:, 0] * miss[:, 1] - dx[:, 1] * miss[:, 0]])
        step /= safe
        points = points - step.T
        if np.abs(step).max() < STILL:
            break
    miss = np.abs(distort(points, camera) - images).max(axis=1)
    if not np.all((miss < RESIDUAL) & (determinant > 0)):
        raise RecipeError(
            f"camera {camera.name}: key 'camera.distortion': the lens folds its picture over before the edge of "
            f"{camera.width} x {camera.height} px; expected a weaker distortion or a smaller 'hfov_deg', "
            f"got {list(camera.distortion)}"
        )
    return points


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
