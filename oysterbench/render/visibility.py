"""Number of pixels that an instance would cover if nothing occluded it, and transmittance of the water."""

from __future__ import annotations

import warp as wp

from oysterbench.render.casting import NOTHING, Geometry, Hit, near_vehicle
from oysterbench.render.optics import Optics
from oysterbench.render.tables import look_up_pair
from oysterbench.render.target import KERNEL_OPTIONS
from oysterbench.render.view import CameraView, pixel_ray, pixel_start
from oysterbench.render.walk import NO_FACE, strike_mesh
from oysterbench.render.way import way_to

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
    """Count the moving things met by a ray; each piece of a composite thing counts."""
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
    """Count the pixels in which each instance would be seen if it were on its own."""
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


@wp.kernel
def transmit(view: CameraView, optics: Optics, hits: wp.array2d(dtype=Hit), arriving: wp.array2d(dtype=wp.float32)):
    """Share, in green, of the daylight from each pixel's surface that arrives; 0 where there is no surface."""
    row, column = wp.tid()
    hit = hits[row, column]
    share = wp.float32(0.0)
    if hit.instance != NOTHING:
        direction = pixel_ray(view, row, column)
        p = pixel_start(view, row, column) + direction * hit.t
        distance = hit.t * wp.length(direction)
        across = float(column) / float(hits.shape[1] - 1)
        way = way_to(optics, across, float(row) / float(hits.shape[0] - 1), distance, p)
        depth = -p[2] / optics.depth_step
        through = distance / optics.range_step
        even = look_up_pair(optics.direct, depth, through) + look_up_pair(optics.forward_scatter, depth, through)
        share = even[1] * way.image[1]
    arriving[row, column] = share
