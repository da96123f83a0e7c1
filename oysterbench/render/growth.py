"""Deposits and growth on surfaces, as Warp functions: a drape of loose silt, short turf, fouling, specks of shell."""

from __future__ import annotations

import warp as wp

from oysterbench.render.arithmetic import clamped, greater
from oysterbench.render.noise import fleck, kept, lattice, noise2, noise3, nth, step_smoothly, unit

SMOOTHED = wp.constant(0.90)  # share of a surface's own relief and mottling that a full drape hides
FLUFF = wp.constant(0.45)  # share of the grain of settled sediment that a full drape hides
FUR_GREEN = wp.constant(wp.vec3(0.160, 0.160, 0.085))  # of the short turf that binds some silt
FUR_BROWN = wp.constant(wp.vec3(0.135, 0.110, 0.070))
PATCH_M, LOCK_M, HAIR_M = wp.constant(0.030), wp.constant(0.0042), wp.constant(0.0018)  # wavelengths of the fur
BARNACLE = wp.constant(wp.vec3(0.480, 0.460, 0.410))
CLUSTER_M = wp.constant(0.028)  # wavelength of the clusters of barnacles, tubes and spat
SETTLERS_CELL_M, SPAT_CELL_M = wp.constant(0.011), wp.constant(0.034)
TUBE = wp.constant(wp.vec3(0.430, 0.405, 0.340))
TUBE_M, TUBE_BEND_M = wp.constant(0.0009), wp.constant(0.016)  # radius of a worm's tube, and how tightly it winds
SPAT = wp.constant(wp.vec3(0.300, 0.275, 0.225))
SPECK_CELL_M = wp.constant(0.005)
SPECK_DENSITY = wp.constant(0.06)  # share of cells that hold a speck at maximum grit
MOUTH_CELL_M, MOUTHS_M = wp.constant(0.012), wp.constant(0.09)  # cell of a burrow, wavelength of their clusters
DARK = wp.constant(0.70)  # share of the light that a burrow's mouth absorbs
SPECK = wp.constant(wp.vec3(0.80, 0.79, 0.74))


@wp.struct
class Growth:
    """Growth at a point: its share of the surface, its albedo, and the gradient that bends the normal, in q's frame."""

    cover: wp.float32
    albedo: wp.vec3
    gradient: wp.vec3


@wp.func
def barnacle(x: float, y: float, cell: float, footprint: float, seed: wp.vec2ui):
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
def foul(q: wp.vec3, share: float, footprint: float, seed: wp.vec2ui):
    """Barnacles, worm tubes and spat in clusters on the outside of a shell; q: point in the shell's frame, m."""
    cluster = noise3(q / CLUSTER_M, nth(seed, 91))
    least = 0.9 - 1.5 * share
    out = Growth()
    young = barnacle(q[0], q[1], SPAT_CELL_M, footprint, nth(seed, 92))
    spat = young[0] * step_smoothly(least, least + 0.3, cluster[2] * 0.6)
    out.cover = spat
    out.albedo = SPAT * (1.0 - 0.35 * young[3])
    out.gradient = wp.vec3(young[1], young[2], 0.0) * (0.8 * spat)
    wind = noise3(q / TUBE_BEND_M, nth(seed, 93))
    slope = wp.vec3(wind[1], wind[2], wind[3])
    steep = greater(wp.length(slope), 0.35)
    beside = wp.abs(wind[0]) / steep * TUBE_BEND_M
    thick = greater(TUBE_M, 0.5 * footprint)
    tube = clamped((thick - beside) / footprint + 0.5, 0.0, 1.0) * (TUBE_M / thick)
    tube = tube * step_smoothly(least + 0.1, least + 0.4, cluster[0])
    out.albedo = out.albedo + (TUBE - out.albedo) * tube
    out.gradient = out.gradient + slope * (-1.2 * wind[0] / (wp.abs(wind[0]) + 1.0e-3) * tube / steep)
    out.cover = greater(out.cover, tube)
    acorn = barnacle(q[0], q[1], SETTLERS_CELL_M, footprint, nth(seed, 94))
    cone = acorn[0] * step_smoothly(least, least + 0.3, -cluster[0]) * kept(0.006, footprint)
    out.albedo = out.albedo + (BARNACLE * (1.0 - 0.85 * acorn[3]) - out.albedo) * cone
    out.gradient = out.gradient + wp.vec3(acorn[1], acorn[2], 0.0) * (2.5 * cone * (1.0 - acorn[3]))
    out.cover = greater(out.cover, cone)
    return out


@wp.func
def lying(drape: float, normal: wp.vec3, uneven: float):
    """Share of a surface covered by loose silt: all if it faces up, less on walls, little under an overhang."""
    return drape * step_smoothly(-0.75, 0.15, normal[2] + 0.25 * uneven + drape - 1.0)


@wp.func
def fur(q: wp.vec3, normal: wp.vec3, share: float, footprint: float, seed: wp.vec2ui):
    """Turf on a surface with a normal given in `map`; q: point in the surface's own frame, m."""
    patch = noise3(q / PATCH_M, nth(seed, 61))
    lock = noise3(q / LOCK_M, nth(seed, 62))
    hair = noise3(q / HAIR_M, nth(seed, 63))
    coarse = kept(LOCK_M, footprint)
    close = kept(HAIR_M, footprint)
    out = Growth()
    lit = 0.5 * normal[2] + 0.55 * patch[0] + 0.2 * lock[0] * coarse
    out.cover = step_smoothly(0.85 - 1.6 * share, 1.35 - 1.6 * share, lit)
    mixed = step_smoothly(-0.5, 0.5, patch[1] * 0.5 + 0.2 * lock[0])
    tone = 1.0 + 0.20 * lock[0] * coarse + 0.45 * hair[0] * close
    out.albedo = (FUR_GREEN + (FUR_BROWN - FUR_GREEN) * mixed) * tone
    out.gradient = wp.vec3(lock[1], lock[2], lock[3]) * (0.5 * coarse) + wp.vec3(hair[1], hair[2], hair[3]) * (
        0.9 * close
    )
    return out


@wp.func
def speck(x: float, y: float, grit: float, footprint: float, seed: wp.vec2ui):
    """White specks at x, y, m: their share of a pixel, and their brightness, 0 to 1."""
    grain = fleck(x, y, SPECK_CELL_M, SPECK_DENSITY * grit, footprint, nth(seed, 71))
    return wp.vec2(grain[0], 0.45 + 0.55 * grain[1])


@wp.func
def mouth(x: float, y: float, burrows: float, footprint: float, seed: wp.vec2ui):
    """Burrow mouths in low, clustered mounds at x, y, m: (darkness, slopes of the mounds in x and y)."""
    mound = barnacle(x, y, MOUTH_CELL_M, footprint, nth(seed, 81))
    cluster = noise2(x / MOUTHS_M, y / MOUTHS_M, nth(seed, 82))
    there = step_smoothly(0.8 - 1.9 * burrows, 1.0 - 1.9 * burrows, cluster[0]) * kept(0.006, footprint)
    rim = mound[0] * (1.0 - mound[3]) * there
    return wp.vec3((0.15 * mound[0] + 0.85 * mound[3]) * there, mound[1] * rim, mound[2] * rim)
