"""The path of a sequence, from its recipe: the route, following the bottom, disturbances, and how the vehicle leans."""

from __future__ import annotations

import dataclasses

import numpy as np
from scipy.interpolate import make_interp_spline
from scipy.ndimage import gaussian_filter1d, uniform_filter

from oysterbench.core.geometry import Array
from oysterbench.core.streams import Streams
from oysterbench.recipe import PathRecipe, SequenceRecipe
from oysterbench.scene.path import disturbance, routes
from oysterbench.scene.path.clearance import Height, check_clearance, lift
from oysterbench.scene.path.itinerary import KNOT_S, Itinerary, NominalPath, Pace, clock, ramp
from oysterbench.scene.path.motion import Path
from oysterbench.scene.waves import build_waves

TERRAIN_SMOOTHING_S = 1.0
"""Smoothing of the bottom's profile: an ROV follows it through its altimeter and its own inertia, not stone by
stone."""

SPOT_CELL_M, SPOT_CELLS = 0.1, 5  # cell of the map on which spots are found, and side of a spot in cells
SPOT_ROOM = 0.8  # share of the available room that is used: looking past a spot, a camera still sees reef


def build_path(recipe: SequenceRecipe, ground_height: Height, obstacle_height: Height, streams: Streams) -> Path:
    """Build the path of a sequence over its reef.

    ground_height, obstacle_height: z (m) in `map` of the bare bottom, and of the top of the objects on it, at x, y.
    With `path.lift`, the vehicle rises over obstacles to which it would otherwise come too close.

    Raises RecipeError where the path would come closer to an obstacle than `path.clearance_m`, leave the reef, or break
    the surface.
    """
    times = np.arange(0.0, recipe.duration_s + 1.0, KNOT_S)  # beyond the end, to avoid end effects
    plan, site = recipe.path, recipe.site
    under_way = times - plan.rest_s
    begun = ramp(under_way if plan.resting == "still" else times + plan.ramp_s, plan.ramp_s)[:, None]  # held until then
    flown = disturbance.hand_flown(under_way, plan, streams)
    route = nominal_path(recipe, flown.clock(clock(under_way, plan.ramp_s)), ground_height, obstacle_height, streams)
    bottom = gaussian_filter1d(ground_height(route.x, route.y), TERRAIN_SMOOTHING_S / KNOT_S, mode="nearest")
    nominal = np.column_stack([route.x, route.y, bottom + route.altitude + flown.altitude])
    wobble = disturbance.sway(times, begun, plan, streams) + disturbance.excitation(under_way, plan, streams)
    position, attitude = nominal + wobble[:, :3], wobble[:, 3:]
    attitude[:, 0] += route.heading + flown.heading
    if site.wave_height_m:
        waves = build_waves(site, recipe.reef.depth_m, streams)
        position += plan.wave_following * begun * waves.displacement(nominal, times)
    water = np.zeros((len(times), 2))
    if site.current_m_s:
        mean, gusts = disturbance.current(times, site, streams)
        water = mean + gusts
        position[:, :2] += plan.hold_s * begun * gusts
        attitude[:, 0] += route.along * disturbance.crab(route.heading, water, plan.speed_m_s)
    if plan.lean:
        pitch, roll = disturbance.lean(times, nominal[:, :2], attitude[:, 0], water, plan.lean)
        attitude[:, 1] += pitch
        attitude[:, 2] += roll
    path = _path(times, position, attitude, recipe)
    if plan.lift:
        position[:, 2] += lift(path, times, recipe, obstacle_height)
        path = _path(times, position, attitude, recipe)
    check_clearance(path, recipe, obstacle_height)
    return path


def _path(times: Array, position: Array, attitude: Array, recipe: SequenceRecipe) -> Path:
    return Path(
        make_interp_spline(times, position, k=5), make_interp_spline(times, attitude, k=5), float(recipe.duration_s)
    )


def nominal_path(
    recipe: SequenceRecipe, clock_s: Array, ground_height: Height, obstacle_height: Height, streams: Streams
) -> NominalPath:
    """Nominal path that the recipe specifies, at clock (N,), seconds at full pace."""
    plan = recipe.path
    if plan.kind == "loop":
        rng = streams.generator("path", "loop")
        x, y, heading = routes.loop(_given(plan.radius_m), plan.speed_m_s * clock_s, rng)
        return NominalPath(x, y, np.full(len(x), plan.altitude_m), heading, np.ones(len(x)))
    if plan.kind == "inspection" and not plan.spots_m:
        spots = find_spots(recipe, ground_height, obstacle_height, streams.generator("path", "spots"))
        plan = dataclasses.replace(plan, spots_m=tuple(spots))
    return itinerary(plan, float(clock_s[-1]), streams).nominal_path(clock_s)


def itinerary(plan: PathRecipe, seconds: float, streams: Streams) -> Itinerary:
    """Build the itinerary of any kind of path but a loop; if it repeats, for at least so many seconds."""
    heading, rng = np.radians(plan.heading_deg), streams.generator("path", plan.kind)
    pace = Pace(plan.altitude_m, plan.speed_m_s, np.radians(plan.turn_rate_deg_s))
    match plan.kind:
        case "lawnmower":
            shape = (_given(plan.length_m), _given(plan.width_m), _given(plan.spacing_m))
            sets = routes.lanes(*shape, heading, plan.centre_m, plan.cross)
            return routes.survey(sets, pace, plan.repeat, seconds)
        case "transect":
            line = routes.lanes(_given(plan.length_m), 0.0, 1.0, heading, plan.centre_m, False)
            return routes.survey(line, pace, plan.repeat, seconds)
        case "orbit":
            radii = [_given(plan.radius_m) + ring * (plan.spacing_m or 0.0) for ring in range(plan.rings)]
            return routes.orbit(radii, plan.centre_m, plan.look == "inward", pace, seconds, rng)
        case "inspection":
            looks = (plan.stand_off_m, plan.close_m, plan.sides, plan.hover_s)
            return routes.inspection([(x, y) for x, y in plan.spots_m], *looks, pace, seconds, rng)
        case "waypoints":
            return routes.waypoints(plan.waypoints, pace, plan.repeat, seconds)
        case "free":
            return routes.wander(_given(plan.extent_m), plan.revisit, pace, seconds, rng)
    raise ValueError(f"no itinerary for a path of kind {plan.kind!r}")


def find_spots(
    recipe: SequenceRecipe, ground_height: Height, obstacle_height: Height, rng: np.random.Generator
) -> routes.Places:
    """Draw places (x, y m) to inspect from where the relief is highest, with room to circle them."""
    plan = recipe.path
    half = SPOT_ROOM * (recipe.reef.size_m / 2 - 2 * plan.sway_m - plan.stand_off_m)
    lines = np.linspace(-half, half, 2 * int(np.ceil(half / SPOT_CELL_M)) + 1)
    x, y = np.meshgrid(lines, lines)
    relief = uniform_filter(obstacle_height(x, y) - ground_height(x, y), SPOT_CELLS, mode="nearest")
    return routes.dense_spots(relief, lines, plan.spots, 2 * plan.stand_off_m, rng)


def _given(value: float | None) -> float:
    """Return the value of a key whose presence `recipe.path.check_path` has already verified."""
    assert value is not None
    return value
