"""Checks of a camera's lens that no single key can express."""

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


def bent(theta: NDArray[np.float64], distortion: tuple[float, ...]) -> NDArray[np.float64]:
    """Radius in the image, in focal lengths, of rays at angles to the axis, rad (Kannala & Brandt 2006)."""
    return np.asarray(theta * (1.0 + sum(k * theta ** (2 * n) for n, k in enumerate(distortion, start=1))))


def unfolded(distortion: tuple[float, ...]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Angles, rad, and their radii in the image, from the axis up to where a fisheye folds its picture over, at most
    WIDEST_DEG: there the radii increase."""
    theta = np.linspace(0.0, math.radians(WIDEST_DEG), STEPS)
    radius = bent(theta, distortion)
    end = 1 + int(np.argmin(np.append(np.diff(radius) > 0, False)))
    return theta[:end], radius[:end]


def check_fisheye(camera: CameraRecipe, where: str) -> None:
    """Raise RecipeError, which starts with `where`, if a fisheye folds its picture over before the corner, or the
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
        folds = f"distortion = {list(camera.distortion)} folds the picture over {math.degrees(theta[-1]):.0f} degrees"
        why = f"{folds} from the axis, before its corners; {wanted}, or a weaker distortion"
    raise RecipeError(f"{where}: camera {camera.name}: key 'camera.hfov_deg': {why}, got {camera.hfov_deg:g}")
