"""Clearance of the path: no obstacle within the body's clearance, never off the reef, never through the surface."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.ndimage import gaussian_filter1d, maximum_filter1d

from oysterbench.core.errors import RecipeError
from oysterbench.core.geometry import Array
from oysterbench.recipe import SequenceRecipe
from oysterbench.scene.path.itinerary import KNOT_S
from oysterbench.scene.path.motion import Path

Height = Callable[[Array, Array], Array]

STEP_M = 0.0125
"""Distance between two checks at full speed: half a cell of the finest obstacle map."""

RING_M = 0.1  # spacing of the rings on which the surroundings are sampled
MAX_RINGS = 8
DIRECTIONS = 16

LIFT_SMOOTHING_S = 0.6
REACH = 4.0  # truncation of the lift's Gaussian, in standard deviations
SPARE_M = 1e-3  # margin added to a lift, for deviations of the spline between its knots


def lowest(x: Array, y: Array, obstacle_height: Height, clearance_m: float) -> Array:
    """Lowest z (N,) m at x, y at which a ball of radius clearance_m around the body touches nothing.

    obstacle_height: height of the highest surface at x, y, m in `map`. Where that is h at a distance r, the ball's
    centre has to be at h + sqrt(clearance^2 - r^2) or higher.
    """
    floor = np.asarray(obstacle_height(x, y), dtype=float) + clearance_m
    rings = min(int(np.ceil(clearance_m / RING_M)), MAX_RINGS)
    for radius in clearance_m * (np.arange(rings) + 1) / max(rings, 1):
        rise = np.sqrt(max(clearance_m**2 - radius**2, 0.0))
        for angle in 2 * np.pi * np.arange(DIRECTIONS) / DIRECTIONS:
            around = obstacle_height(x + radius * np.cos(angle), y + radius * np.sin(angle))
            floor = np.maximum(floor, around + rise)
    return floor


def check_times(recipe: SequenceRecipe) -> Array:
    """Times (N,) s at which the path of a recipe is checked."""
    step = min(KNOT_S / 2, STEP_M / recipe.path.speed_m_s)
    return np.arange(0.0, recipe.duration_s, step)


def lift(path: Path, knots: Array, recipe: SequenceRecipe, obstacle_height: Height) -> Array:
    """Lift (K,) m that the path needs at its knots (K,) s to keep its clearance.

    The missing height is extended over the reach of a Gaussian before and after, and then smoothed with it: the result
    is a mean of values none of which is less than the height missing there.
    """
    times = check_times(recipe)
    position = path.position(times)
    floor = lowest(position[:, 0], position[:, 1], obstacle_height, recipe.path.clearance_m)
    missing = np.maximum(floor - position[:, 2], 0.0)
    most = np.zeros(len(knots))
    np.maximum.at(most, np.minimum(np.rint(times / KNOT_S).astype(int), len(knots) - 1), missing)
    if not most.any():
        return most
    sigma = LIFT_SMOOTHING_S / KNOT_S
    size = 2 * (int(np.ceil(REACH * sigma)) + 1) + 1
    wide = maximum_filter1d(np.where(most > 0, most + SPARE_M, 0.0), size, mode="nearest")
    return gaussian_filter1d(wide, sigma, mode="nearest", truncate=REACH)


def check_clearance(path: Path, recipe: SequenceRecipe, obstacle_height: Height) -> None:
    """Raise RecipeError if the path leaves the reef, violates its clearance to an obstacle or breaks the surface."""
    position = path.position(check_times(recipe))
    half = recipe.reef.size_m / 2
    out = np.abs(position[:, :2]).max(axis=1)
    worst = int(np.argmax(out))
    if out[worst] > half:
        raise RecipeError(
            f"sequence {recipe.name}: key 'path.kind': the path leaves the reef at x = {position[worst, 0]:.1f}, y = "
            f"{position[worst, 1]:.1f} m; expected both within -{half:g} and {half:g} (reef.size_m / 2), with sway, "
            "waves and current; keep the path farther inside or enlarge the reef"
        )
    clearance = recipe.path.clearance_m
    floor = lowest(position[:, 0], position[:, 1], obstacle_height, clearance)
    over = position[:, 2] - floor + clearance
    worst = int(np.argmin(over))
    if over[worst] < clearance:
        raise RecipeError(
            f"sequence {recipe.name}: key 'path.altitude_m': at x = {position[worst, 0]:.1f}, y = "
            f"{position[worst, 1]:.1f} m the path comes to {over[worst]:.2f} m above the reef; expected at least "
            f"path.clearance_m = {clearance:g}; raise the altitude, lower reef.relief_rms_m or set path.lift = true"
        )
    if position[:, 2].max() >= 0.0:
        raise RecipeError(
            f"sequence {recipe.name}: key 'path.altitude_m': the path breaks the surface; expected z below 0, got "
            f"{position[:, 2].max():.2f} m; lower the altitude or raise reef.depth_m"
        )
