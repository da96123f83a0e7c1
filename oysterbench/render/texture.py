"""Procedural surfaces as Warp functions: noise, and what seabed, shells and stones look like.

Only +, -, *, /, sqrt and floor are used: they are exact on every processor, the mathematics library is not. Detail
finer than a pixel's footprint is faded out, so that far surfaces do not shimmer.
"""

from __future__ import annotations

import warp as wp

MIX_1 = wp.constant(wp.uint32(0x7FEB352D))
MIX_2 = wp.constant(wp.uint32(0x846CA68B))
PRIME_X = wp.constant(wp.uint32(0x9E3779B1))
PRIME_Y = wp.constant(wp.uint32(0x85EBCA77))
PRIME_Z = wp.constant(wp.uint32(0xC2B2AE3D))

MUD = wp.constant(wp.vec3(0.085, 0.080, 0.062))
SAND = wp.constant(wp.vec3(0.270, 0.245, 0.190))
SILT = wp.constant(wp.vec3(0.215, 0.200, 0.155))
SHELL_HASH = wp.constant(wp.vec3(0.520, 0.490, 0.420))
PEBBLE = wp.constant(wp.vec3(0.050, 0.048, 0.042))


@wp.struct
class Material:
    """Linear albedo and unit normal in `map`."""

    albedo: wp.vec3
    normal: wp.vec3


@wp.func
def scramble(h: wp.uint32):
    """Integer hash of full avalanche (lowbias32 by C. Wellons, hash-prospector)."""
    h = h ^ (h >> wp.uint32(16))
    h = h * MIX_1
    h = h ^ (h >> wp.uint32(15))
    h = h * MIX_2
    return h ^ (h >> wp.uint32(16))


@wp.func
def lattice(x: int, y: int, z: int, seed: wp.uint32):
    """Hash of a lattice point."""
    mixed = (wp.uint32(x) * PRIME_X) ^ (wp.uint32(y) * PRIME_Y)
    return scramble(mixed ^ (wp.uint32(z) * PRIME_Z) ^ seed)


@wp.func
def unit(h: wp.uint32, shift: int):
    """Byte `shift` of a hash as a number from 0 to 1."""
    return float((h >> wp.uint32(shift)) & wp.uint32(255)) * (1.0 / 255.0)


@wp.func
def signed(h: wp.uint32):
    """A hash as a number from -1 to 1."""
    return float(h >> wp.uint32(8)) * (2.0 / 16777215.0) - 1.0


@wp.func
def noise2(x: float, y: float, seed: wp.uint32):
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
def noise3(p: wp.vec3, seed: wp.uint32):
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
    """Weight of detail of a wavelength: 0 below 2 footprints (Nyquist), 1 from 4 on."""
    return wp.clamp(0.5 * wavelength / footprint - 1.0, 0.0, 1.0)


@wp.func
def step_smoothly(low: float, high: float, x: float):
    """Cubic step from 0 at `low` to 1 at `high`."""
    s = wp.clamp((x - low) / (high - low), 0.0, 1.0)
    return s * s * (3.0 - 2.0 * s)


@wp.func
def fleck(x: float, y: float, cell: float, density: float, footprint: float, seed: wp.uint32):
    """At most one elliptic grain in each cell: (coverage from 0 to 1, tone from 0 to 1)."""
    fx = wp.floor(x / cell)
    fy = wp.floor(y / cell)
    h = lattice(int(fx), int(fy), 7, seed)
    result = wp.vec2(0.0, 0.0)
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
            # Broken pieces: an ellipse cut by a line.
            cut = 0.15 + 0.9 * unit(g, 4) - 0.8 * along - 0.6 * across
            inside = wp.min(1.0 - wp.sqrt(along * along + across * across), cut) * radius * aspect * cell / footprint
            result = wp.vec2(weight * wp.clamp(inside + 0.5, 0.0, 1.0), unit(h, 24))
    return result


@wp.func
def seabed(p: wp.vec3, normal: wp.vec3, footprint: float, seed: wp.uint32):
    """Sediment with patches of mud, mottles, shell hash and pebbles, at p in `map`."""
    patches = wp.float32(0.0)
    grain = wp.float32(0.0)
    slope_x = wp.float32(0.0)
    slope_y = wp.float32(0.0)
    wavelength = wp.float32(2.3)
    octaves = wp.int32(8)
    for octave in range(octaves):
        weight = kept(wavelength, footprint)
        if weight > 0.0:
            # Each octave is turned and shifted, so that no lattice shows.
            x = (0.8 * p[0] - 0.6 * p[1]) / wavelength + 17.3 * float(octave)
            y = (0.6 * p[0] + 0.8 * p[1]) / wavelength - 9.1 * float(octave)
            if octave % 2 == 1:
                x = (0.28 * p[0] + 0.96 * p[1]) / wavelength
                y = (0.28 * p[1] - 0.96 * p[0]) / wavelength
            n = noise2(x, y, seed + wp.uint32(octave))
            if octave < 3:
                patches += weight * n[0] * (1.0 - 0.2 * float(octave))
            else:
                grain += weight * n[0]
                if octave % 2 == 1:
                    slope_x += weight * (0.28 * n[1] - 0.96 * n[2])
                    slope_y += weight * (0.96 * n[1] + 0.28 * n[2])
                else:
                    slope_x += weight * (0.8 * n[1] + 0.6 * n[2])
                    slope_y += weight * (0.8 * n[2] - 0.6 * n[1])
        wavelength *= 0.41
    tone = step_smoothly(-0.9, 0.9, patches)
    albedo = (MUD + (SAND - MUD) * tone) * wp.max(0.25, 1.0 + 0.30 * grain)
    cell = wp.float32(0.045)
    layers = wp.int32(4)
    for layer in range(layers):
        x = p[0] * 0.936 - p[1] * 0.352
        y = p[0] * 0.352 + p[1] * 0.936
        if layer % 2 == 1:
            x = p[0] * 0.6 + p[1] * 0.8
            y = p[1] * 0.6 - p[0] * 0.8
        density = 0.30 + 0.25 * patches
        hit = fleck(x + 0.37 * float(layer), y, cell, density, footprint, seed + wp.uint32(100 + layer))
        if hit[0] > 0.0:
            colour = SHELL_HASH * (0.25 + 0.75 * hit[1] * hit[1])
            if hit[1] < 0.42:
                colour = PEBBLE * (0.8 + 2.0 * hit[1])
            albedo = albedo + (colour - albedo) * (0.85 * hit[0])
        cell *= 0.52
    material = Material()
    material.albedo = albedo
    material.normal = wp.normalize(normal - wp.vec3(slope_x, slope_y, 0.0) * 0.13)
    return material


@wp.func
def shell(
    q: wp.vec3,
    along: float,
    normal: wp.vec3,
    rotation: wp.mat33,
    colour: wp.vec3,
    silt: float,
    footprint: float,
    seed: wp.uint32,
):
    """A shell's surface: growth bands, stains, a chalky bill and silt on what faces up.

    q: point in the shell's frame in m; along: its share of the way from the umbo to the bill.
    """
    coarse = noise3(q / 0.034, seed)
    value = float(coarse[0] * kept(0.034, footprint))
    gradient = wp.vec3(coarse[1], coarse[2], coarse[3]) * (0.35 * kept(0.034, footprint))
    fine = wp.float32(0.0)
    wavelength = wp.float32(0.013)
    octaves = wp.int32(4)
    for octave in range(octaves):
        weight = kept(wavelength, footprint)
        if weight > 0.0:
            n = noise3(q / wavelength, seed + wp.uint32(octave + 1))
            fine += weight * n[0]
            gradient += wp.vec3(n[1], n[2], n[3]) * (0.55 * weight)
        wavelength *= 0.5
    reach = wp.sqrt(q[0] * q[0] + 0.7 * q[1] * q[1])
    phase = reach / 0.0105 + 0.9 * coarse[0]
    band = (phase - wp.floor(phase)) * kept(0.0105, footprint)
    albedo = colour * wp.max(0.3, 0.86 + 0.30 * band + 0.40 * value + 0.36 * fine)
    albedo = albedo * (1.0 + 0.5 * step_smoothly(0.82, 1.0, along))
    bumped = wp.normalize(normal - (rotation * gradient) * 0.22)
    cover = step_smoothly(0.15, 0.95, normal[2] + 0.55 * value + 0.35 * fine + silt - 0.75)
    material = Material()
    material.albedo = albedo + (SILT * wp.max(0.4, 1.0 + 0.25 * fine + 0.2 * value) - albedo) * (0.8 * cover)
    material.normal = bumped
    return material


@wp.func
def stone(
    q: wp.vec3, normal: wp.vec3, rotation: wp.mat33, colour: wp.vec3, silt: float, footprint: float, seed: wp.uint32
):
    """A stone's surface: mottled, speckled, silted from above; q in the stone's frame in m."""
    value = wp.float32(0.0)
    gradient = wp.vec3(0.0, 0.0, 0.0)
    wavelength = wp.float32(0.07)
    octaves = wp.int32(4)
    for octave in range(octaves):
        weight = kept(wavelength, footprint)
        if weight > 0.0:
            n = noise3(q / wavelength, seed + wp.uint32(octave))
            value += weight * n[0]
            gradient += wp.vec3(n[1], n[2], n[3]) * weight
        wavelength *= 0.4
    albedo = colour * wp.max(0.3, 1.0 + 0.45 * value)
    cover = step_smoothly(0.3, 1.0, normal[2] + 0.4 * value + silt - 0.7)
    material = Material()
    material.albedo = albedo + (SILT * (1.0 + 0.2 * value) - albedo) * (0.75 * cover)
    material.normal = wp.normalize(normal - (rotation * gradient) * 0.12)
    return material
