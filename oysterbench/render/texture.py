"""Procedural surfaces of shells, stones, plants and sponges as Warp functions; the bottom is in `ground.py`.

Albedo is linear. Everything is built from the noise in `noise.py`, which is exact on every processor and fades out
below a pixel's footprint.
"""

from __future__ import annotations

import warp as wp

from oysterbench.render.arithmetic import clamped, greater
from oysterbench.render.coats import fish_coat, mottle
from oysterbench.render.ground import Ground, Material
from oysterbench.render.growth import BARNACLE, FLUFF, SMOOTHED, SPECK, barnacle, foul, fur, lying, speck
from oysterbench.render.noise import kept, noise2, noise3, nth, own_hash, step_smoothly, unit
from oysterbench.scene.instances import CLASS_NUMBERS

__all__ = ["Material", "instance_material"]

OYSTER = wp.constant(wp.uint8(CLASS_NUMBERS["oyster"]))
HASH = wp.constant(wp.uint8(CLASS_NUMBERS["hash"]))
PLANT = wp.constant(wp.uint8(CLASS_NUMBERS["plant"]))
SPONGE = wp.constant(wp.uint8(CLASS_NUMBERS["sponge"]))
FISH = wp.constant(wp.uint8(CLASS_NUMBERS["fish"]))
CRAB = wp.constant(wp.uint8(CLASS_NUMBERS["crab"]))
DEBRIS = wp.constant(wp.uint8(CLASS_NUMBERS["debris"]))
TETHER = wp.constant(wp.uint8(CLASS_NUMBERS["tether"]))

INSIDE = wp.constant(wp.vec3(0.560, 0.535, 0.480))
FILLED = wp.constant(0.85)  # share of a shell's ridges that sediment levels at full cover
SCAR = wp.constant(wp.vec3(0.190, 0.130, 0.180))
FILM = wp.constant(wp.vec3(0.105, 0.110, 0.050))  # of algae on lit surfaces


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
    seed: wp.vec2ui,
):
    """Surface of a shell: growth bands, stains, fouling, a chalky margin, a pale inside, silt where it faces up.

    q: point in the shell's frame, m; mark: growth, inside and scar as in scene.oyster; height: of the shell, m.
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
            n = noise3(q / wavelength, nth(seed, octave + 1))
            fine += weight * n[0]
            gradient += wp.vec3(n[1], n[2], n[3]) * (0.50 * weight)
        wavelength *= 0.5
    outside = 1.0 - clamped(mark[1], 0.0, 1.0)
    # Seasonal bands and finer ones of spring tides, along the shell's former margins.
    age = mark[0] * height
    radial = wp.vec3(q[0], 1.6 * q[1], 0.0)
    radial = radial / (wp.length(radial) + 1.0e-6)
    phase = age / 0.0105 + 0.8 * coarse[0] + 0.12 * fine
    band = phase - wp.floor(phase)
    finer = age / 0.0031 + 0.6 * coarse[0] + 0.7 * fine
    ridge = finer - wp.floor(finer)
    # A lamella rises gently and breaks off; its strength varies along its rim.
    wide = kept(0.0080, footprint) * outside
    close = kept(0.0031, footprint) * outside
    strong = clamped(0.6 + 0.9 * coarse[3], 0.0, 1.3)
    brink = step_smoothly(0.62, 0.80, band) * (1.0 - step_smoothly(0.90, 1.0, band))
    # Sediment stays where the surface is flat and rough, and fills the shell's relief.
    settled = normal[2] + 0.45 * value + 0.40 * fine + silt + 1.7 * ground.cover - 1.6
    cover = step_smoothly(0.15, 0.95, settled)
    dust = ground.cover * (0.25 + 0.35 * silt) * (0.75 + 0.25 * normal[2])
    cover = cover + (1.0 - cover) * dust
    draped = wp.float32(0.0)
    if ground.drape > 0.0:
        draped = lying(ground.drape, normal, coarse[0] * kept(0.034, footprint))
        cover = cover + (1.0 - cover) * draped
        gradient = gradient * (1.0 - SMOOTHED * draped)
        value = value * (1.0 - SMOOTHED * draped)
        fine = fine * (1.0 - SMOOTHED * draped)
    bare = 1.0 - FILLED * cover
    gradient = gradient + radial * (bare * (wide * strong * (0.9 - 6.0 * brink) + close * (1.3 * (0.5 - ridge))))
    band = band * kept(0.0105, footprint)
    ridge = ridge * close
    outer = colour * greater(0.3, 0.80 + 0.26 * band + 0.22 * ridge + 0.36 * value + 0.28 * fine)
    outer = outer * (1.0 + 0.45 * step_smoothly(0.90, 1.0, mark[0]))
    film = step_smoothly(0.1, 0.8, 1.3 * coarse[2] - 0.5 * value + 0.3 * fine + 0.4 * normal[2])
    outer = outer + (FILM * (1.0 + 0.4 * fine) - outer) * (0.55 * film)
    if outside > 0.5 and footprint < 0.0035 and unit(own_hash(seed), 8) < 0.4:
        cell = barnacle(q[0], q[1], 0.014, footprint, seed)
        weight = cell[0] * step_smoothly(0.05, 0.35, coarse[0]) * kept(0.007, footprint)
        outer = outer + (BARNACLE * (1.0 - 0.85 * cell[3]) - outer) * (0.85 * weight)
        gradient = gradient + wp.vec3(cell[1], cell[2], 0.0) * (2.5 * weight * (1.0 - cell[3]))
    if ground.fouling > 0.0 and outside > 0.5:
        grown = foul(q, ground.fouling, footprint, seed)
        outer = outer + (grown.albedo - outer) * (0.85 * grown.cover)
        gradient = gradient + grown.gradient * grown.cover
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
    if draped > 0.0:
        grains = grains * (1.0 - FLUFF * draped)
    if grains > 0.0:
        fuzz = noise3(q / 0.0019, nth(seed, 41))
        bumped = wp.normalize(bumped - (rotation * wp.vec3(fuzz[1], fuzz[2], fuzz[3])) * (0.22 * grains))
        tone += 0.28 * fuzz[0] * grains
    silted = ground.silt * greater(0.35, tone)
    albedo = albedo + (silted - albedo) * (0.90 * cover + 0.08 * draped)
    if ground.turf > 0.0:
        grown = fur(q, normal, ground.turf, footprint, seed)
        albedo = albedo + (grown.albedo - albedo) * (grown.cover * (1.0 - 0.6 * draped))
        bumped = wp.normalize(bumped - (rotation * grown.gradient) * (0.30 * grown.cover))
    if ground.grit > 0.0:
        white = speck(q[0], q[1], ground.grit, footprint, seed)
        albedo = albedo + (SPECK * white[1] - albedo) * white[0]
    material.albedo = albedo
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
    seed: wp.vec2ui,
):
    """Surface of a stone: mottled, speckled, with an algal film, and silted from above; q: in the stone's frame, m."""
    value = wp.float32(0.0)
    gradient = wp.vec3(0.0, 0.0, 0.0)
    wavelength = wp.float32(0.07)
    octaves = wp.int32(5)
    for octave in range(octaves):
        weight = kept(wavelength, footprint)
        if weight > 0.0:
            n = noise3(q / wavelength, nth(seed, octave))
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
def plant(mark: wp.vec3, normal: wp.vec3, colour: wp.vec3, ground: Ground, footprint: float, seed: wp.vec2ui):
    """Surface of a blade, older towards the tip; mark: share of its length, its own tone and the position across."""
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
    q: wp.vec3, normal: wp.vec3, rotation: wp.mat33, colour: wp.vec3, ground: Ground, footprint: float, seed: wp.vec2ui
):
    """Surface of a sponge: fleshy, with pores; q: point in its frame, m."""
    a = noise3(q / 0.011, seed)
    b = noise3(q / 0.0031, nth(seed, 1))
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
    seed: wp.vec2ui,
):
    """Material of an instance of class `kind` at a point q, m, in its own frame."""
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
