"""Light and water on the device: tables over depth, range and direction, and the functions that read them."""

from __future__ import annotations

import warp as wp

from oysterbench.render.arithmetic import clamped
from oysterbench.render.noise import noise2, nth, step_smoothly
from oysterbench.render.tables import look_up, look_up_pair
from oysterbench.render.turbidity import Turbidity

LAYER_COSINE, LAYER_SINE = wp.constant(0.8253356), wp.constant(0.5646425)  # 0.6 rad: neither rows nor diagonals align
LAYER_PATCH_M = wp.constant(1.7)
LEAST_TRANSMISSION = wp.constant(0.02)  # transmission in green below which a shadow would not be visible


@wp.struct
class Caustics:
    """Sunlight focused by waves: relative irradiance (N, N) on a level plane, mean 1, repeated every `period` m.

    on: 0 for a flat surface. seed: key of what mixes two layers of it. fade: contrast that is left at depths fade_step
    m apart.
    """

    tile: wp.array2d(dtype=wp.float32)
    on: wp.int32
    period: wp.float32
    seed: wp.vec2ui
    fade: wp.array(dtype=wp.float32)
    fade_step: wp.float32


@wp.struct
class Lamps:
    """Lamps in `map`: axes are unit vectors; power (3,) is the irradiance on the axis at 1 m over full daylight.

    inner, outer: cosines of the cone angles between which its edge falls off. left: share (3,) of the light left after
    a distance, with nodes `left_step` m apart. beams (rows, columns, nodes): light that the water scatters into the
    view from 0 to a range of (node / (nodes - 1))^2 * reach m.
    """

    count: wp.int32
    positions: wp.array(dtype=wp.vec3)
    axes: wp.array(dtype=wp.vec3)
    power: wp.array(dtype=wp.vec3)
    inner: wp.array(dtype=wp.float32)
    outer: wp.array(dtype=wp.float32)
    left: wp.array(dtype=wp.vec3)
    left_step: wp.float32
    beams: wp.array3d(dtype=wp.vec3)
    reach: wp.float32


@wp.struct
class Optics:
    """Light and water. Tables run over depth, then over range from 0 or over the cosine of the view ray from -1.

    sun, sky, bounce: irradiance just below the surface from the sun and from the sky, and from the bottom on surfaces
    that face down; beam: share of the sun's light that casts shadows, from the directions of the fan (16,), whose
    angles to the sun have sines of root mean square `spread`; the rest comes from above like that of the sky. shade,
    shade_m: as in LightRecipe.
    """

    sun_direction: wp.vec3
    fan: wp.array(dtype=wp.vec3)
    spread: wp.float32
    sun: wp.float32
    sky: wp.float32
    bounce: wp.float32
    occlusion: wp.float32
    seabed_shadows: wp.int32
    direct: wp.array2d(dtype=wp.vec3)
    forward_scatter: wp.array2d(dtype=wp.vec3)
    saturation: wp.array2d(dtype=wp.vec3)
    veil: wp.array2d(dtype=wp.vec3)
    stretch: wp.array2d(dtype=wp.vec3)
    range_step: wp.float32
    daylight: wp.array(dtype=wp.vec3)
    beam: wp.array(dtype=wp.vec3)
    depth_step: wp.float32
    cosine_step: wp.float32
    shade: wp.float32
    shade_m: wp.float32
    shade_seed: wp.vec2ui
    lamps: Lamps
    caustics: Caustics
    turbidity: Turbidity


@wp.func
def filled(saturation: wp.array2d(dtype=wp.vec3), row: float, place: wp.vec3):
    """Interpolate a table bilinearly, each channel at its own column."""
    y = clamped(row, 0.0, float(saturation.shape[0] - 1) - 0.001)
    i = int(y)
    v = y - float(i)
    last = float(saturation.shape[1] - 1) - 0.001
    share = wp.vec3(0.0, 0.0, 0.0)
    for channel in range(3):
        x = clamped(place[channel], 0.0, last)
        j = int(x)
        u = x - float(j)
        a = saturation[i, j][channel]
        c = saturation[i + 1, j][channel]
        low = a + (saturation[i, j + 1][channel] - a) * u
        high = c + (saturation[i + 1, j + 1][channel] - c) * u
        share[channel] = low + (high - low) * v
    return share


@wp.func
def veiling(optics: Optics, depth: float, distance: float, cosine: float):
    """Veiling light (3,) from daylight along a view ray from a camera at a depth, m, over a distance, m."""
    row = depth / optics.depth_step
    column = (cosine + 1.0) / optics.cosine_step
    place = look_up_pair(optics.stretch, row, column) * (distance / optics.range_step)
    return wp.cw_mul(look_up_pair(optics.veil, row, column), filled(optics.saturation, row, place))


@wp.func
def look_up_wrapped(tile: wp.array2d(dtype=wp.float32), x: float, y: float):
    """Interpolate bilinearly in a periodic tile, at x, y in cells."""
    n = tile.shape[0]
    floor_x = wp.floor(x)
    floor_y = wp.floor(y)
    u = x - floor_x
    v = y - floor_y
    j = ((int(floor_x) % n) + n) % n
    i = ((int(floor_y) % n) + n) % n
    k = (j + 1) % n
    m = (i + 1) % n
    low = tile[i, j] + (tile[i, k] - tile[i, j]) * u
    high = tile[m, j] + (tile[m, k] - tile[m, j]) * u
    return low + (high - low) * v


@wp.func
def caustic(optics: Optics, p: wp.vec3):
    """Irradiance of the sun at a point over that under a level surface, according to where its ray entered the water.

    The tile is laid out twice, the second time rotated and shifted, and a slowly varying noise mixes the two to hide
    its period. The mixture has the mean and the variance of the tile.
    """
    share = wp.float32(1.0)
    if optics.caustics.on != 0:
        across = -p[2] / optics.sun_direction[2]
        x = p[0] + optics.sun_direction[0] * across
        y = p[1] + optics.sun_direction[1] * across
        cells = float(optics.caustics.tile.shape[0]) / optics.caustics.period
        place = clamped(-p[2] / optics.caustics.fade_step, 0.0, float(optics.caustics.fade.shape[0] - 1) - 0.001)
        i = int(place)
        low = optics.caustics.fade[i]
        contrast = low + (optics.caustics.fade[i + 1] - low) * (place - float(i))
        one = look_up_wrapped(optics.caustics.tile, x * cells, y * cells) - 1.0
        u = (LAYER_COSINE * x - LAYER_SINE * y) * cells + 0.37 * float(optics.caustics.tile.shape[0])
        v = (LAYER_SINE * x + LAYER_COSINE * y) * cells
        two = look_up_wrapped(optics.caustics.tile, u, v) - 1.0
        mix = noise2(x / LAYER_PATCH_M, y / LAYER_PATCH_M, optics.caustics.seed)
        first = step_smoothly(-0.6, 0.6, mix[0])
        second = 1.0 - first
        wave = (first * one + second * two) / wp.sqrt(first * first + second * second)
        share = wp.max(1.0 + contrast * wave, 0.0)
    return share


@wp.func
def beam_at(optics: Optics, p: wp.vec3):
    """Share (3,) of the sun's light that casts shadows at a point."""
    return look_up(optics.beam, -p[2] / optics.depth_step)


@wp.func
def lamp_irradiance(lamps: Lamps, k: int, p: wp.vec3):
    """Irradiance (3,) of lamp k on a surface at p that faces it, through the water in between."""
    apart = p - lamps.positions[k]
    square = wp.max(wp.dot(apart, apart), 1.0e-4)
    distance = wp.sqrt(square)
    cosine = wp.dot(apart, lamps.axes[k]) / distance
    s = clamped((cosine - lamps.outer[k]) / (lamps.inner[k] - lamps.outer[k]), 0.0, 1.0)
    edge = s * s * (3.0 - 2.0 * s) / square
    light = wp.vec3(0.0, 0.0, 0.0)
    if edge > 0.0:
        light = wp.cw_mul(lamps.power[k], look_up(lamps.left, distance / lamps.left_step)) * edge
    return light


@wp.func
def beam_light(lamps: Lamps, row: float, column: float, distance: float):
    """Lamp light (3,) that the water scatters into a view ray of length `distance`, m, at fractional grid row and
    column."""
    nodes = lamps.beams.shape[2]
    place = float(nodes - 1) * wp.sqrt(clamped(distance / lamps.reach, 0.0, 1.0))
    z = wp.min(place, float(nodes - 1) - 0.001)
    y = clamped(row, 0.0, float(lamps.beams.shape[0] - 1) - 0.001)
    x = clamped(column, 0.0, float(lamps.beams.shape[1] - 1) - 0.001)
    i = int(y)
    j = int(x)
    k = int(z)
    w = z - float(k)
    u = x - float(j)
    low_left = lamps.beams[i, j, k] + (lamps.beams[i, j, k + 1] - lamps.beams[i, j, k]) * w
    low_right = lamps.beams[i, j + 1, k] + (lamps.beams[i, j + 1, k + 1] - lamps.beams[i, j + 1, k]) * w
    high_left = lamps.beams[i + 1, j, k] + (lamps.beams[i + 1, j, k + 1] - lamps.beams[i + 1, j, k]) * w
    high_right = lamps.beams[i + 1, j + 1, k] + (lamps.beams[i + 1, j + 1, k + 1] - lamps.beams[i + 1, j + 1, k]) * w
    low = low_left + (low_right - low_left) * u
    high = high_left + (high_right - high_left) * u
    return low + (high - low) * (y - float(i))


@wp.func
def shadows_lost(optics: Optics, p: wp.vec3, distance: float):
    """Whether a point is too far away for its shadows to be visible."""
    row = -p[2] / optics.depth_step
    column = distance / optics.range_step
    return (
        look_up_pair(optics.direct, row, column)[1] + look_up_pair(optics.forward_scatter, row, column)[1]
        < LEAST_TRANSMISSION
    )


@wp.func
def unshaded(optics: Optics, p: wp.vec3):
    """Share of daylight that reaches a point past sources of soft shade: canopies, piers, boats, and the vehicle."""
    x = (0.8 * p[0] - 0.6 * p[1]) / optics.shade_m
    y = (0.6 * p[0] + 0.8 * p[1]) / optics.shade_m
    wide = noise2(x, y, optics.shade_seed)
    close = noise2(2.3 * y, 2.3 * x, nth(optics.shade_seed, 1))
    return 1.0 - optics.shade * step_smoothly(-0.6, 0.6, wide[0] + 0.4 * close[0])
