"""Ambient occlusion: how much sky a surface sees, from one short ray per pixel, averaged over neighbours on the same
surface."""

from __future__ import annotations

import warp as wp

from oysterbench.render.casting import NOTHING, Geometry, Hit, blocked, near_roaming
from oysterbench.render.looks import Looks, crowded
from oysterbench.render.optics import Optics, shadows_lost
from oysterbench.render.target import KERNEL_OPTIONS
from oysterbench.render.view import CameraView, pixel_ray, pixel_start

wp.set_module_options(KERNEL_OPTIONS)

PRIOR_RAYS = wp.constant(1.0)  # weight of the openness estimated from height, in rays
FAN = wp.constant(16.0)  # rays of a pixel and its neighbours together
INTERREFLECTION = wp.constant(0.12)  # light reflected by neighbours in place of the sky that they hide


@wp.kernel
def occlude(
    world: Geometry,
    looks: Looks,
    optics: Optics,
    view: CameraView,
    fan: wp.array(dtype=wp.vec3),
    hits: wp.array2d(dtype=Hit),
    normals: wp.array2d(dtype=wp.vec3),
    open: wp.array2d(dtype=wp.float32),
):
    """Cast one ray of a fan of 16 from each pixel's surface; 4 x 4 neighbours together cover the whole fan (Keller &
    Heidrich 2001)."""
    row, column = wp.tid()
    hit = hits[row, column]
    share = wp.float32(1.0)
    if hit.instance != NOTHING:
        direction = pixel_ray(view, row, column)
        p = pixel_start(view, row, column) + direction * hit.t
        normal = normals[row, column]
        wanted = hit.instance >= 0
        if not wanted:
            wanted = crowded(looks, p)
        if not wanted:
            wanted = near_roaming(world, p, normal, optics.occlusion)
        if wanted:
            wanted = not shadows_lost(optics, p, hit.t * wp.length(direction))
        if wanted:
            # A frame around the normal (Duff et al. 2017).
            side = wp.float32(1.0)
            if normal[2] < 0.0:
                side = wp.float32(-1.0)
            a = -1.0 / (side + normal[2])
            b = normal[0] * normal[1] * a
            x = wp.vec3(1.0 + side * normal[0] * normal[0] * a, side * b, -side * normal[0])
            y = wp.vec3(b, side + normal[1] * normal[1] * a, -normal[1])
            ray = fan[(row & 3) * 4 + (column & 3)]
            towards = x * ray[0] + y * ray[1] + normal * ray[2]
            start = p + normal * (0.001 + 0.0005 * hit.t)
            if blocked(world, start, towards, optics.occlusion, 0):
                share = wp.float32(0.0)
    open[row, column] = share


@wp.func
def same_surface(hits: wp.array2d(dtype=Hit), normals: wp.array2d(dtype=wp.vec3), i: int, j: int, k: int, m: int):
    """Whether two pixels see adjacent parts of one surface; False outside the image."""
    same = k >= 0 and m >= 0 and k < hits.shape[0] and m < hits.shape[1]
    if same:
        t = hits[i, j].t
        same = wp.abs(hits[k, m].t - t) < 0.03 * t and wp.dot(normals[k, m], normals[i, j]) > 0.4
    return same


@wp.func
def gathered(
    open: wp.array2d(dtype=wp.float32),
    hits: wp.array2d(dtype=Hit),
    normals: wp.array2d(dtype=wp.vec3),
    row: int,
    column: int,
    prior: float,
):
    """Openness from the rays of the neighbours on the same surface, pulled towards `prior` if they are few."""
    hidden = wp.bool(False)
    for di in range(-2, 2):
        for dj in range(-2, 2):
            i = wp.clamp(row + di, 0, open.shape[0] - 1)
            j = wp.clamp(column + dj, 0, open.shape[1] - 1)
            hidden = hidden or open[i, j] < 1.0
    share = (PRIOR_RAYS * prior + FAN) / (PRIOR_RAYS + FAN)
    if hidden:
        total = PRIOR_RAYS * prior
        weight = wp.float32(PRIOR_RAYS)
        for di in range(-2, 2):
            for dj in range(-2, 2):
                if same_surface(hits, normals, row, column, row + di, column + dj):
                    total += open[row + di, column + dj]
                    weight += 1.0
        share = total / weight
    return share + (1.0 - share) * INTERREFLECTION
