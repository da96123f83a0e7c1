"""The bottom as Warp functions: sediment with patches, mottles, pebbles, broken shell, loose silt and burrows."""

from __future__ import annotations

import warp as wp

from oysterbench.recipe import ReefRecipe
from oysterbench.render.arithmetic import greater
from oysterbench.render.growth import DARK, SMOOTHED, SPECK, mouth, speck
from oysterbench.render.noise import fleck, kept, noise2, nth, pebble, step_smoothly

SHELL_HASH = wp.constant(wp.vec3(0.520, 0.490, 0.420))
PEBBLE = wp.constant(wp.vec3(0.050, 0.048, 0.042))

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
    """Composition of the bottom, as in BOTTOMS; cover: share of sediment on upward-facing surfaces, 0 to 1; drape,
    turf, grit, burrows, fouling: as in ReefRecipe."""

    dark: wp.vec3
    light: wp.vec3
    silt: wp.vec3
    bump: wp.float32
    flecks: wp.float32
    shells: wp.float32
    pebbles: wp.float32
    cover: wp.float32
    drape: wp.float32
    turf: wp.float32
    grit: wp.float32
    burrows: wp.float32
    fouling: wp.float32


@wp.struct
class Material:
    """Material of a surface: linear albedo, and unit normal in `map`."""

    albedo: wp.vec3
    normal: wp.vec3


def build_ground(reef: ReefRecipe) -> Ground:
    """Build the ground of a recipe."""
    dark, light, silt, bump, flecks, shells, pebbles = BOTTOMS[reef.bottom]
    ground = Ground()
    ground.dark, ground.light, ground.silt = wp.vec3(*dark), wp.vec3(*light), wp.vec3(*silt)
    ground.bump, ground.flecks, ground.shells, ground.pebbles = bump, flecks, shells, pebbles
    ground.cover = reef.silt
    ground.drape, ground.turf, ground.grit, ground.burrows = reef.drape, reef.turf, reef.grit, reef.burrows
    ground.fouling = reef.fouling
    return ground


@wp.func
def seabed(p: wp.vec3, normal: wp.vec3, ground: Ground, footprint: float, seed: wp.vec2ui):
    """Material of the seabed at p in `map`: sediment with patches, mottling, pebbles and shell hash."""
    patches = wp.float32(0.0)
    grain = wp.float32(0.0)
    slope_x = wp.float32(0.0)
    slope_y = wp.float32(0.0)
    wavelength = wp.float32(2.3)
    octaves = wp.int32(10)
    for octave in range(octaves):
        weight = kept(wavelength, footprint)
        if weight > 0.0:
            # Each octave is rotated and shifted, so that no lattice shows.
            x = (0.8 * p[0] - 0.6 * p[1]) / wavelength + 17.3 * float(octave)
            y = (0.6 * p[0] + 0.8 * p[1]) / wavelength - 9.1 * float(octave)
            if octave % 2 == 1:
                x = (0.28 * p[0] + 0.96 * p[1]) / wavelength
                y = (0.28 * p[1] - 0.96 * p[0]) / wavelength
            n = noise2(x, y, nth(seed, octave))
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
    if ground.drape > 0.0:
        kept_of_it = 1.0 - SMOOTHED * ground.drape
        patches = patches * kept_of_it
        grain = grain * kept_of_it
        slope_x = slope_x * kept_of_it
        slope_y = slope_y * kept_of_it
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
            top = pebble(x, y, cell, nth(seed, 50))
            if top[0] < 0.45:
                top = pebble(y + 0.31, x, 0.45 * cell, nth(seed, 51))
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
        if ground.drape > 0.0:
            density = density * (1.0 - SMOOTHED * ground.drape)
        hit = wp.vec4(0.0, 0.0, 0.0, 0.0)
        if kept(0.6 * cell, 0.7 * footprint) > 0.0:  # no grain is larger
            hit = fleck(x + 0.37 * float(layer), y, cell, density, footprint, nth(seed, 100 + layer))
        if hit[0] > 0.0:
            # Sediment has settled on most of the pieces.
            pale = (hit[1] + ground.shells - 1.0) / ground.shells
            colour = ground.silt + (SHELL_HASH - ground.silt) * (pale * pale * (1.0 - 0.6 * ground.cover))
            if pale < 0.0:
                colour = PEBBLE * (0.8 + 2.0 * hit[1])
                colour = colour + (ground.silt - colour) * (0.5 * ground.cover)
            albedo = albedo + (colour * (1.0 + 0.25 * grain) - albedo) * (0.85 * hit[0])
            # From the grain's rotated axes to those of the map.
            east = 0.936 * hit[2] + 0.352 * hit[3]
            north = 0.936 * hit[3] - 0.352 * hit[2]
            if layer % 2 == 1:
                east = 0.6 * hit[2] - 0.8 * hit[3]
                north = 0.8 * hit[2] + 0.6 * hit[3]
            slope_x += (0.55 * east - 0.6 * slope_x) * hit[0]
            slope_y += (0.55 * north - 0.6 * slope_y) * hit[0]
        cell *= 0.56
    if ground.drape > 0.0:
        fluff = ground.silt * (1.0 + 0.35 * grain + 0.08 * patches)
        albedo = albedo + (fluff - albedo) * ground.drape
    if ground.burrows > 0.0:
        burrow = mouth(p[0], p[1], ground.burrows, footprint, seed)
        albedo = albedo * (1.0 - DARK * burrow[0])
        slope_x += 0.6 * burrow[1]
        slope_y += 0.6 * burrow[2]
    if ground.grit > 0.0:
        white = speck(p[0], p[1], ground.grit, footprint, seed)
        albedo = albedo + (SPECK * white[1] - albedo) * white[0]
    material = Material()
    material.albedo = albedo
    material.normal = wp.normalize(normal - wp.vec3(slope_x, slope_y, 0.0))
    return material
