"""The camera's kernels: trace a ray through every pixel, find its sun and sky, shade it, add samples at edges."""

from __future__ import annotations

from typing import Any

import warp as wp

from oysterbench.render.casting import (
    NOTHING,
    VEHICLE,
    Geometry,
    Hit,
    blend,
    blocked,
    cast,
    near_vehicle,
    surface_normal,
)
from oysterbench.render.looks import Looks, needs_shadow_ray, openness
from oysterbench.render.occlusion import gathered
from oysterbench.render.optics import Optics, beam_light, caustic, hazy, lamp_irradiance, look_up, look_up_pair, veiling
from oysterbench.render.target import KERNEL_OPTIONS
from oysterbench.render.texture import Material, clothe, scramble, seabed
from oysterbench.render.view import View, pixel_ray, pixel_start, ray_start, ray_through

wp.set_module_options(KERNEL_OPTIONS)

FAR_M = wp.constant(150.0)  # past the skirt of every seabed
ENDLESS_M = wp.constant(1.0e6)  # of a view ray that meets nothing but water
ENDLESS_M = wp.constant(1.0e6)  # of a view ray that meets nothing but water
SHADOW_M = wp.constant(1.5)  # longest shadow ray: nothing on the bottom is taller than a few decimetres
EDGE_CONTRAST = wp.constant(0.08)  # relative step in green across the outline of an instance that asks for more samples
SHADOW_CONTRAST = wp.constant(0.45)
LAMP_SHADOW_M = wp.constant(0.5)  # from a surface: what throws a lamp's shadow on it stands close by
FAINT = wp.constant(2.0e-5)  # irradiance of a lamp that no picture shows
VEHICLE_KIND = wp.constant(wp.uint8(6))


@wp.func
def in_the_sun(
    world: Geometry,
    looks: Looks,
    optics: Optics,
    instance: int,
    p: wp.vec3,
    normal: wp.vec3,
    t: float,
    distance: float,
):
    """Whether nothing stands between a point at depth t of the picture and the sun; far away, nothing does."""
    # Nested, for Warp evaluates both sides of an `and`.
    lit = wp.dot(normal, optics.sun_direction) > 0.0
    if lit:
        under = wp.bool(False)
        if world.vehicle.mesh != wp.uint64(0):
            under = near_vehicle(world.vehicle, p, optics.sun_direction)
        wanted = under
        if not wanted:
            wanted = needs_shadow_ray(looks, optics, instance, p)
        if wanted:
            wanted = not hazy(optics, p, distance)
        if wanted:
            start = p + normal * (0.0005 + 0.0005 * t)
            reach = SHADOW_M
            if under:
                reach = FAR_M
            lit = not blocked(world, start, optics.sun_direction, reach, optics.seabed_shadows)
    return lit


@wp.struct
class Signal:
    """Radiance at the camera: sharp and blurred light of a surface, and light that the water adds."""

    sharp: wp.vec3
    glow: wp.vec3
    haze: wp.vec3


@wp.func
def dress(world: Geometry, looks: Looks, view: View, p: wp.vec3, smooth: wp.vec3, direction: wp.vec3, hit: Any):
    """The material at a hit."""
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
        seed = scramble(looks.seed + wp.uint32(i))
        mark = blend(world.marks, world.corners, it.first_corner + 3 * hit.face, hit.u, hit.v)
        material = clothe(
            it.kind, q, mark, it.scale[0], smooth, it.rotation, it.colour, it.silt, looks.ground, footprint, seed
        )
    return material


@wp.func
def lamp_light(world: Geometry, lamps: Any, p: wp.vec3, n: wp.vec3, smooth: wp.vec3, t: float):
    """Irradiance (3,) of all lamps on a surface with normal n, with the shadows that things close by throw."""
    light = wp.vec3(0.0, 0.0, 0.0)
    for k in range(lamps.count):
        apart = lamps.positions[k] - p
        distance = wp.length(apart)
        cosine = wp.dot(n, apart) / distance
        if cosine > 0.0 and wp.dot(smooth, apart) > 0.0:
            arriving = lamp_irradiance(lamps, k, p) * cosine
            if arriving[1] > FAINT:
                start = p + smooth * (0.0005 + 0.0005 * t)
                if not blocked(world, start, apart / distance, wp.min(LAMP_SHADOW_M, distance - 0.03), 0):
                    light += arriving
    return light


@wp.func
def shine(
    world: Geometry,
    looks: Looks,
    optics: Optics,
    view: View,
    origin: wp.vec3,
    direction: wp.vec3,
    hit: Any,
    smooth: wp.vec3,
    lit: bool,
    opening: float,
):
    """What the camera receives along a ray whose nearest hit is given; lit and opening: its sun and its sky there."""
    length = wp.length(direction)
    distance = hit.t * length
    signal = Signal()
    if hit.instance == NOTHING:
        distance = ENDLESS_M
    signal.haze = veiling(optics, -origin[2], distance, direction[2] / length)
    if hit.instance != NOTHING:
        p = origin + direction * hit.t
        material = dress(world, looks, view, p, smooth, direction, hit)
        n = material.normal
        light = opening * (optics.sky * 0.5 * (1.0 + n[2]) + optics.bounce * 0.5 * (1.0 - n[2]))
        sun = wp.dot(n, optics.sun_direction)
        if lit and sun > 0.0:
            light += optics.sun * caustic(optics, p) * sun / optics.sun_direction[2]
        surface = look_up(optics.daylight, -p[2] / optics.depth_step) * light
        if optics.lamps.count > 0:
            surface += lamp_light(world, optics.lamps, p, n, smooth, hit.t) * (0.25 + 0.75 * opening)
        surface = wp.cw_mul(material.albedo, surface)
        row = -p[2] / optics.depth_step
        column = distance / optics.range_step
        signal.sharp = wp.cw_mul(surface, look_up_pair(optics.direct, row, column))
        signal.glow = wp.cw_mul(surface, look_up_pair(optics.glow, row, column))
    return signal


@wp.func
def scattered(optics: Optics, view: View, u: float, v: float, distance: float):
    """Light of the lamps that the water scatters into a ray."""
    light = wp.vec3(0.0, 0.0, 0.0)
    if optics.lamps.count > 0:
        rows = float(optics.lamps.beams.shape[0] - 1) / float(view.rays.shape[0] - 3)
        columns = float(optics.lamps.beams.shape[1] - 1) / float(view.rays.shape[1] - 3)
        light = beam_light(optics.lamps, v * rows, u * columns, distance)
    return light


@wp.kernel
def trace(
    world: Geometry,
    view: View,
    hits: wp.array2d(dtype=Hit),
    normals: wp.array2d(dtype=wp.vec3),
    depth: wp.array2d(dtype=wp.float32),
    classes: wp.array2d(dtype=wp.uint8),
    instances: wp.array2d(dtype=wp.uint16),
):
    """The nearest surface along the ray through the centre of each pixel, and the ground truth there."""
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
        distance = hit.t + wp.dot(origin - view.position, view.rotation * wp.vec3(0.0, 0.0, 1.0))
        kind = wp.uint8(1)
        if hit.instance >= 0:
            kind = world.placed[hit.instance].kind
            number = wp.uint16(hit.instance + 1)
        elif hit.instance == VEHICLE:
            kind = VEHICLE_KIND
            number = wp.uint16(world.count + 1)
    depth[row, column] = distance
    classes[row, column] = kind
    instances[row, column] = number


@wp.kernel
def shadow(
    world: Geometry,
    looks: Looks,
    optics: Optics,
    view: View,
    hits: wp.array2d(dtype=Hit),
    normals: wp.array2d(dtype=wp.vec3),
    lit: wp.array2d(dtype=wp.uint8),
):
    """Whether the sun reaches each pixel's surface."""
    row, column = wp.tid()
    hit = hits[row, column]
    sunny = wp.uint8(0)
    if hit.instance != NOTHING:
        direction = pixel_ray(view, row, column)
        p = pixel_start(view, row, column) + direction * hit.t
        normal = normals[row, column]
        distance = hit.t * wp.length(direction)
        if in_the_sun(world, looks, optics, hit.instance, p, normal, hit.t, distance):
            sunny = wp.uint8(1)
    lit[row, column] = sunny


@wp.kernel
def shade(
    world: Geometry,
    looks: Looks,
    optics: Optics,
    view: View,
    hits: wp.array2d(dtype=Hit),
    normals: wp.array2d(dtype=wp.vec3),
    lit: wp.array2d(dtype=wp.uint8),
    open: wp.array2d(dtype=wp.float32),
    sharp: wp.array2d(dtype=wp.vec3),
    glow: wp.array2d(dtype=wp.vec3),
    haze: wp.array2d(dtype=wp.vec3),
    level: wp.array2d(dtype=wp.float32),
    openings: wp.array2d(dtype=wp.float32),
):
    """Light from each pixel's surface and water, and green of it all for finding edges."""
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
    signal = shine(
        world,
        looks,
        optics,
        view,
        origin,
        direction,
        hit,
        normals[row, column],
        lit[row, column] != wp.uint8(0),
        opening,
    )
    added = signal.haze + scattered(optics, view, u, v, hit.t * wp.length(direction))
    sharp[row, column] = signal.sharp
    glow[row, column] = signal.glow
    haze[row, column] = added
    level[row, column] = signal.sharp[1] + signal.glow[1] + added[1]
    openings[row, column] = opening


@wp.func
def differs(
    level: wp.array2d(dtype=wp.float32), instances: wp.array2d(dtype=wp.uint16), i: int, j: int, k: int, m: int
):
    """Whether a visible edge runs between two pixels: of an instance, or of a shadow."""
    a = level[i, j]
    b = level[k, m]
    contrast = wp.abs(a - b) / wp.max(wp.max(a, b), 1.0e-6)
    return contrast > SHADOW_CONTRAST or (instances[i, j] != instances[k, m] and contrast > EDGE_CONTRAST)


@wp.kernel
def refine(
    world: Geometry,
    looks: Looks,
    optics: Optics,
    view: View,
    level: wp.array2d(dtype=wp.float32),
    instances: wp.array2d(dtype=wp.uint16),
    openings: wp.array2d(dtype=wp.float32),
    sharp: wp.array2d(dtype=wp.vec3),
    glow: wp.array2d(dtype=wp.vec3),
    haze: wp.array2d(dtype=wp.vec3),
):
    """Where an edge runs between neighbours, the mean of the centre and a sample on each side of it, on a slant."""
    i, j = wp.tid()
    last_row = level.shape[0] - 1
    last_column = level.shape[1] - 1
    edge = differs(level, instances, i, j, wp.max(i - 1, 0), j)
    edge = edge or differs(level, instances, i, j, wp.min(i + 1, last_row), j)
    edge = edge or differs(level, instances, i, j, i, wp.max(j - 1, 0))
    edge = edge or differs(level, instances, i, j, i, wp.min(j + 1, last_column))
    if edge:
        total_sharp = sharp[i, j]
        total_glow = glow[i, j]
        total_haze = haze[i, j]
        du = wp.float32(0.33)
        dv = wp.float32(0.20)
        samples = wp.int32(2)
        for _k in range(samples):
            u = float(j) + du
            v = float(i) + dv
            origin = ray_start(view, u, v)
            direction = ray_through(view, u, v)
            hit = cast(world, origin, direction, FAR_M)
            normal = wp.vec3(0.0, 0.0, 1.0)
            lit = wp.bool(False)
            opening = wp.float32(1.0)
            if hit.instance != NOTHING:
                p = origin + direction * hit.t
                normal = surface_normal(world, hit, p)
                distance = hit.t * wp.length(direction)
                lit = in_the_sun(world, looks, optics, hit.instance, p, normal, hit.t, distance)
                opening = openings[i, j]
                if optics.occlusion == 0.0:
                    opening = openness(looks, p)
            signal = shine(world, looks, optics, view, origin, direction, hit, normal, lit, opening)
            total_sharp += signal.sharp
            total_glow += signal.glow
            total_haze += signal.haze + scattered(optics, view, u, v, hit.t * wp.length(direction))
            du = -du
            dv = -dv
        sharp[i, j] = total_sharp / 3.0
        glow[i, j] = total_glow / 3.0
        haze[i, j] = total_haze / 3.0
