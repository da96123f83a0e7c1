"""The camera's kernels: trace a sample through every pixel, add samples at edges, develop to 8 bits."""

from __future__ import annotations

import platform
from typing import Any

import warp as wp

from oysterbench.render.casting import NOTHING, Geometry, blend, blocked, cast, surface_normal
from oysterbench.render.texture import Ground, Material, clothe, scramble, seabed

COMPILER_FLAGS = "-mllvm=-inline-threshold=100000 -mllvm=-inline-cold-callsite-threshold=100000"
if platform.machine() in ("x86_64", "AMD64"):
    # One target for all: a host's own instructions are no faster here, and a cache of kernels may be shared by hosts.
    COMPILER_FLAGS += " -target-cpu x86-64-v2"

# No fused or reordered arithmetic: then every processor makes the same bytes.
wp.set_module_options(
    {
        "cpu_compiler_flags": COMPILER_FLAGS,
        "fuse_fp": False,
        "fast_math": False,
        "enable_backward": False,
    }
)

FAR_M = wp.constant(150.0)  # past the skirt of every seabed
ENDLESS_M = wp.constant(1.0e6)  # of a view ray that meets nothing but water
SHADOW_M = wp.constant(1.5)  # longest shadow ray: nothing on the bottom is taller than a few decimetres
CREVICE_M = wp.constant(0.07)  # depth below the blurred envelope at which little sky is left
EDGE_CONTRAST = wp.constant(0.08)  # relative step in green across the outline of an instance that asks for more samples
SHADOW_CONTRAST = wp.constant(0.45)
HAZE = wp.constant(0.02)  # transmission in green below which a shadow would not be seen
BOUNCE = wp.constant(0.16)  # albedo of the bottom as seen by a surface that faces down


@wp.struct
class Looks:
    """What surfaces look like. envelope: blurred upper surface of everything, for the darkness of crevices.
    reach: where on the same grid things may shade the seabed.
    """

    seed: wp.uint32
    ground: Ground
    envelope: wp.array2d(dtype=wp.float32)
    reach: wp.array2d(dtype=wp.uint8)
    envelope_start: wp.float32
    envelope_step: wp.float32


@wp.struct
class Optics:
    """Light and water. Tables run over depth, then over range from 0 or over the cosine of the view ray from -1."""

    sun_direction: wp.vec3
    sun: wp.float32
    sky: wp.float32
    seabed_shadows: wp.int32
    direct: wp.array2d(dtype=wp.vec3)
    glow: wp.array2d(dtype=wp.vec3)
    saturation: wp.array2d(dtype=wp.vec3)
    veil: wp.array2d(dtype=wp.vec3)
    stretch: wp.array2d(dtype=wp.vec3)
    range_step: wp.float32
    daylight: wp.array(dtype=wp.vec3)
    depth_step: wp.float32
    cosine_step: wp.float32


@wp.struct
class View:
    """A pinhole camera: rotation takes its optical axes into `map`; focal length and centre in pixels."""

    position: wp.vec3
    rotation: wp.mat33
    focal: wp.float32
    cx: wp.float32
    cy: wp.float32
    max_range: wp.float32


@wp.func
def look_up(table: wp.array(dtype=wp.vec3), place: float):
    """Linear interpolation at a fractional index, clamped."""
    last = table.shape[0] - 1
    clamped = wp.clamp(place, 0.0, float(last) - 0.001)
    i = int(clamped)
    return table[i] + (table[i + 1] - table[i]) * (clamped - float(i))


@wp.func
def look_up_pair(table: wp.array2d(dtype=wp.vec3), row: float, column: float):
    """Bilinear interpolation at fractional indices, clamped."""
    y = wp.clamp(row, 0.0, float(table.shape[0] - 1) - 0.001)
    x = wp.clamp(column, 0.0, float(table.shape[1] - 1) - 0.001)
    i = int(y)
    j = int(x)
    v = y - float(i)
    u = x - float(j)
    low = table[i, j] * (1.0 - u) + table[i, j + 1] * u
    high = table[i + 1, j] * (1.0 - u) + table[i + 1, j + 1] * u
    return low * (1.0 - v) + high * v


@wp.func
def arriving(optics: Optics, depth: float, distance: float):
    """Share of the light of a surface at a depth that arrives over a distance, sharp or blurred."""
    row = depth / optics.depth_step
    column = distance / optics.range_step
    return look_up_pair(optics.direct, row, column) + look_up_pair(optics.glow, row, column)


@wp.func
def veiling(optics: Optics, depth: float, distance: float, cosine: float):
    """Veiling light along a view ray from a camera at a depth."""
    row = depth / optics.depth_step
    column = (cosine + 1.0) / optics.cosine_step
    place = look_up_pair(optics.stretch, row, column) * (distance / optics.range_step)
    share = wp.vec3(
        look_up_pair(optics.saturation, row, place[0])[0],
        look_up_pair(optics.saturation, row, place[1])[1],
        look_up_pair(optics.saturation, row, place[2])[2],
    )
    return wp.cw_mul(look_up_pair(optics.veil, row, column), share)


@wp.func
def openness(looks: Looks, p: wp.vec3):
    """Share of the sky that a point sees, from its depth below the blurred envelope: 1 in the open."""
    x = (p[0] - looks.envelope_start) / looks.envelope_step
    y = (p[1] - looks.envelope_start) / looks.envelope_step
    last = float(looks.envelope.shape[0] - 2)
    share = wp.float32(1.0)
    if x > 0.0 and y > 0.0 and x < last and y < last:
        j = int(x)
        i = int(y)
        u = x - float(j)
        v = y - float(i)
        low = looks.envelope[i, j] * (1.0 - u) + looks.envelope[i, j + 1] * u
        high = looks.envelope[i + 1, j] * (1.0 - u) + looks.envelope[i + 1, j + 1] * u
        below = (low * (1.0 - v) + high * v - p[2]) / CREVICE_M
        share = 1.0 / (1.0 + 2.2 * wp.max(below, 0.0))
    return share


@wp.func
def needs_shadow_ray(looks: Looks, optics: Optics, instance: int, p: wp.vec3):
    """False only where nothing can stand between a point of the seabed and the sun."""
    j = int(wp.floor((p[0] - looks.envelope_start) / looks.envelope_step + 0.5))
    i = int(wp.floor((p[1] - looks.envelope_start) / looks.envelope_step + 0.5))
    last = looks.reach.shape[0] - 1
    needed = instance >= 0 or optics.seabed_shadows != 0 or i < 0 or j < 0 or i > last or j > last
    if not needed:
        needed = looks.reach[i, j] != wp.uint8(0)
    return needed


@wp.func
def ray_through(view: View, u: float, v: float):
    """Direction in `map` through pixel (u, v), of unit length along the optical axis, so that t is depth."""
    return view.rotation * wp.vec3((u - view.cx) / view.focal, (v - view.cy) / view.focal, 1.0)


@wp.func
def surface_light(world: Geometry, looks: Looks, optics: Optics, view: View, direction: wp.vec3, hit: Any):
    """Radiance that leaves the surface at a hit towards the camera."""
    p = view.position + direction * hit.t
    length = wp.length(direction)
    smooth = surface_normal(world, hit, p)
    facing = wp.max(-wp.dot(smooth, direction) / length, 0.08)
    footprint = hit.t / (view.focal * wp.sqrt(facing))
    material = Material()
    i = hit.instance
    if i < 0:
        material = seabed(p, smooth, looks.ground, footprint, looks.seed)
    else:
        it = world.placed[i]
        q = wp.transpose(it.rotation) * (p - it.position)
        seed = scramble(looks.seed + wp.uint32(i))
        mark = blend(world.marks, world.corners, it.first_corner + 3 * hit.face, hit.u, hit.v)
        material = clothe(
            it.kind, q, mark, it.scale[0], smooth, it.rotation, it.colour, it.silt, looks.ground, footprint, seed
        )
    n = material.normal
    sun = wp.dot(n, optics.sun_direction)
    light = wp.float32(0.0)
    if sun > 0.0 and wp.dot(smooth, optics.sun_direction) > 0.0:
        start = p + smooth * (0.0005 + 0.0005 * hit.t)
        lit = arriving(optics, -p[2], hit.t * length)[1] < HAZE
        if not lit:
            lit = not needs_shadow_ray(looks, optics, i, p)
        if not lit:
            lit = not blocked(world, start, optics.sun_direction, SHADOW_M, optics.seabed_shadows)
        if lit:
            light = optics.sun * sun / optics.sun_direction[2]
    opening = openness(looks, p)
    light += opening * (optics.sky * 0.5 * (1.0 + n[2]) + BOUNCE * 0.5 * (1.0 - n[2]))
    return wp.cw_mul(material.albedo, look_up(optics.daylight, -p[2] / optics.depth_step)) * light


@wp.func
def sample(world: Geometry, looks: Looks, optics: Optics, view: View, direction: wp.vec3, hit: Any):
    """Radiance at the camera along a ray whose nearest hit is given."""
    length = wp.length(direction)
    distance = hit.t * length
    if hit.instance == NOTHING:
        distance = ENDLESS_M
    radiance = veiling(optics, -view.position[2], distance, direction[2] / length)
    if hit.instance != NOTHING:
        surface = surface_light(world, looks, optics, view, direction, hit)
        depth = -(view.position[2] + hit.t * direction[2])
        radiance += wp.cw_mul(surface, arriving(optics, depth, distance))
    return radiance


@wp.kernel
def trace(
    world: Geometry,
    looks: Looks,
    optics: Optics,
    view: View,
    radiance: wp.array2d(dtype=wp.vec3),
    depth: wp.array2d(dtype=wp.float32),
    classes: wp.array2d(dtype=wp.uint8),
    instances: wp.array2d(dtype=wp.uint16),
):
    """One sample through the centre of each pixel, and the ground truth there."""
    row, column = wp.tid()
    direction = ray_through(view, float(column), float(row))
    hit = cast(world, view.position, direction, FAR_M)
    radiance[row, column] = sample(world, looks, optics, view, direction, hit)
    within = hit.instance != NOTHING and hit.t * wp.length(direction) <= view.max_range
    distance = wp.float32(0.0)
    kind = wp.uint8(0)
    number = wp.uint16(0)
    if within:
        distance = hit.t
        kind = wp.uint8(1)
        if hit.instance >= 0:
            kind = world.placed[hit.instance].kind
            number = wp.uint16(hit.instance + 1)
    depth[row, column] = distance
    classes[row, column] = kind
    instances[row, column] = number


@wp.func
def differs(
    radiance: wp.array2d(dtype=wp.vec3), instances: wp.array2d(dtype=wp.uint16), i: int, j: int, k: int, m: int
):
    """Whether a visible edge runs between two pixels: of an instance, or of a shadow."""
    a = radiance[i, j][1]
    b = radiance[k, m][1]
    contrast = wp.abs(a - b) / wp.max(wp.max(a, b), 1.0e-6)
    return contrast > SHADOW_CONTRAST or (instances[i, j] != instances[k, m] and contrast > EDGE_CONTRAST)


@wp.kernel
def refine(
    world: Geometry,
    looks: Looks,
    optics: Optics,
    view: View,
    radiance: wp.array2d(dtype=wp.vec3),
    instances: wp.array2d(dtype=wp.uint16),
    smooth: wp.array2d(dtype=wp.vec3),
):
    """Where an edge runs between neighbours, the mean of the centre and a sample on each side of it, on a slant."""
    i, j = wp.tid()
    last_row = radiance.shape[0] - 1
    last_column = radiance.shape[1] - 1
    total = radiance[i, j]
    edge = differs(radiance, instances, i, j, wp.max(i - 1, 0), j)
    edge = edge or differs(radiance, instances, i, j, wp.min(i + 1, last_row), j)
    edge = edge or differs(radiance, instances, i, j, i, wp.max(j - 1, 0))
    edge = edge or differs(radiance, instances, i, j, i, wp.min(j + 1, last_column))
    if edge:
        du = wp.float32(0.33)
        dv = wp.float32(0.20)
        samples = wp.int32(2)
        for _k in range(samples):
            direction = ray_through(view, float(j) + du, float(i) + dv)
            hit = cast(world, view.position, direction, FAR_M)
            total += sample(world, looks, optics, view, direction, hit)
            du = -du
            dv = -dv
        total = total / 3.0
    smooth[i, j] = total


@wp.kernel
def develop(
    radiance: wp.array2d(dtype=wp.vec3),
    noise: wp.array3d(dtype=wp.float32),
    gain: wp.vec3,
    shot: float,
    read: float,
    gamma: wp.array(dtype=wp.uint8),
    colour: wp.array3d(dtype=wp.uint8),
):
    """Exposure, shot and read noise (variance = shot * signal + read^2), clipping, gamma by table, 8 bits."""
    row, column = wp.tid()
    signal = wp.cw_mul(radiance[row, column], gain)
    levels = float(gamma.shape[0] - 1)
    for channel in range(3):
        s = signal[channel]
        noisy = s + wp.sqrt(shot * s + read * read) * noise[row, column, channel]
        colour[row, column, channel] = gamma[int(wp.clamp(noisy, 0.0, 1.0) * levels + 0.5)]
