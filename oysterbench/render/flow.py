"""Optical flow: where the point seen by a pixel is at the next moment, in space and in the image."""

from __future__ import annotations

import numpy as np
import warp as wp
from numpy.typing import NDArray

from oysterbench.core.geometry import Array
from oysterbench.recipe import CameraRecipe
from oysterbench.render.casting import NOTHING, VEHICLE, Geometry, Hit, Placed, blend
from oysterbench.render.lens import project
from oysterbench.render.movers import Movers, no_rows
from oysterbench.render.passage import Moment
from oysterbench.render.target import KERNEL_OPTIONS
from oysterbench.render.view import CameraView, pixel_ray, pixel_start

wp.set_module_options(KERNEL_OPTIONS)

NEAREST_M = 0.01  # in front of the camera's pupil: nearer points have no flow
ROW_STEPS = 4  # iterations in which the row of a point is found, with a rolling shutter


@wp.kernel
def carry(
    world: Geometry,
    view: CameraView,
    hits: wp.array2d(dtype=Hit),
    moved: wp.array(dtype=Placed),
    first: int,
    vehicle_rotation: wp.mat33,
    vehicle_position: wp.vec3,
    points: wp.array2d(dtype=wp.vec3),
):
    """Find where, in `map`, the points seen by pixels are at the next moment: rows from `first` on are placed as in
    `moved`, the vehicle is at its next pose, and everything else stays."""
    row, column = wp.tid()
    hit = hits[row, column]
    p = pixel_start(view, row, column) + pixel_ray(view, row, column) * hit.t
    if hit.instance == VEHICLE:
        back = wp.transpose(world.vehicle.rotation)
        p = vehicle_rotation * (back * (p - world.vehicle.position)) + vehicle_position
    elif hit.instance >= first and hit.instance != NOTHING:
        then = moved[hit.instance - first]
        local = blend(world.points, world.corners, then.first_corner + 3 * hit.face, hit.u, hit.v)
        p = wp.inverse(then.to_shape) * local + then.position
    points[row, column] = p


def carried(
    geometry: Geometry, movers: Movers | None, view: CameraView, hits: wp.array, time_s: float, T_map_base: Array
) -> wp.array:
    """Positions (H, W) of vec3, in `map`, of the points hit by the pixels of a view, at time_s and with the vehicle at
    T_map_base."""
    rows = no_rows() if movers is None else movers.rows_at(time_s)
    points = wp.zeros(hits.shape, dtype=wp.vec3, device=hits.device)
    moved = wp.array(rows, dtype=Placed, device=hits.device)
    body = T_map_base[:3].astype(np.float32)
    vehicle = [wp.mat33(*body[:, :3].ravel().tolist()), wp.vec3(*body[:, 3].tolist())]
    inputs = [geometry, view, hits, moved, len(geometry.placed) - len(rows), *vehicle]
    wp.launch(carry, hits.shape, inputs=inputs, outputs=[points], device=hits.device)
    return points


def project_motion(
    points: NDArray[np.float32], within: NDArray[np.bool_], following: Moment, camera: CameraRecipe
) -> NDArray[np.float32]:
    """Motion (H, W, 2) px from each pixel's centre to where the camera images its point (H, W, 3), m in `map`, in the
    next image; NaN outside `within` (H, W), and for points behind the camera."""
    passage = following.passage
    rows, columns = np.nonzero(within)
    aims = points[rows, columns].astype(float)
    poses = np.asarray(following.T_map_cam, dtype=float)[None] if passage.rows is None else passage.rows
    found = np.full((len(rows), 2), np.nan)
    pose = np.full(len(rows), len(poses) // 2)
    # Each row has its own pose, and the row in which a point appears depends on that pose.
    for _ in range(1 if passage.rows is None else ROW_STEPS):
        T = poses[pose]
        seen = np.einsum("nji,nj->ni", T[:, :3, :3], aims - T[:, :3, 3])
        ahead = seen[:, 2] > NEAREST_M
        found[ahead] = project(seen[ahead], camera)
        found[~ahead] = np.nan
        pose = np.clip(np.nan_to_num(np.rint(found[:, 1] + 1)), 0, len(poses) - 1).astype(np.int64)
    motion = np.full((*within.shape, 2), np.nan, dtype=np.float32)
    motion[rows, columns] = np.round(found - np.column_stack([columns, rows]), 4)
    return motion
