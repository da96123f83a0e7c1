"""Anti-aliasing: more rays where surfaces meet, lit from the surrounding pixels that see the same surfaces.

As in multisampling on graphics cards, shading is computed once per pixel and only coverage is sampled more often.
"""

from __future__ import annotations

import warp as wp

from oysterbench.render.casting import FAR_M, NOTHING, RELIEF, SKIRT, Geometry, Hit, cast_surface
from oysterbench.render.target import KERNEL_OPTIONS
from oysterbench.render.view import CameraView, pixel_ray, pixel_start, ray_start, ray_through

wp.set_module_options(KERNEL_OPTIONS)

OUTLINE_CONTRAST = wp.constant(0.08)  # relative step in green between two surfaces that requires more samples
INNER_CONTRAST = wp.constant(0.45)  # and within one surface, as at the edge of a shadow
SAMPLE_U, SAMPLE_V = wp.constant(0.33), wp.constant(0.20)  # offset of two extra samples from the centre, px


@wp.func
def surface_of(hits: wp.array2d(dtype=Hit), i: int, j: int):
    """Surface seen by a pixel; the seabed and its skirt count as one."""
    seen = hits[i, j].instance
    return wp.where(seen == SKIRT, RELIEF, seen)


@wp.func
def plane_at(view: CameraView, t: float, normal: wp.vec3, row: int, column: int, origin: wp.vec3, direction: wp.vec3):
    """Depth at which a ray meets the tangent plane of what a pixel sees at depth t, clamped to t +- 10 %."""
    p = pixel_start(view, row, column) + pixel_ray(view, row, column) * t
    towards = wp.dot(normal, direction)
    met = t
    if towards < -0.001:
        met = wp.clamp(wp.dot(normal, p - origin) / towards, 0.9 * t, 1.1 * t)
    return met


@wp.func
def surface_at(
    world: Geometry,
    view: CameraView,
    hits: wp.array2d(dtype=Hit),
    normals: wp.array2d(dtype=wp.vec3),
    i: int,
    j: int,
    side: int,
):
    """Surface seen by a sample, among those seen by the four pixels around it; side: 1 or -1, which sample.

    The seabed is taken as the tangent plane where one of these pixels sees it, so that only meshes are tested again.
    """
    u = float(j) + SAMPLE_U * float(side)
    v = float(i) + SAMPLE_V * float(side)
    origin = ray_start(view, u, v)
    direction = ray_through(view, u, v)
    k = wp.clamp(i + side, 0, hits.shape[0] - 1)
    m = wp.clamp(j + side, 0, hits.shape[1] - 1)
    found = wp.int32(NOTHING)
    t = wp.float32(FAR_M)
    for corner in range(4):
        row = wp.where(corner // 2 == 1, k, i)
        column = wp.where(corner % 2 == 1, m, j)
        if surface_of(hits, row, column) == RELIEF and found != RELIEF:
            found = wp.int32(RELIEF)
            t = plane_at(view, hits[row, column].t, normals[row, column], row, column, origin, direction)
    first = surface_of(hits, i, j)
    second = surface_of(hits, i, m)
    third = surface_of(hits, k, j)
    fourth = surface_of(hits, k, m)
    for corner in range(4):
        asked = first
        if corner == 1:
            asked = wp.where(second != first, second, NOTHING)
        elif corner == 2:
            asked = wp.where(third != first and third != second, third, NOTHING)
        elif corner == 3:
            asked = wp.where(fourth != first and fourth != second and fourth != third, fourth, NOTHING)
        nearer = cast_surface(world, asked, origin, direction, t)
        if nearer.instance != NOTHING:
            found = nearer.instance
            t = nearer.t
    return found


@wp.func
def edge_between(level: wp.array2d(dtype=wp.float32), hits: wp.array2d(dtype=Hit), i: int, j: int, k: int, m: int):
    """2 if the outline of a surface runs between two pixels, 1 if another edge does, 0 for none or a weak one."""
    a = level[i, j]
    b = level[k, m]
    contrast = wp.abs(a - b) / wp.max(wp.max(a, b), 1.0e-6)
    kind = wp.int32(0)
    if contrast > OUTLINE_CONTRAST:
        if surface_of(hits, i, j) != surface_of(hits, k, m):
            kind = 2
        elif contrast > INNER_CONTRAST:
            kind = 1
    return kind


@wp.kernel
def refine(
    world: Geometry,
    view: CameraView,
    hits: wp.array2d(dtype=Hit),
    normals: wp.array2d(dtype=wp.vec3),
    level: wp.array2d(dtype=wp.float32),
    sharp: wp.array2d(dtype=wp.vec3),
    forward_scatter: wp.array2d(dtype=wp.vec3),
    backscatter: wp.array2d(dtype=wp.vec3),
    smooth_sharp: wp.array2d(dtype=wp.vec3),
    smooth_glow: wp.array2d(dtype=wp.vec3),
    smooth_haze: wp.array2d(dtype=wp.vec3),
):
    """Where an edge runs between neighbours, average the centre with a sample on each side of it, along a slant.

    A sample sees the nearest of the surfaces of the four pixels around it and takes its light from those that see the
    same surface, weighted by proximity; if it sees none of these surfaces, it does not count.
    """
    i, j = wp.tid()
    last_row = level.shape[0] - 1
    last_column = level.shape[1] - 1
    edge = edge_between(level, hits, i, j, wp.max(i - 1, 0), j)
    edge = wp.max(edge, edge_between(level, hits, i, j, wp.min(i + 1, last_row), j))
    edge = wp.max(edge, edge_between(level, hits, i, j, i, wp.max(j - 1, 0)))
    edge = wp.max(edge, edge_between(level, hits, i, j, i, wp.min(j + 1, last_column)))
    total_sharp = sharp[i, j]
    total_forward = forward_scatter[i, j]
    total_back = backscatter[i, j]
    if edge > 0:
        total = wp.float32(1.0)
        for k in range(2):
            side = 1 - 2 * k
            surface = surface_of(hits, i, j)
            if edge == 2:
                surface = surface_at(world, view, hits, normals, i, j, side)
            for corner in range(4):
                row = wp.clamp(i + side * (corner // 2), 0, last_row)
                column = wp.clamp(j + side * (corner % 2), 0, last_column)
                if surface_of(hits, row, column) == surface:
                    weight = wp.where(corner % 2 == 1, SAMPLE_U, 1.0 - SAMPLE_U)
                    weight = weight * wp.where(corner // 2 == 1, SAMPLE_V, 1.0 - SAMPLE_V)
                    total_sharp += sharp[row, column] * weight
                    total_forward += forward_scatter[row, column] * weight
                    total_back += backscatter[row, column] * weight
                    total += weight
        total_sharp = total_sharp / total
        total_forward = total_forward / total
        total_back = total_back / total
    smooth_sharp[i, j] = total_sharp
    smooth_glow[i, j] = total_forward
    smooth_haze[i, j] = total_back
