"""Lens models, and checks of a camera's lens that no single key can express.

Conventions and coefficients are those of OpenCV (`cv2.projectPoints`, `cv2.fisheye.projectPoints`).
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from oysterbench.core.errors import RecipeError

if TYPE_CHECKING:
    from oysterbench.recipe.rig import CameraRecipe

PORT_INDEX = 1.33
"""Refractive index of water relative to air at a flat port."""

WIDEST_DEG = 89.9
"""Largest angle of a ray to the optical axis: rays are points in the plane z = 1, which none at 90 degrees meets."""

STEPS = 2000  # in which angles up to WIDEST_DEG are examined
WIDEST_SINE = 0.995  # of the angle in air of a ray at the image's side, behind a flat port
NEWTON_STEPS = 30
RESIDUAL = 1e-9
STILL = 1e-13  # steps below this end the iteration: far less than the rounding of rays
NEARBY = 1e-6  # step of finite differences


def bent(theta: NDArray[np.float64], distortion: tuple[float, ...]) -> NDArray[np.float64]:
    """Radius in the image, in focal lengths, of rays at angles to the axis, rad (Kannala & Brandt 2006)."""
    return np.asarray(theta * (1.0 + sum(k * theta ** (2 * n) for n, k in enumerate(distortion, start=1))))


def unfolded(distortion: tuple[float, ...]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Angles, rad, and their radii in the image, from the axis up to where a fisheye folds its image over, at most
    WIDEST_DEG: there the radii increase."""
    theta = np.linspace(0.0, math.radians(WIDEST_DEG), STEPS)
    radius = bent(theta, distortion)
    end = 1 + int(np.argmin(np.append(np.diff(radius) > 0, False)))
    return theta[:end], radius[:end]


def distort(points: NDArray[np.float64], camera: CameraRecipe) -> NDArray[np.float64]:
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


def undistort(images: NDArray[np.float64], camera: CameraRecipe) -> NDArray[np.float64]:
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
            f"camera {camera.name}: key 'camera.distortion': the lens folds its image over before the edge of "
            f"{camera.width} x {camera.height} px; expected a weaker distortion or a smaller 'hfov_deg', "
            f"got {list(camera.distortion)}"
        )
    return points


def half_in_air(camera: CameraRecipe) -> float:
    """Angle to the axis, rad, in air, of a ray at the middle of the image's side. Raises RecipeError where no ray
    from the water gets through a flat port at that angle."""
    half = float(np.radians(camera.hfov_deg) / 2)
    if camera.port_mm is None:
        return half
    sine = PORT_INDEX * np.sin(half)
    if sine >= WIDEST_SINE:
        raise RecipeError(
            f"camera {camera.name}: key 'camera.hfov_deg': expected at most 96 behind a flat port, where light is "
            f"reflected beyond, got {camera.hfov_deg:g}"
        )
    return float(np.arcsin(sine))


def check_lens(camera: CameraRecipe, where: str) -> None:
    """Raise RecipeError, which starts with `where`, if some pixel of a camera would have no ray."""
    if camera.lens == "fisheye":
        check_fisheye(camera, where)
    try:
        half = half_in_air(camera)
        if camera.lens == "brown-conrady":
            undistort(_border(camera.width, camera.height) * (2 * math.tan(half) / camera.width), camera)
    except RecipeError as error:
        raise RecipeError(f"{where}: {error}") from None


def _border(width: int, height: int) -> NDArray[np.float64]:
    """Points (N, 2), px from the image's centre, of the border of one pixel around it, which is rendered too."""
    x, y = np.arange(width + 2) - (width + 1) / 2, np.arange(height + 2) - (height + 1) / 2
    sides = [np.stack(np.broadcast_arrays(*side), axis=1) for side in ((x, y[0]), (x, y[-1]), (x[0], y), (x[-1], y))]
    return np.concatenate(sides)


def check_fisheye(camera: CameraRecipe, where: str) -> None:
    """Raise RecipeError, which starts with `where`, if a fisheye folds its image over before the corner, or the
    corner looks further to the side than rays can."""
    index = 1.0 if camera.port_mm is None else PORT_INDEX
    sine = index * math.sin(math.radians(camera.hfov_deg) / 2)
    half = math.radians(camera.hfov_deg) / 2 if camera.port_mm is None else math.asin(min(sine, 1.0))
    theta, radius = unfolded(camera.distortion)
    corner = math.hypot(camera.width + 1, camera.height + 1) / camera.width  # a border of one pixel is rendered
    edge = float(bent(np.array(half), camera.distortion))
    if half <= theta[-1] and edge * corner <= radius[-1]:
        return
    widest = float(np.interp(radius[-1] / corner, radius, theta))
    limit = 2 * math.degrees(widest if camera.port_mm is None else math.asin(math.sin(widest) / index))
    wanted = f"expected at most {math.floor(10 * limit) / 10:g} for {camera.width} x {camera.height} px"
    if len(theta) == STEPS:
        why = f"the corners would look {WIDEST_DEG:g} degrees or more from the axis, which no ray can; {wanted}"
    else:
        folds = f"distortion = {list(camera.distortion)} folds the image over {math.degrees(theta[-1]):.0f} degrees"
        why = f"{folds} from the axis, before its corners; {wanted}, or a weaker distortion"
    raise RecipeError(f"{where}: camera {camera.name}: key 'camera.hfov_deg': {why}, got {camera.hfov_deg:g}")
