"""Smooth outlines: more rays where surfaces meet, lit by the pixels around that see the same surfaces.

As in multisampling on graphics cards, a surface is shaded once a pixel and only what covers it is sampled more often.
"""

from __future__ import annotations

import warp as wp

from oysterbench.render.casting import FAR_M, RELIEF, SKIRT, Geometry, Hit, cast
from oysterbench.render.target import KERNEL_OPTIONS
from oysterbench.render.view import CameraView, ray_start, ray_through

wp.set_module_options(KERNEL_OPTIONS)

OUTLINE_CONTRAST = wp.constant(0.08)  # relative step in green between two surfaces that asks for more samples
INNER_CONTRAST = wp.constant(0.45)  # and within one, as at the rim of a shadow
SAMPLE_U, SAMPLE_V = wp.constant(0.33), wp.constant(0.20)  # of two more samples, either side of the centre, px


@wp.func
def surface_of(hits: wp.array2d(dtype=Hit), i: int, j: int):
    """Which surface a pixel sees; the seabed and its skirt are one."""
    seen = hits[i, j].instance
    return wp.where(seen == SKIRT, RELIEF, seen)


@wp.func
def surface_at(world: Geometry, view: CameraView, u: float, v: float):
    """Which surface lies behind a place in the picture, px."""
    hit = cast(world, ray_start(view, u, v), ray_through(view, u, v), FAR_M)
    return wp.where(hit.instance == SKIRT, RELIEF, hit.instance)


@wp.func
def edge_between(level: wp.array2d(dtype=wp.float32), hits: wp.array2d(dtype=Hit), i: int, j: int, k: int, m: int):
    """2 where the outline of a surface runs between two pixels, 1 where another edge does, else 0; none too weak."""
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
    level: wp.array2d(dtype=wp.float32),
    sharp: wp.array2d(dtype=wp.vec3),
    forward_scatter: wp.array2d(dtype=wp.vec3),
    backscatter: wp.array2d(dtype=wp.vec3),
    smooth_sharp: wp.array2d(dtype=wp.vec3),
    smooth_glow: wp.array2d(dtype=wp.vec3),
    smooth_haze: wp.array2d(dtype=wp.vec3),
):
    """Where an edge runs between neighbours, the mean of the centre and a sample on each side of it, on a slant.

    A sample takes its light from those of the four pixels around it that see its surface, the more the nearer; one
    whose surface none of them sees is thinner than a pixel, and does not count.
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
                u = float(j) + SAMPLE_U * float(side)
                v = float(i) + SAMPLE_V * float(side)
                surface = surface_at(world, view, u, v)
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
