"""Varying turbidity: what the layer, the patches and the plumes add to the water at a point, on the device.

There are two amounts: `own`, the relative excess of the water's own particles (layer and patches, in closed form), and
`silt`, the attenuation in green of the plumes, 1/m (a grid over the part of the view that has any).
"""

from __future__ import annotations

import warp as wp

from oysterbench.render.noise import noise2, nth
from oysterbench.render.tables import look_up

HALVINGS = wp.constant(1.0 / 64.0)


@wp.struct
class Turbidity:
    """The field at one time, and along the rays of a view. on: 0 for uniform water, for which nothing else is read.

    Layer: own particles are 1 + excess * exp(-height * fade) times as many at a height over z = bottom. Patches: that
    times 1 + contrast * noise(x, y), with `frequency` 1/m, after the current has carried them by `drift` m. Plumes:
    grid (X, Y, Z) of silt (attenuation 1/m, and its integral upwards) from `corner`, with a spacing of `cell` m; silty:
    0 for none.

    Per unit of either, as in admixture.Admixture: direct, image, veil (R,), spread, scattering, dimming (D,), glow (D,
    K); of uniform water: image, glow (D, K), left (R,) and sky (K,). Per ray and node of range: along (R, C, N),
    amounts of own and silt up to there; veil (R, C, N), factor on the veil; lit (R, C, N), amounts of own and silt
    between the lamps and there, and a factor on the light they leave. blurring: share of scattering that takes light
    out of the pattern of caustics but not out of the beam.
    """

    on: wp.int32
    bottom: wp.float32
    excess: wp.float32
    fade: wp.float32
    contrast: wp.float32
    frequency: wp.float32
    drift: wp.vec2
    seed: wp.vec2ui
    silty: wp.int32
    grid: wp.array3d(dtype=wp.vec2)
    corner: wp.vec3
    cell: wp.float32
    own_direct: wp.array(dtype=wp.vec3)
    own_image: wp.array(dtype=wp.vec3)
    own_veil: wp.array(dtype=wp.vec3)
    own_spread: wp.vec3
    own_scattering: wp.vec3
    own_dimming: wp.array(dtype=wp.vec3)
    own_glow: wp.array2d(dtype=wp.vec3)
    silt_direct: wp.array(dtype=wp.vec3)
    silt_image: wp.array(dtype=wp.vec3)
    silt_veil: wp.array(dtype=wp.vec3)
    silt_spread: wp.vec3
    silt_scattering: wp.vec3
    silt_dimming: wp.array(dtype=wp.vec3)
    silt_glow: wp.array2d(dtype=wp.vec3)
    even_image: wp.vec3
    even_glow: wp.array2d(dtype=wp.vec3)
    even_left: wp.array(dtype=wp.vec3)
    sky: wp.array(dtype=wp.vec3)
    along: wp.array3d(dtype=wp.vec2)
    veil: wp.array3d(dtype=wp.vec3)
    lit: wp.array3d(dtype=wp.vec3)
    reach: wp.float32
    blurring: wp.float32


@wp.func
def decay(x: float):
    """exp(-x) from a series in x / 64 raised to the 64th power: accurate to 1e-5, and the same on every processor."""
    t = wp.clamp(x, -8.0, 64.0) * HALVINGS
    y = 1.0 - t * (1.0 - t * (0.5 - t * (0.16666667 - t * (0.041666667 - t * 0.0083333333))))
    y = y * y
    y = y * y
    y = y * y
    y = y * y
    y = y * y
    return y * y


@wp.func
def mean_decay(x: float):
    """Mean of exp(-s) for s from 0 to x."""
    mean = 1.0 - x * (0.5 - x * (0.16666667 - x * 0.041666667))
    if wp.abs(x) >= 0.2:
        mean = (1.0 - decay(x)) / x
    return mean


@wp.func
def decays(x: wp.vec3):
    """exp(-x) of each channel."""
    return wp.vec3(decay(x[0]), decay(x[1]), decay(x[2]))


@wp.func
def mean_decays(x: wp.vec3):
    """Mean of exp(-s) from 0 to x, of each channel."""
    return wp.vec3(mean_decay(x[0]), mean_decay(x[1]), mean_decay(x[2]))


@wp.func
def patch(field: Turbidity, x: float, y: float):
    """Factor by which the patches multiply the water's own particles at x, y, m."""
    factor = wp.float32(1.0)
    if field.contrast > 0.0:
        u = (x - field.drift[0]) * field.frequency
        v = (y - field.drift[1]) * field.frequency
        coarse = noise2(u, v, field.seed)
        fine = noise2(2.0 * u, 2.0 * v, nth(field.seed, 1))
        factor = 1.0 + field.contrast * (coarse[0] + 0.5 * fine[0]) / 1.5
    return factor


@wp.func
def silt_at(field: Turbidity, p: wp.vec3):
    """Silt at a point, 1/m, and its integral upwards."""
    total = wp.vec2(0.0, 0.0)
    if field.silty != 0:
        q = (p - field.corner) / field.cell
        z = wp.max(q[2], 0.0)
        i = int(wp.floor(q[0]))
        j = int(wp.floor(q[1]))
        k = int(z)
        inside = i >= 0 and j >= 0 and i < field.grid.shape[0] - 1 and j < field.grid.shape[1] - 1
        if inside and k < field.grid.shape[2] - 1:
            u = q[0] - float(i)
            v = q[1] - float(j)
            w = z - float(k)
            a = field.grid[i, j, k] * (1.0 - w) + field.grid[i, j, k + 1] * w
            b = field.grid[i, j + 1, k] * (1.0 - w) + field.grid[i, j + 1, k + 1] * w
            c = field.grid[i + 1, j, k] * (1.0 - w) + field.grid[i + 1, j, k + 1] * w
            d = field.grid[i + 1, j + 1, k] * (1.0 - w) + field.grid[i + 1, j + 1, k + 1] * w
            total = (a * (1.0 - v) + b * v) * (1.0 - u) + (c * (1.0 - v) + d * v) * u
    return total


@wp.func
def amounts(field: Turbidity, p: wp.vec3):
    """Amounts of own and silt at a point, and the integrals of both from there up to the surface."""
    height = wp.max(p[2] - field.bottom, 0.0)
    below = wp.max(-p[2], 0.0)
    factor = patch(field, p[0], p[1])
    here = field.excess * decay(height * field.fade)
    above = here * below * mean_decay(below * field.fade)
    silt = silt_at(field, p)
    return wp.vec4(factor * (1.0 + here) - 1.0, silt[0], factor * (below + above) - below, silt[1])


@wp.func
def dimming(field: Turbidity, amount: wp.vec4, row: float):
    """Optical depth (3,), for daylight, of the amounts above a point, at a row of the tables over depth."""
    return look_up(field.own_dimming, row) * amount[2] + look_up(field.silt_dimming, row) * amount[3]


@wp.func
def dimmed(field: Turbidity, amount: wp.vec4, row: float):
    """Share (3,) of the daylight that the amounts above a point leave, at a row of the tables over depth."""
    return decays(dimming(field, amount, row))


@wp.func
def unbeamed(field: Turbidity, amount: wp.vec4, row: float, sun_cosine: float):
    """Factor (3,) by which the amounts above a point reduce the share of daylight that casts shadows: the beam loses
    what is scattered out of the image along its slanted path, while all the light together loses less."""
    lost = (field.own_spread * amount[2] + field.silt_spread * amount[3]) / sun_cosine - dimming(field, amount, row)
    return decays(wp.vec3(wp.max(lost[0], 0.0), wp.max(lost[1], 0.0), wp.max(lost[2], 0.0)))
