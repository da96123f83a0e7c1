"""Noise as Warp functions: hashes, value noise, scattered grains and packed pebbles.

Only +, -, *, /, sqrt and floor are used, because they are exact on every processor; mathematics libraries are not.
Detail finer than a pixel's footprint is faded out, so that distant surfaces do not shimmer.
"""

from __future__ import annotations

import warp as wp

from oysterbench.core.streams import Name, Streams
from oysterbench.render.arithmetic import clamped, greater, lesser

MIX_1 = wp.constant(wp.uint32(0x7FEB352D))
MIX_2 = wp.constant(wp.uint32(0x846CA68B))
MIX_3 = wp.constant(wp.uint64(0xBF58476D1CE4E5B9))
MIX_4 = wp.constant(wp.uint64(0x94D049BB133111EB))
PRIME_X = wp.constant(wp.uint32(0x9E3779B1))
PRIME_Y = wp.constant(wp.uint32(0x85EBCA77))
PRIME_Z = wp.constant(wp.uint32(0xC2B2AE3D))
OWN = wp.constant(2**30)  # a lattice point that no pattern comes to


@wp.func
def scramble(h: wp.uint32):
    """Integer hash with full avalanche (lowbias32 by C. Wellons, hash-prospector)."""
    h = h ^ (h >> wp.uint32(16))
    h = h * MIX_1
    h = h ^ (h >> wp.uint32(15))
    h = h * MIX_2
    return h ^ (h >> wp.uint32(16))


@wp.func
def scramble64(h: wp.uint64):
    """Hash of 64 bits with full avalanche (of SplitMix64: Steele, Lea & Flood, OOPSLA 2014)."""
    h = (h ^ (h >> wp.uint64(30))) * MIX_3
    h = (h ^ (h >> wp.uint64(27))) * MIX_4
    return h ^ (h >> wp.uint64(31))


def key_of(first: int, appearance: Streams, *name: Name) -> wp.vec2ui:
    """Key of a pattern: these 32 bits; with a salt, 64 from the stream of this name instead. Who knew the pattern on
    the ground of a hidden reef would know where each image of it was taken, and 32 bits can all be tried."""
    words = (first, 0)
    if appearance.salt:
        words = tuple(appearance.generator(*name, "key").integers((0, 1), 2**32).tolist())
    return wp.vec2ui(*map(wp.uint32, words))


@wp.func
def nth(seed: wp.vec2ui, n: int):
    """Key of the n-th of several patterns."""
    return wp.vec2ui(seed[0] + wp.uint32(n), seed[1])


@wp.func
def instances_key(seed: wp.vec2ui, i: int):
    """Key of instance i in the patterns of a key."""
    return wp.vec2ui(scramble(seed[0] + wp.uint32(i)), seed[1])


@wp.func
def lattice(x: int, y: int, z: int, seed: wp.vec2ui):
    """Hash of a lattice point. All of a key of 64 bits enters before, between and after its rounds, in each of which
    every bit changes every other: were its words mixed in one after the other, each could be looked for alone."""
    third = wp.uint32(z) * PRIME_Z
    if seed[1] != wp.uint32(0):
        key = (wp.uint64(seed[0]) << wp.uint64(32)) | wp.uint64(seed[1])
        point = (wp.uint64(wp.uint32(x) ^ third) << wp.uint64(32)) | wp.uint64(wp.uint32(y))
        h = scramble64(scramble64(scramble64(point ^ key) + key) ^ key)
        return wp.uint32(h >> wp.uint64(32))
    return scramble((wp.uint32(x) * PRIME_X) ^ (wp.uint32(y) * PRIME_Y) ^ third ^ seed[0])


@wp.func
def own_hash(seed: wp.vec2ui):
    """Hash of a key itself."""
    if seed[1] != wp.uint32(0):
        return lattice(0, 0, OWN, seed)
    return seed[0]


@wp.func
def unit(h: wp.uint32, shift: int):
    """Byte of a hash that starts at bit `shift`, as a number from 0 to 1."""
    return float((h >> wp.uint32(shift)) & wp.uint32(255)) * (1.0 / 255.0)


@wp.func
def signed(h: wp.uint32):
    """A hash as a number from -1 to 1."""
    return float(h >> wp.uint32(8)) * (2.0 / 16777215.0) - 1.0


@wp.func
def noise2(x: float, y: float, seed: wp.vec2ui):
    """Value noise on the unit lattice: (value from -1 to 1, d/dx, d/dy)."""
    fx = wp.floor(x)
    fy = wp.floor(y)
    i = int(fx)
    j = int(fy)
    u = x - fx
    v = y - fy
    su = u * u * (3.0 - 2.0 * u)
    sv = v * v * (3.0 - 2.0 * v)
    a = signed(lattice(i, j, 0, seed))
    b = signed(lattice(i + 1, j, 0, seed))
    c = signed(lattice(i, j + 1, 0, seed))
    d = signed(lattice(i + 1, j + 1, 0, seed))
    cross = a - b - c + d
    value = a + (b - a) * su + (c - a) * sv + cross * su * sv
    return wp.vec3(value, ((b - a) + cross * sv) * 6.0 * u * (1.0 - u), ((c - a) + cross * su) * 6.0 * v * (1.0 - v))


@wp.func
def noise3(p: wp.vec3, seed: wp.vec2ui):
    """Value noise on the unit lattice: (value from -1 to 1, gradient)."""
    fx = wp.floor(p[0])
    fy = wp.floor(p[1])
    fz = wp.floor(p[2])
    i = int(fx)
    j = int(fy)
    k = int(fz)
    u = p[0] - fx
    v = p[1] - fy
    w = p[2] - fz
    su = u * u * (3.0 - 2.0 * u)
    sv = v * v * (3.0 - 2.0 * v)
    sw = w * w * (3.0 - 2.0 * w)
    a = signed(lattice(i, j, k, seed))
    b = signed(lattice(i + 1, j, k, seed))
    c = signed(lattice(i, j + 1, k, seed))
    d = signed(lattice(i + 1, j + 1, k, seed))
    e = signed(lattice(i, j, k + 1, seed))
    f = signed(lattice(i + 1, j, k + 1, seed))
    g = signed(lattice(i, j + 1, k + 1, seed))
    h = signed(lattice(i + 1, j + 1, k + 1, seed))
    low = a + (b - a) * su + (c - a) * sv + (a - b - c + d) * su * sv
    high = e + (f - e) * su + (g - e) * sv + (e - f - g + h) * su * sv
    low_u = (b - a) + (a - b - c + d) * sv
    high_u = (f - e) + (e - f - g + h) * sv
    low_v = (c - a) + (a - b - c + d) * su
    high_v = (g - e) + (e - f - g + h) * su
    return wp.vec4(
        low + (high - low) * sw,
        (low_u + (high_u - low_u) * sw) * 6.0 * u * (1.0 - u),
        (low_v + (high_v - low_v) * sw) * 6.0 * v * (1.0 - v),
        (high - low) * 6.0 * w * (1.0 - w),
    )


@wp.func
def kept(wavelength: float, footprint: float):
    """Weight of detail of a given wavelength: 0 below 2 footprints (Nyquist), 1 from 4 on."""
    return clamped(0.5 * wavelength / footprint - 1.0, 0.0, 1.0)


@wp.func
def step_smoothly(low: float, high: float, x: float):
    """Cubic step from 0 at `low` to 1 at `high`."""
    s = clamped((x - low) / (high - low), 0.0, 1.0)
    return s * s * (3.0 - 2.0 * s)


@wp.func
def fleck(x: float, y: float, cell: float, density: float, footprint: float, seed: wp.vec2ui):
    """At most one elliptic grain in each cell: (coverage and tone from 0 to 1, slopes in x and y)."""
    fx = wp.floor(x / cell)
    fy = wp.floor(y / cell)
    h = lattice(int(fx), int(fy), 7, seed)
    result = wp.vec4(0.0, 0.0, 0.0, 0.0)
    if unit(h, 0) < density:
        g = scramble(h)
        radius = 0.10 + 0.20 * unit(g, 0)
        aspect = 0.25 + 0.70 * unit(g, 8)
        weight = kept(2.0 * radius * aspect * cell, 0.7 * footprint)
        if weight > 0.0:
            dx = x / cell - fx - (0.32 + 0.36 * unit(g, 16))
            dy = y / cell - fy - (0.32 + 0.36 * unit(g, 24))
            ax = unit(h, 8) - 0.5
            ay = unit(h, 16) - 0.498
            scale = 1.0 / wp.sqrt(ax * ax + ay * ay)
            along = (dx * ax + dy * ay) * scale / radius
            across = (dy * ax - dx * ay) * scale / (radius * aspect)
            # Broken pieces: ellipses cut by a line.
            cut = 0.15 + 0.9 * unit(g, 4) - 0.8 * along - 0.6 * across
            r = wp.sqrt(along * along + across * across)
            inside = lesser(1.0 - r, cut) * radius * aspect * cell / footprint
            cover = weight * clamped(inside + 0.5, 0.0, 1.0)
            # A slightly tilted lens: flat in the middle, falling off at the rim.
            fall = -1.6 * r * r * r
            slope = wp.vec2(fall * dx, fall * dy) * (1.0 / (radius + 1.0e-6))
            tilt = wp.vec2(unit(g, 12) - 0.5, unit(g, 20) - 0.5) * 0.7
            result = wp.vec4(cover, unit(h, 24), slope[0] + tilt[0], slope[1] + tilt[1])
    return result


@wp.func
def pebble(x: float, y: float, cell: float, seed: wp.vec2ui):
    """Topmost pebble at x, y in a packed layer: (height from 0 to 1, its slopes in x and y per cell, tone).

    One rounded, jittered grain per cell; the highest in the neighbourhood shows (Worley 1996, with ellipsoids).
    """
    fx = wp.floor(x / cell)
    fy = wp.floor(y / cell)
    top = wp.vec4(0.0, 0.0, 0.0, 0.0)
    for k in range(9):
        i = k // 3 - 1
        j = k - 3 * (k // 3) - 1
        h = lattice(int(fx) + i, int(fy) + j, 3, seed)
        dx = x / cell - fx - float(i) - (0.15 + 0.7 * unit(h, 0))
        dy = y / cell - fy - float(j) - (0.15 + 0.7 * unit(h, 8))
        shear = unit(h, 4) - 0.5
        dx = dx + shear * dy
        radius = 0.45 + 0.35 * unit(h, 16)
        inside = 1.0 - (dx * dx + 1.4 * dy * dy) / (radius * radius)
        if inside > 0.0:
            rise = wp.sqrt(inside) * (0.55 + 0.45 * unit(h, 24))
            if rise > top[0]:
                slope = -(0.55 + 0.45 * unit(h, 24)) / (radius * radius * greater(wp.sqrt(inside), 0.25))
                top = wp.vec4(rise, slope * dx, slope * (1.4 * dy + shear * dx), unit(scramble(h), 8))
    return top
