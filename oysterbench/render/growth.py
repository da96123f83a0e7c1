"""What lies and grows on surfaces, as Warp functions: a drape of loose silt, a fur of short algae, specks of shell."""

from __future__ import annotations

import warp as wp

from oysterbench.render.noise import fleck, kept, noise3, step_smoothly

SMOOTHED = wp.constant(0.90)  # share of a surface's own relief and mottles that a whole drape hides
FLUFF = wp.constant(0.45)  # share of the grain of settled sediment that a whole drape hides
FUR_GREEN = wp.constant(wp.vec3(0.160, 0.160, 0.085))  # of the short turf that binds some silt
FUR_BROWN = wp.constant(wp.vec3(0.135, 0.110, 0.070))
PATCH_M, LOCK_M, HAIR_M = wp.constant(0.030), wp.constant(0.0042), wp.constant(0.0018)  # wavelengths of the fur
SPECK_CELL_M = wp.constant(0.005)
SPECK_DENSITY = wp.constant(0.06)  # of its cells that hold a speck where there is all the grit that there can be
MOUTH_CELL_M, MOUTH_DENSITY = wp.constant(0.022), wp.constant(0.75)
DARK = wp.constant(0.70)  # share of the light that a burrow's mouth swallows
SPECK = wp.constant(wp.vec3(0.80, 0.79, 0.74))


@wp.struct
class Fur:
    """A fur at a point: its share of the surface, its albedo, and what its locks do to the normal, in q's frame."""

    cover: wp.float32
    albedo: wp.vec3
    gradient: wp.vec3


@wp.func
def lying(drape: float, normal: wp.vec3, uneven: float):
    """Share of a surface that loose silt covers: all of what faces up, less on walls, little under an overhang."""
    return drape * step_smoothly(-0.75, 0.15, normal[2] + 0.25 * uneven + drape - 1.0)


@wp.func
def fur(q: wp.vec3, normal: wp.vec3, share: float, footprint: float, seed: wp.uint32):
    """Turf on a surface whose normal in `map` is given, q in m in its own frame."""
    patch = noise3(q / PATCH_M, seed + wp.uint32(61))
    lock = noise3(q / LOCK_M, seed + wp.uint32(62))
    hair = noise3(q / HAIR_M, seed + wp.uint32(63))
    coarse = kept(LOCK_M, footprint)
    close = kept(HAIR_M, footprint)
    out = Fur()
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
def speck(x: float, y: float, grit: float, footprint: float, seed: wp.uint32):
    """White specks at x, y, m: their share of a pixel, and how bright they are, 0 to 1."""
    grain = fleck(x, y, SPECK_CELL_M, SPECK_DENSITY * grit, footprint, seed + wp.uint32(71))
    return wp.vec2(grain[0], 0.45 + 0.55 * grain[1])


@wp.func
def mouth(x: float, y: float, burrows: float, footprint: float, seed: wp.uint32):
    """Mouths of burrows at x, y, m: their share of a pixel."""
    return fleck(x, y, MOUTH_CELL_M, MOUTH_DENSITY * burrows, footprint, seed + wp.uint32(81))[0]
