"""Procedural surfaces as Warp functions: what bottom, shells, stones, plants and sponges look like.

Albedo is linear. Everything is made of the noise in `noise.py`, which is exact on every processor and fades out below
a pixel's footprint.
"""

from __future__ import annotations

import warp as wp

from oysterbench.recipe import ReefRecipe
from oysterbench.render.arithmetic import clamped, greater
from oysterbench.render.coats import fish_coat, mottle
from oysterbench.render.noise import fleck, kept, lattice, noise2, noise3, pebble, scramble, step_smoothly, unit
from oysterbench.scene.instances import CLASS_NUMBERS

__all__ = ["Ground", "Material", "build_ground", "instance_material", "scramble", "seabed"]

OYSTER = wp.constant(wp.uint8(CLASS_NUMBERS["oyster"]))
HASH = wp.constant(wp.uint8(CLASS_NUMBERS["hash"]))
PLANT = wp.constant(wp.uint8(CLASS_NUMBERS["plant"]))
SPONGE = wp.constant(wp.uint8(CLASS_NUMBERS["sponge"]))
FISH = wp.constant(wp.uint8(CLASS_NUMBERS["fish"]))
CRAB = wp.constant(wp.uint8(CLASS_NUMBERS["crab"]))
DEBRIS = wp.constant(wp.uint8(CLASS_NUMBERS["debris"]))
TETHER = wp.constant(wp.uint8(CLASS_NUMBERS["tether"]))

SHELL_HASH = wp.constant(wp.vec3(0.520, 0.490, 0.420))
PEBBLE = wp.constant(wp.vec3(0.050, 0.048, 0.042))
INSIDE = wp.constant(wp.vec3(0.560, 0.535, 0.480))
FILLED = wp.constant(0.85)  # share of a shell's ridges that sediment levels where it covers all
SCAR = wp.constant(wp.vec3(0.190, 0.130, 0.180))
FILM = wp.constant(wp.vec3(0.105, 0.110, 0.050))  # of algae on what sees light
BARNACLE = wp.constant(wp.vec3(0.480, 0.460, 0.410))

# Linear albedo of dark and light patches and of settled sediment; strength of the fine relief; density of flecks and
# the share of shell among them; side of the cells of packed pebbles, m.
BOTTOMS = {
    "sand": ((0.130, 0.120, 0.092), (0.270, 0.245, 0.190), (0.215, 0.200, 0.155), 0.13, 0.30, 0.58, 0.0),
    "mud": ((0.070, 0.066, 0.050), (0.135, 0.125, 0.095), (0.150, 0.138, 0.104), 0.07, 0.10, 0.45, 0.0),
    "gravel": ((0.110, 0.104, 0.090), (0.260, 0.245, 0.210), (0.180, 0.168, 0.132), 0.10, 0.20, 0.35, 0.021),
    "shell": ((0.150, 0.140, 0.110), (0.300, 0.280, 0.225), (0.190, 0.178, 0.138), 0.12, 0.85, 0.86, 0.0),
}


@wp.struct
class Ground:
    """What the bottom is made of, as in BOTTOMS; cover: share of sediment on what faces up, 0 to 1."""

    dark: wp.vec3
    light: wp.vec3
    silt: wp.vec3
    bump: wp.float32
    flecks: wp.float32
    shells: wp.float32
    pebbles: wp.float32
    cover: wp.float32


@wp.struct
class Material:
    """Linear albedo and unit normal in `map`."""

    albedo: wp.vec3
    normal: wp.vec3


def build_ground(reef: ReefRecipe) -> Ground:
    """The ground of a recipe."""
    dark, light, silt, bump, flecks, shells, pebbles = BOTTOMS[reef.bottom]
    ground = Ground()
    ground.dark, ground.light, ground.silt = wp.vec3(*dark), wp.vec3(*light), wp.vec3(*silt)
    ground.bump, ground.flecks, ground.shells, ground.pebbles = bump, flecks, shells, pebbles
    ground.cover = reef.silt
    return ground


@wp.func
def seabed(p: wp.vec3, normal: wp.vec3, ground: Ground, footprint: float, seed: wp.uint32):
    """Sediment with patches, mottles, pebbles and shell hash, at p in `map`."""
    patches = wp.float32(0.0)
    grain = wp.float32(0.0)
    slope_x = wp.float32(0.0)
    slope_y = wp.float32(0.0)
    wavelength = wp.float32(2.3)
    octaves = wp.int32(10)
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
    albedo = (ground.dark + (ground.light - ground.dark) * tone) * greater(0.25, 1.0 + 0.24 * grain)
    slope_x *= ground.bump
    slope_y *= ground.bump
    if ground.pebbles > 0.0:
        cell = ground.pebbles
        weight = kept(cell, 0.5 * footprint)
        if weight > 0.0:
            x = p[0] * 0.936 - p[1] * 0.352
            y = p[0] * 0.352 + p[1] * 0.936
            top = pebble(x, y, cell, seed + wp.uint32(50))
            if top[0] < 0.45:
                top = pebble(y + 0.31, x, 0.45 * cell, seed + wp.uint32(51))
                top = wp.vec4(0.6 * top[0], top[2], top[1], top[3])
            mineral = albedo * (0.55 + 0.9 * top[3]) * (0.35 + 0.75 * top[0])
            albedo = albedo + (mineral - albedo) * weight
            slope_x -= 0.55 * weight * (0.936 * top[1] + 0.352 * top[2])
            slope_y -= 0.55 * weight * (0.936 * top[2] - 0.352 * top[1])
    cell = wp.float32(0.034)
    layers = wp.int32(4)
    for layer in range(layers):
        x = p[0] * 0.936 - p[1] * 0.352
        y = p[0] * 0.352 + p[1] * 0.936
        if layer % 2 == 1:
            x = p[0] * 0.6 + p[1] * 0.8
            y = p[1] * 0.6 - p[0] * 0.8
        density = ground.flecks * (1.0 + 0.8 * patches)
        hit = wp.vec4(0.0, 0.0, 0.0, 0.0)
        if kept(0.6 * cell, 0.7 * footprint) > 0.0:  # no grain is larger
            hit = fleck(x + 0.37 * float(layer), y, cell, density, footprint, seed + wp.uint32(100 + layer))
        if hit[0] > 0.0:
            # Sediment has settled on most of the pieces.
            pale = (hit[1] + ground.shells - 1.0) / ground.shells
            colour = ground.silt + (SHELL_HASH - ground.silt) * (pale * pale * (1.0 - 0.6 * ground.cover))
            if pale < 0.0:
                colour = PEBBLE * (0.8 + 2.0 * hit[1])
                colour = colour + (ground.silt - colour) * (0.5 * ground.cover)
            albedo = albedo + (colour * (1.0 + 0.25 * grain) - albedo) * (0.85 * hit[0])
            # From the grain's turned axes to those of the map.
            east = 0.936 * hit[2] + 0.352 * hit[3]
            north = 0.936 * hit[3] - 0.352 * hit[2]
            if layer % 2 == 1:
                east = 0.6 * hit[2] - 0.8 * hit[3]
                north = 0.8 * hit[2] + 0.6 * hit[3]
            slope_x += (0.55 * east - 0.6 * slope_x) * hit[0]
            slope_y += (0.55 * north - 0.6 * slope_y) * hit[0]
        cell *= 0.56
    material = Material()
    material.albedo = albedo
    material.normal = wp.normalize(normal - wp.vec3(slope_x, slope_y, 0.0))
    return material


@wp.func
def barnacle(x: float, y: float, cell: float, footprint: float, seed: wp.uint32):
    """At most one barnacle in each cell: (cover, slopes in x and y, darkness of its mouth)."""
    fx = wp.floor(x / cell)
    fy = wp.floor(y / cell)
    h = lattice(int(fx), int(fy), 11, seed)
    result = wp.vec4(0.0, 0.0, 0.0, 0.0)
    if unit(h, 0) < 0.35:
        radius = 0.16 + 0.16 * unit(h, 8)
        dx = x / cell - fx - (0.34 + 0.32 * unit(h, 16))
        dy = y / cell - fy - (0.34 + 0.32 * unit(h, 24))
        r = wp.sqrt(dx * dx + dy * dy) + 1.0e-6
        edge = clamped((radius - r) * cell / footprint + 0.5, 0.0, 1.0)
        mouth = clamped((0.38 * radius - r) * cell / footprint + 0.5, 0.0, 1.0)
        result = wp.vec4(edge, -dx / r, -dy / r, mouth)
    return result


@wp.func
def shell(
    q: wp.vec3,
    mark: wp.vec3,
    height: float,
    normal: wp.vec3,
    rotation: wp.mat33,
    colour: wp.vec3,
    silt: float,
    ground: Ground,
    footprint: float,
    seed: wp.uint32,
):
    """A shell's surface: growth bands, stains, fouling, a chalky margin, a pale inside, silt on what faces up.

    q: point in the shell's frame in m; mark: growth, inside and scar as in scene.oyster; height: of the shell, m.
    """
    coarse = noise3(q / 0.034, seed)
    value = float(coarse[0] * kept(0.034, footprint))
    gradient = wp.vec3(coarse[1], coarse[2], coarse[3]) * (0.30 * kept(0.034, footprint))
    fine = wp.float32(0.0)
    wavelength = wp.float32(0.013)
    octaves = wp.int32(5)
    for octave in range(octaves):
        weight = kept(wavelength, footprint)
        if weight > 0.0:
            n = noise3(q / wavelength, seed + wp.uint32(octave + 1))
            fine += weight * n[0]
            gradient += wp.vec3(n[1], n[2], n[3]) * (0.50 * weight)
        wavelength *= 0.5
    outside = 1.0 - clamped(mark[1], 0.0, 1.0)
    # Bands of a season and, finer, of a spring tide, along the margins that the shell had.
    age = mark[0] * height
    radial = wp.vec3(q[0], 1.6 * q[1], 0.0)
    radial = radial / (wp.length(radial) + 1.0e-6)
    phase = age / 0.0105 + 0.8 * coarse[0] + 0.12 * fine
    band = phase - wp.floor(phase)
    finer = age / 0.0031 + 0.6 * coarse[0] + 0.7 * fine
    ridge = finer - wp.floor(finer)
    # A lamella rises gently and breaks off; not every one is as strong along all of its rim.
    wide = kept(0.0080, footprint) * outside
    close = kept(0.0031, footprint) * outside
    strong = clamped(0.6 + 0.9 * coarse[3], 0.0, 1.3)
    brink = step_smoothly(0.62, 0.80, band) * (1.0 - step_smoothly(0.90, 1.0, band))
    # Sediment stays where the surface is flat and rough, and fills what the shell has grown.
    settled = normal[2] + 0.45 * value + 0.40 * fine + silt + 1.7 * ground.cover - 1.6
    cover = step_smoothly(0.15, 0.95, settled)
    dust = ground.cover * (0.25 + 0.35 * silt) * (0.75 + 0.25 * normal[2])
    cover = cover + (1.0 - cover) * dust
    bare = 1.0 - FILLED * cover
    gradient = gradient + radial * (bare * (wide * strong * (0.9 - 6.0 * brink) + close * (1.3 * (0.5 - ridge))))
    band = band * kept(0.0105, footprint)
    ridge = ridge * close
    outer = colour * greater(0.3, 0.80 + 0.26 * band + 0.22 * ridge + 0.36 * value + 0.28 * fine)
    outer = outer * (1.0 + 0.45 * step_smoothly(0.90, 1.0, mark[0]))
    film = step_smoothly(0.1, 0.8, 1.3 * coarse[2] - 0.5 * value + 0.3 * fine + 0.4 * normal[2])
    outer = outer + (FILM * (1.0 + 0.4 * fine) - outer) * (0.55 * film)
    if outside > 0.5 and footprint < 0.0035 and unit(seed, 8) < 0.4:
        cell = barnacle(q[0], q[1], 0.014, footprint, seed)
        weight = cell[0] * step_smoothly(0.05, 0.35, coarse[0]) * kept(0.007, footprint)
        outer = outer + (BARNACLE * (1.0 - 0.85 * cell[3]) - outer) * (0.85 * weight)
        gradient = gradient + wp.vec3(cell[1], cell[2], 0.0) * (2.5 * weight * (1.0 - cell[3]))
    inner = INSIDE * (0.92 + 0.10 * value + 0.05 * fine)
    inner = inner + (SCAR - inner) * (0.75 * mark[2])
    inner = inner * (0.6 + 0.4 * step_smoothly(0.0, 0.25, mark[0]))
    albedo = outer * outside + inner * (1.0 - outside)
    relief = 0.08 + 0.16 * outside
    bumped = wp.normalize(normal - (rotation * gradient) * relief)
    material = Material()
    # Settled sediment is a fuzz of grains and turf.
    tone = 1.0 + 0.22 * fine + 0.2 * value
    grains = kept(0.0019, footprint) * cover
    if grains > 0.0:
        fuzz = noise3(q / 0.0019, seed + wp.uint32(41))
        bumped = wp.normalize(bumped - (rotation * wp.vec3(fuzz[1], fuzz[2], fuzz[3])) * (0.22 * grains))
        tone += 0.28 * fuzz[0] * grains
    silted = ground.silt * greater(0.35, tone)
    material.albedo = albedo + (silted - albedo) * (0.90 * cover)
    material.normal = bumped
    return material


@wp.func
def stone(
    q: wp.vec3,
    normal: wp.vec3,
    rotation: wp.mat33,
    colour: wp.vec3,
    silt: float,
    ground: Ground,
    footprint: float,
    seed: wp.uint32,
):
    """A stone's surface: mottled, speckled, filmed and silted from above; q in the stone's frame in m."""
    value = wp.float32(0.0)
    gradient = wp.vec3(0.0, 0.0, 0.0)
    wavelength = wp.float32(0.07)
    octaves = wp.int32(5)
    for octave in range(octaves):
        weight = kept(wavelength, footprint)
        if weight > 0.0:
            n = noise3(q / wavelength, seed + wp.uint32(octave))
            value += weight * n[0]
            gradient += wp.vec3(n[1], n[2], n[3]) * weight
        wavelength *= 0.4
    albedo = colour * greater(0.3, 1.0 + 0.45 * value)
    film = step_smoothly(0.0, 0.9, value + 0.5 * normal[2])
    albedo = albedo + (FILM - albedo) * (0.4 * film)
    cover = step_smoothly(0.3, 1.0, normal[2] + 0.4 * value + silt + 1.2 * ground.cover - 1.3)
    material = Material()
    material.albedo = albedo + (ground.silt * (1.0 + 0.2 * value) - albedo) * (0.8 * cover)
    material.normal = wp.normalize(normal - (rotation * gradient) * 0.12)
    return material


@wp.func
def plant(mark: wp.vec3, normal: wp.vec3, colour: wp.vec3, ground: Ground, footprint: float, seed: wp.uint32):
    """A blade: mark is the share of its length, its own tone and the place across; older towards the tip."""
    n = noise2(mark[0] * 9.0, mark[1] * 37.0, seed)
    weight = kept(0.02, footprint)
    albedo = colour * (0.65 + 0.6 * mark[1]) * (1.0 + 0.3 * n[0] * weight)
    withered = step_smoothly(0.55, 1.0, mark[0] + 0.3 * mark[1])
    albedo = albedo + (wp.vec3(0.16, 0.12, 0.055) - albedo) * (0.6 * withered)
    cover = clamped(ground.cover * (0.35 + 0.4 * normal[2] + 0.3 * n[0]), 0.0, 0.8)
    material = Material()
    material.albedo = albedo + (ground.silt - albedo) * cover
    material.normal = normal
    return material


@wp.func
def sponge(
    q: wp.vec3, normal: wp.vec3, rotation: wp.mat33, colour: wp.vec3, ground: Ground, footprint: float, seed: wp.uint32
):
    """A sponge's surface: fleshy, with pores; q in its frame in m."""
    a = noise3(q / 0.011, seed)
    b = noise3(q / 0.0031, seed + wp.uint32(1))
    wide = kept(0.011, footprint)
    close = kept(0.0031, footprint)
    pore = step_smoothly(0.45, 0.75, b[0]) * close
    albedo = colour * greater(0.2, 1.0 + 0.25 * a[0] * wide - 0.55 * pore)
    gradient = wp.vec3(a[1], a[2], a[3]) * (0.6 * wide) + wp.vec3(b[1], b[2], b[3]) * (0.35 * close)
    cover = step_smoothly(0.4, 1.0, normal[2] + 0.4 * a[0] + ground.cover - 0.6)
    material = Material()
    material.albedo = albedo + (ground.silt - albedo) * (0.6 * cover)
    material.normal = wp.normalize(normal - (rotation * gradient) * 0.15)
    return material


@wp.func
def instance_material(
    kind: wp.uint8,
    q: wp.vec3,
    mark: wp.vec3,
    height: float,
    normal: wp.vec3,
    rotation: wp.mat33,
    colour: wp.vec3,
    silt: float,
    ground: Ground,
    footprint: float,
    seed: wp.uint32,
):
    """The material of an instance of class `kind` at q, m in its own frame."""
    material = Material()
    if kind == OYSTER or kind == HASH:  # noqa: SIM109 - Warp has no `in`
        material = shell(q, mark, height, normal, rotation, colour, silt, ground, footprint, seed)
    elif kind == PLANT:
        material = plant(mark, normal, colour, ground, footprint, seed)
    elif kind == SPONGE:
        material = sponge(q, normal, rotation, colour, ground, footprint, seed)
    elif kind == FISH:
        material.albedo = fish_coat(mark, colour, height, footprint, seed)
        material.normal = normal
    elif kind == CRAB:
        material.albedo = wp.cw_mul(mark, colour) * mottle(q, 0.18 * height, footprint, seed)
        material.normal = normal
    elif kind == DEBRIS or kind == TETHER:  # noqa: SIM109
        material.albedo = wp.cw_mul(mark, colour) * mottle(q, 0.012, footprint, seed)
        material.normal = normal
    else:
        material = stone(q, normal, rotation, colour, silt, ground, footprint, seed)
    return material
