"""The camera's kernels: trace a ray through every pixel, find how much sun and sky its surface sees, and shade it."""

from __future__ import annotations

from typing import Any

import warp as wp

from oysterbench.render.casting import (
    FAR_M,
    NOTHING,
    VEHICLE,
    Geometry,
    Hit,
    blend,
    blocked,
    blocked_by_moving,
    cast,
    near_roaming,
    near_vehicle,
    surface_normal,
    under_roaming,
)
from oysterbench.render.ground import seabed
from oysterbench.render.looks import Looks, needs_shadow_ray, openness
from oysterbench.render.noise import instances_key
from oysterbench.render.occlusion import gathered, same_surface
from oysterbench.render.optics import (
    Optics,
    beam_at,
    beam_light,
    caustic,
    lamp_irradiance,
    shadows_lost,
    unshaded,
    veiling,
)
from oysterbench.render.tables import look_up, look_up_pair
from oysterbench.render.target import KERNEL_OPTIONS
from oysterbench.render.texture import Material, instance_material
from oysterbench.render.view import CameraView, pixel_ray, pixel_start
from oysterbench.render.way import Way, way_to

wp.set_module_options(KERNEL_OPTIONS)

ENDLESS_M = wp.constant(1.0e6)  # length of a view ray that meets nothing but water
SHADOW_M = wp.constant(1.5)  # longest shadow ray: nothing on the bottom is taller than a few decimetres
SHADED, LIT, SURELY_LIT = wp.constant(0), wp.constant(1), wp.constant(2)  # what is known about the sun in a pixel
LEAST_SPREAD = wp.constant(0.02)  # of the sun's fan: narrower ones cast sharp shadows
SKY_SPREAD = wp.constant(0.7)
"""Spread of scattered light: a wall has 0.32 and a ceiling 0.10 of a floor's, by discrete ordinates in 3C to 9C."""
LAMP_SHADOW_M = wp.constant(0.5)  # longest lamp shadow ray: whatever casts a lamp's shadow on a surface is close to it
LEAST_SHADOW = wp.constant(0.03)  # share of a surface's light below which a shadow is invisible and no ray is cast
FAINT = wp.constant(2.0e-5)  # irradiance of a lamp too faint to show in any image
VEHICLE_KIND = wp.constant(wp.uint8(6))


@wp.func
def sunlit(
    world: Geometry,
    looks: Looks,
    optics: Optics,
    instance: int,
    p: wp.vec3,
    normal: wp.vec3,
    towards: wp.vec3,
    t: float,
    distance: float,
):
    """SHADED or LIT, as found by a ray towards part of the sun's light, or SURELY_LIT if no ray is needed.

    t: depth of the point in the image, m; distance: from the camera, m.
    """
    # Nested, because Warp evaluates both sides of an `and`.
    seen = wp.uint8(SURELY_LIT)
    roamed = under_roaming(world, p)
    if roamed:
        seen = wp.uint8(LIT)  # neighbours' rays go in other directions and may hit a roaming thing
    under = wp.bool(False)
    if world.vehicle.mesh != wp.uint64(0):
        under = near_vehicle(world.vehicle, p, towards)
    if roamed and not under:
        under = near_roaming(world, p, towards, FAR_M)
    wanted = under
    if not wanted:
        wanted = needs_shadow_ray(looks, optics, instance, p)
    if wanted:
        wanted = optics.sun * beam_at(optics, p)[1] > LEAST_SHADOW * (optics.sun + optics.sky)
    if wanted:
        wanted = not shadows_lost(optics, p, distance)
    if wanted:
        seen = wp.uint8(SHADED)
        if wp.dot(normal, towards) > 0.0:
            start = p + normal * (0.0005 + 0.0005 * t)
            reach = SHADOW_M
            if under:
                reach = FAR_M
            if not blocked(world, start, towards, reach, optics.seabed_shadows):
                seen = wp.uint8(LIT)
    return seen


@wp.func
def sun_share(
    lit: wp.array2d(dtype=wp.uint8),
    hits: wp.array2d(dtype=Hit),
    normals: wp.array2d(dtype=wp.vec3),
    spread: float,
    row: int,
    column: int,
):
    """Share of the sun's light that arrives in a pixel; 4 x 4 neighbours together sample a wide fan of the sun."""
    own = lit[row, column]
    share = wp.where(own == wp.uint8(SHADED), 0.0, 1.0)
    mixed = wp.bool(False)
    if own != wp.uint8(SURELY_LIT) and spread > LEAST_SPREAD:
        for di in range(-2, 2):
            for dj in range(-2, 2):
                i = wp.clamp(row + di, 0, lit.shape[0] - 1)
                j = wp.clamp(column + dj, 0, lit.shape[1] - 1)
                mixed = mixed or (lit[i, j] == wp.uint8(SHADED)) != (own == wp.uint8(SHADED))
    if mixed:
        weight = wp.float32(1.0)
        for di in range(-2, 2):
            for dj in range(-2, 2):
                i = row + di
                j = column + dj
                if (di != 0 or dj != 0) and same_surface(hits, normals, row, column, i, j):
                    share += wp.where(lit[i, j] == wp.uint8(SHADED), 0.0, 1.0)
                    weight += 1.0
        share = share / weight
    return share


@wp.struct
class Signal:
    """Radiance at the camera: sharp and blurred light from a surface, and light added by the water. silted: share of
    the blurred light that was scattered by silt."""

    sharp: wp.vec3
    forward_scatter: wp.vec3
    backscatter: wp.vec3
    silted: wp.float32


@wp.func
def shade_material(
    world: Geometry, looks: Looks, view: CameraView, p: wp.vec3, smooth: wp.vec3, direction: wp.vec3, hit: Any
):
    """Material at a hit at point p with smooth normal `smooth`, seen along `direction`."""
    facing = wp.max(-wp.dot(smooth, direction) / wp.length(direction), 0.08)
    footprint = hit.t / (view.focal * wp.sqrt(facing))
    material = Material()
    i = hit.instance
    if i == VEHICLE:
        body = world.vehicle
        material.albedo = blend(body.marks, body.corners, 3 * hit.face, hit.u, hit.v)
        material.normal = smooth
    elif i < 0:
        material = seabed(p, smooth, looks.ground, footprint, looks.seed)
    else:
        it = world.placed[i]
        q = wp.transpose(it.rotation) * (p - it.position)
        seed = instances_key(looks.seed, i)
        mark = blend(world.marks, world.corners, it.first_corner + 3 * hit.face, hit.u, hit.v)
        material = instance_material(
            it.kind, q, mark, it.scale[0], smooth, it.rotation, it.colour, it.silt, looks.ground, footprint, seed
        )
    return material


@wp.func
def softened(cosine: float, spread: float):
    """Effective cosine for an extended source, with a soft terminator: never quite 0."""
    return 0.5 * (cosine + wp.sqrt(cosine * cosine + spread * spread))


@wp.func
def day_light(optics: Optics, p: wp.vec3, n: wp.vec3, lit: float, opening: float, way: Way):
    """Irradiance (3,) of daylight on a surface with normal n that sees shares `lit` of sun and `opening` of sky."""
    towards = wp.dot(n, optics.sun_direction)
    facing = softened(towards, optics.spread) / softened(optics.sun_direction[2], optics.spread)
    beam = wp.cw_mul(beam_at(optics, p) * optics.sun, way.beam)
    soft = wp.vec3(optics.sun + optics.sky, optics.sun + optics.sky, optics.sun + optics.sky) - beam
    below = optics.bounce * 0.5 * (1.0 - n[2])
    light = (soft * (softened(n[2], SKY_SPREAD) / softened(1.0, SKY_SPREAD)) + wp.vec3(below, below, below)) * opening
    if lit > 0.0:
        wave = caustic(optics, p)
        if optics.turbidity.on != 0:
            wave = 1.0 + (wave - 1.0) * way.pattern
        light += beam * (wave * facing * lit)
    if optics.shade > 0.0:
        light = light * unshaded(optics, p)
    return wp.cw_mul(wp.cw_mul(look_up(optics.daylight, -p[2] / optics.depth_step), light), way.day)


@wp.func
def lamp_light(world: Geometry, lamps: Any, p: wp.vec3, n: wp.vec3, smooth: wp.vec3, t: float, least: float):
    """Irradiance (3,) of all lamps on a surface with normal n, with the shadows cast by things close by.

    least: irradiance, in green, of a lamp above which its shadow would be visible.
    """
    light = wp.vec3(0.0, 0.0, 0.0)
    for k in range(lamps.count):
        apart = lamps.positions[k] - p
        distance = wp.length(apart)
        cosine = wp.dot(n, apart) / distance
        if cosine > 0.0 and wp.dot(smooth, apart) > 0.0:
            arriving = lamp_irradiance(lamps, k, p) * cosine
            if arriving[1] > FAINT:
                lit = wp.bool(True)
                if arriving[1] > least:
                    start = p + smooth * (0.0005 + 0.0005 * t)
                    lit = not blocked(world, start, apart / distance, wp.min(LAMP_SHADOW_M, distance - 0.03), 0)
                    if lit and world.roaming_count > 0:  # fish cast shadows from farther away
                        lit = not blocked_by_moving(
                            world, world.roaming, world.first_roaming, start, apart / distance, distance - 0.03
                        )
                if lit:
                    light += arriving
    return light


@wp.func
def received_radiance(
    world: Geometry,
    looks: Looks,
    optics: Optics,
    view: CameraView,
    origin: wp.vec3,
    direction: wp.vec3,
    hit: Any,
    smooth: wp.vec3,
    lit: float,
    opening: float,
    way: Way,
):
    """Signal that the camera receives along a ray with a given nearest hit.

    lit, opening: shares of sun and sky seen at the hit. way: effect of varying turbidity along the path.
    """
    length = wp.length(direction)
    distance = hit.t * length
    signal = Signal()
    if hit.instance == NOTHING:
        distance = ENDLESS_M
    signal.backscatter = wp.cw_mul(veiling(optics, -origin[2], distance, direction[2] / length), way.veil)
    if hit.instance != NOTHING:
        p = origin + direction * hit.t
        material = shade_material(world, looks, view, p, smooth, direction, hit)
        n = material.normal
        surface = day_light(optics, p, n, lit, opening, way)
        if optics.lamps.count > 0:
            lamps = lamp_light(world, optics.lamps, p, n, smooth, hit.t, LEAST_SHADOW * surface[1])
            surface += wp.cw_mul(lamps, way.lamps) * (0.25 + 0.75 * opening)
        surface = wp.cw_mul(material.albedo, surface)
        row = -p[2] / optics.depth_step
        column = distance / optics.range_step
        direct = look_up_pair(optics.direct, row, column)
        forward = look_up_pair(optics.forward_scatter, row, column)
        if optics.turbidity.on != 0:
            whole = wp.cw_mul(direct + forward, way.image)
            direct = wp.cw_mul(direct, way.direct)
            forward = whole - direct
            signal.silted = whole[1] * (1.0 - way.unsilted) / wp.max(forward[1], 1.0e-12)
        signal.sharp = wp.cw_mul(surface, direct)
        signal.forward_scatter = wp.cw_mul(surface, forward)
    return signal


@wp.func
def scattered(optics: Optics, view: CameraView, u: float, v: float, distance: float):
    """Lamp light that the water scatters into the ray of pixel u, v over a distance, m."""
    light = wp.vec3(0.0, 0.0, 0.0)
    if optics.lamps.count > 0:
        rows = float(optics.lamps.beams.shape[0] - 1) / float(view.rays.shape[0] - 3)
        columns = float(optics.lamps.beams.shape[1] - 1) / float(view.rays.shape[1] - 3)
        light = beam_light(optics.lamps, v * rows, u * columns, distance)
    return light


@wp.kernel
def trace(
    world: Geometry,
    view: CameraView,
    hits: wp.array2d(dtype=Hit),
    normals: wp.array2d(dtype=wp.vec3),
    depth: wp.array2d(dtype=wp.float32),
    classes: wp.array2d(dtype=wp.uint8),
    instances: wp.array2d(dtype=wp.uint16),
):
    """Find the nearest surface along the ray through the centre of each pixel, and the ground truth there."""
    row, column = wp.tid()
    direction = pixel_ray(view, row, column)
    origin = pixel_start(view, row, column)
    hit = cast(world, origin, direction, FAR_M)
    hits[row, column] = hit
    normal = wp.vec3(0.0, 0.0, 0.0)
    if hit.instance != NOTHING:
        normal = surface_normal(world, hit, origin + direction * hit.t)
    normals[row, column] = normal
    within = hit.instance != NOTHING and hit.t * wp.length(direction) <= view.max_range
    distance = wp.float32(0.0)
    kind = wp.uint8(0)
    number = wp.uint16(0)
    if within:
        distance = hit.t
        if view.port != 0:
            distance += view.rays[row + 1, column + 1][2]
        kind = wp.uint8(1)
        if hit.instance >= 0:
            kind = world.placed[hit.instance].kind
            number = world.placed[hit.instance].number
        elif hit.instance == VEHICLE:
            kind = VEHICLE_KIND
            number = world.vehicle.number
    depth[row, column] = distance
    classes[row, column] = kind
    instances[row, column] = number


@wp.kernel
def shadow(
    world: Geometry,
    looks: Looks,
    optics: Optics,
    view: CameraView,
    hits: wp.array2d(dtype=Hit),
    normals: wp.array2d(dtype=wp.vec3),
    lit: wp.array2d(dtype=wp.uint8),
):
    """Find whether light reaches each pixel's surface from one of the 16 directions of the sun's fan; neighbouring
    pixels test the others."""
    row, column = wp.tid()
    hit = hits[row, column]
    seen = wp.uint8(SURELY_LIT)
    if hit.instance != NOTHING:
        direction = pixel_ray(view, row, column)
        p = pixel_start(view, row, column) + direction * hit.t
        towards = optics.fan[(row & 3) * 4 + (column & 3)]
        distance = hit.t * wp.length(direction)
        seen = sunlit(world, looks, optics, hit.instance, p, normals[row, column], towards, hit.t, distance)
    lit[row, column] = seen


@wp.kernel
def shade(
    world: Geometry,
    looks: Looks,
    optics: Optics,
    view: CameraView,
    hits: wp.array2d(dtype=Hit),
    normals: wp.array2d(dtype=wp.vec3),
    lit: wp.array2d(dtype=wp.uint8),
    open: wp.array2d(dtype=wp.float32),
    sharp: wp.array2d(dtype=wp.vec3),
    forward_scatter: wp.array2d(dtype=wp.vec3),
    backscatter: wp.array2d(dtype=wp.vec3),
    level: wp.array2d(dtype=wp.float32),
    openings: wp.array2d(dtype=wp.float32),
    silted: wp.array2d(dtype=wp.float32),
):
    """Compute the light from each pixel's surface and water, and its total in green (`level`) for edge detection."""
    row, column = wp.tid()
    u = float(column)
    v = float(row)
    origin = pixel_start(view, row, column)
    direction = pixel_ray(view, row, column)
    hit = hits[row, column]
    opening = wp.float32(1.0)
    if hit.instance != NOTHING:
        opening = openness(looks, origin + direction * hit.t)
        if optics.occlusion > 0.0:
            opening = gathered(open, hits, normals, row, column, opening)
    distance = hit.t * wp.length(direction)
    if hit.instance == NOTHING:
        distance = ENDLESS_M
    across = float(column) / float(hits.shape[1] - 1)
    down = float(row) / float(hits.shape[0] - 1)
    way = way_to(optics, across, down, distance, origin + direction * hit.t)
    signal = received_radiance(
        world,
        looks,
        optics,
        view,
        origin,
        direction,
        hit,
        normals[row, column],
        sun_share(lit, hits, normals, optics.spread, row, column),
        opening,
        way,
    )
    added = signal.backscatter + scattered(optics, view, u, v, hit.t * wp.length(direction))
    sharp[row, column] = signal.sharp
    forward_scatter[row, column] = signal.forward_scatter
    backscatter[row, column] = added
    level[row, column] = signal.sharp[1] + signal.forward_scatter[1] + added[1]
    openings[row, column] = opening
    silted[row, column] = wp.min(signal.silted, 1.0)
