"""Effect of varying turbidity on light along a view ray, read from the grid that render/march.py fills."""

from __future__ import annotations

from typing import Any

import warp as wp

from oysterbench.render.optics import Optics
from oysterbench.render.tables import look_up
from oysterbench.render.turbidity import amounts, decay, decays, dimmed, unbeamed


@wp.struct
class Way:
    """Factors on light from a point to the camera, relative to uniform water.

    direct, image (3,): shares that arrive of the sharp and of all of a surface's light; unsilted: share of all of it,
    in green, that silt has not scattered; day, lamps (3,): shares of daylight and lamp light that reach the point; beam
    (3,): factor on the share of daylight that casts shadows; pattern: remaining contrast of caustics; veil (3,): factor
    on the veil.
    """

    direct: wp.vec3
    image: wp.vec3
    unsilted: wp.float32
    day: wp.vec3
    beam: wp.vec3
    pattern: wp.float32
    lamps: wp.vec3
    veil: wp.vec3


@wp.func
def interpolate(grid: Any, y: float, x: float, z: float):
    """Interpolate a grid trilinearly at fractional indices."""
    i = wp.min(int(y), grid.shape[0] - 2)
    j = wp.min(int(x), grid.shape[1] - 2)
    k = wp.min(int(z), grid.shape[2] - 2)
    v = y - float(i)
    u = x - float(j)
    w = z - float(k)
    low_left = grid[i, j, k] * (1.0 - w) + grid[i, j, k + 1] * w
    low_right = grid[i, j + 1, k] * (1.0 - w) + grid[i, j + 1, k + 1] * w
    high_left = grid[i + 1, j, k] * (1.0 - w) + grid[i + 1, j, k + 1] * w
    high_right = grid[i + 1, j + 1, k] * (1.0 - w) + grid[i + 1, j + 1, k + 1] * w
    return (low_left * (1.0 - u) + low_right * u) * (1.0 - v) + (high_left * (1.0 - u) + high_right * u) * v


@wp.func
def node_at(nodes: int, reach: float, distance: float):
    """Fractional node of a distance: proportional to its root up to the reach; the last node is at infinity."""
    last = float(nodes - 2)
    place = last * wp.sqrt(wp.clamp(distance / reach, 0.0, 1.0))
    if distance > reach:
        place = last + 1.0 - reach / distance
    return place


@wp.func
def way_to(optics: Optics, across: float, down: float, distance: float, p: wp.vec3):
    """Way from a point p in `map` to the camera, `distance` m along the ray at relative image position across, down (0
    to 1)."""
    field = optics.turbidity
    way = Way()
    way.direct = wp.vec3(1.0, 1.0, 1.0)
    way.image = way.direct
    way.day = way.direct
    way.beam = way.direct
    way.pattern = 1.0
    way.unsilted = 1.0
    way.lamps = way.direct
    way.veil = way.direct
    if field.on != 0:
        y = wp.clamp(down, 0.0, 1.0) * float(field.along.shape[0] - 1)
        x = wp.clamp(across, 0.0, 1.0) * float(field.along.shape[1] - 1)
        z = node_at(field.along.shape[2], field.reach, distance)
        amount = interpolate(field.along, y, x, z)
        column = distance / optics.range_step
        sharp = look_up(field.silt_direct, column) * amount[1]
        whole = look_up(field.silt_image, column) * amount[1]
        way.direct = decays(look_up(field.own_direct, column) * amount[0] + sharp)
        way.image = decays(look_up(field.own_image, column) * amount[0] + whole)
        way.unsilted = decay(sharp[1] - whole[1])
        above = amounts(field, p)
        row = -p[2] / optics.depth_step
        way.day = dimmed(field, above, row)
        way.beam = unbeamed(field, above, row, optics.sun_direction[2])
        turned = field.own_scattering[1] * above[2] + field.silt_scattering[1] * above[3]
        way.pattern = decay(field.blurring * turned / optics.sun_direction[2])
        way.veil = interpolate(field.veil, y, x, z)
        if optics.lamps.count > 0:
            y = y * float(field.lit.shape[0] - 1) / float(field.along.shape[0] - 1)
            x = x * float(field.lit.shape[1] - 1) / float(field.along.shape[1] - 1)
            z = z * float(field.lit.shape[2] - 1) / float(field.along.shape[2] - 1)
            lit = interpolate(field.lit, y, x, z)
            way.lamps = decays(field.own_spread * lit[0] + field.silt_spread * lit[1]) * lit[2]
    return way
