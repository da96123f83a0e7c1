"""How many pixels an instance would fill if nothing were before it."""

from __future__ import annotations

import warp as wp

from oysterbench.render.casting import Geometry, near_vehicle
from oysterbench.render.target import KERNEL_OPTIONS
from oysterbench.render.view import CameraView, pixel_ray, pixel_start
from oysterbench.render.walk import NO_FACE, strike_mesh

wp.set_module_options(KERNEL_OPTIONS)


@wp.func
def count_moving(
    world: Geometry,
    tree: wp.uint64,
    first: int,
    origin: wp.vec3,
    direction: wp.vec3,
    end: float,
    counts: wp.array(dtype=wp.int32),
):
    """Count, for a ray, what moves on its way; of things in pieces each piece."""
    query = wp.bvh_query_ray(tree, origin, direction)
    i = wp.int32(0)
    while wp.bvh_query_next(query, i, end):
        to_shape = world.placed[first + i].to_shape
        start = to_shape * (origin - world.placed[first + i].position)
        along = to_shape * direction
        if strike_mesh(world.library, world.placed[first + i].root, start, along, end, 1).face != NO_FACE:
            wp.atomic_add(counts, int(world.placed[first + i].number), 1)


@wp.kernel
def count_unhidden(world: Geometry, view: CameraView, counts: wp.array(dtype=wp.int32)):
    """Pixels in which each instance would be seen if it were alone."""
    row, column = wp.tid()
    origin = pixel_start(view, row, column)
    direction = pixel_ray(view, row, column)
    end = view.max_range / wp.length(direction)
    if world.count > 0:
        query = wp.bvh_query_ray(world.boxes, origin, direction)
        i = wp.int32(0)
        while wp.bvh_query_next(query, i, end):
            start = world.placed[i].to_shape * (origin - world.placed[i].position)
            along = world.placed[i].to_shape * direction
            if strike_mesh(world.library, world.placed[i].root, start, along, end, 1).face != NO_FACE:
                wp.atomic_add(counts, int(world.placed[i].number), 1)
    if world.swaying_count > 0:
        count_moving(world, world.swaying, world.first_swaying, origin, direction, end, counts)
    if world.roaming_count > 0:
        count_moving(world, world.roaming, world.first_roaming, origin, direction, end, counts)
    if world.vehicle.mesh != wp.uint64(0) and near_vehicle(world.vehicle, origin, direction):
        back = wp.transpose(world.vehicle.rotation)
        start = back * (origin - world.vehicle.position)
        if wp.mesh_query_ray_anyhit(world.vehicle.mesh, start, back * direction, end):
            wp.atomic_add(counts, int(world.vehicle.number), 1)
