"""Coats of animals as Warp functions: linear albedo of fish by species, and mottling for everything else that moves."""

from __future__ import annotations

import warp as wp

from oysterbench.render.noise import kept, noise2, noise3, nth, step_smoothly

PUPIL = wp.constant(wp.vec3(0.012, 0.012, 0.014))
SILVER_BACK = wp.constant(wp.vec3(0.085, 0.105, 0.070))
SILVER_SIDE = wp.constant(wp.vec3(0.52, 0.54, 0.52))
SILVER_BELLY = wp.constant(wp.vec3(0.60, 0.60, 0.57))
BRASS_BACK = wp.constant(wp.vec3(0.105, 0.100, 0.075))
BRASS_SIDE = wp.constant(wp.vec3(0.32, 0.315, 0.27))
BRASS_BELLY = wp.constant(wp.vec3(0.50, 0.48, 0.42))
TOAD_DARK = wp.constant(wp.vec3(0.045, 0.036, 0.022))
TOAD_LIGHT = wp.constant(wp.vec3(0.20, 0.165, 0.095))


@wp.func
def blended(a: wp.vec3, b: wp.vec3, share: float):
    """Linear interpolation from a (share 0) to b (share 1)."""
    return a + (b - a) * share


@wp.func
def mottle(q: wp.vec3, size: float, footprint: float, seed: wp.vec2ui):
    """Factor of about 1 that varies over `size` m and a third of it; q: point in the shape's frame, m."""
    coarse = noise3(q / size, seed)
    fine = noise3(q * (3.0 / size), nth(seed, 1))
    return wp.max(0.3, 1.0 + 0.30 * coarse[0] * kept(size, footprint) + 0.18 * fine[0] * kept(0.33 * size, footprint))


@wp.func
def fish_coat(mark: wp.vec3, colour: wp.vec3, length: float, footprint: float, seed: wp.vec2ui):
    """Albedo of a fish; mark: position from nose to tail and from belly to back, and part, as in scene.life.fish."""
    along = mark[0]
    up = mark[1]
    part = int(mark[2] + 0.5)
    scales = noise2(along * 70.0, up * 22.0, seed)[0] * kept(0.02 * length, footprint)
    blots = noise2(along * 9.0, up * 2.5, nth(seed, 3))[0] * kept(0.12 * length, footprint)
    albedo = wp.vec3(0.0, 0.0, 0.0)
    if part == 1:
        albedo = PUPIL
    elif part == 2:  # silverside: a bright stripe under a dark back
        side = blended(SILVER_BELLY, SILVER_SIDE, step_smoothly(-0.8, -0.1, up))
        stripe = step_smoothly(0.05, 0.16, up) * (1.0 - step_smoothly(0.26, 0.40, up))
        albedo = blended(side, SILVER_BACK, step_smoothly(0.22, 0.55, up)) * (1.0 + 0.14 * scales)
        albedo = blended(albedo, wp.vec3(0.66, 0.68, 0.67), 0.7 * stripe)
    elif part == 3:  # croaker: brassy, with dark bars that slant down and back
        side = blended(BRASS_BELLY, BRASS_SIDE, step_smoothly(-0.9, 0.0, up))
        albedo = blended(side, BRASS_BACK, step_smoothly(0.15, 0.95, up)) * (1.0 + 0.20 * scales)
        wave = wp.sin(62.0 * (along + 0.05 * up) + 1.5 * blots)
        bar = step_smoothly(0.25, 0.8, wave) * step_smoothly(-0.25, 0.35, up) * kept(0.10 * length, footprint)
        albedo = albedo * (1.0 - 0.45 * bar)
        gill = step_smoothly(0.23, 0.24, along) * (1.0 - step_smoothly(0.25, 0.27, along))
        albedo = albedo * (1.0 - 0.35 * gill * kept(0.03 * length, footprint))
    elif part == 4:  # toadfish
        spots = step_smoothly(-0.35, 0.45, blots + 0.5 * scales)
        albedo = blended(TOAD_DARK, TOAD_LIGHT, spots)
        albedo = blended(wp.vec3(0.24, 0.21, 0.15), albedo, step_smoothly(-0.9, -0.4, up))
    else:  # a fin: thin and translucent, with rays
        rays = wp.sin(150.0 * along + 8.0 * up) * kept(0.04 * length, footprint)
        albedo = wp.vec3(0.25, 0.245, 0.20) * (1.0 + 0.25 * rays)
    return wp.cw_mul(albedo, colour)
