"""A camera's pose and rays on the device: one pose for the whole image, or one for each of its rows."""

from __future__ import annotations

import warp as wp

from oysterbench.render.arithmetic import clamped


@wp.struct
class CameraView:
    """A camera; rotation: from its optical frame to `map`.

    rays (H + 2, W + 2): x and y at z = 1 of the ray through a pixel, and z where it starts, with a border of one pixel
    (lens.pixel_rays); focal, px, gives a pixel's width. If `rolling` is not 0, row r is seen from positions[r + 1] and
    rotations[r + 1], (H + 2,) each, and `position` and `rotation` are those of the middle of the image.
    """

    position: wp.vec3
    rotation: wp.mat33
    rays: wp.array2d(dtype=wp.vec3)
    focal: wp.float32
    max_range: wp.float32
    port: wp.int32
    rolling: wp.int32
    positions: wp.array(dtype=wp.vec3)
    rotations: wp.array(dtype=wp.mat33)


@wp.func
def ray_at(view: CameraView, u: float, v: float):
    """Ray (x, y, start z) at column u and row v in the image, px, interpolated between pixels."""
    x = clamped(u + 1.0, 0.0, float(view.rays.shape[1] - 1) - 0.001)
    y = clamped(v + 1.0, 0.0, float(view.rays.shape[0] - 1) - 0.001)
    i = int(y)
    j = int(x)
    s = x - float(j)
    low = view.rays[i, j] + (view.rays[i, j + 1] - view.rays[i, j]) * s
    high = view.rays[i + 1, j] + (view.rays[i + 1, j + 1] - view.rays[i + 1, j]) * s
    return low + (high - low) * (y - float(i))


@wp.func
def rotation_at(view: CameraView, v: float):
    """The camera's rotation when row v of the image, px, is exposed."""
    rotation = view.rotation
    if view.rolling != 0:
        y = clamped(v + 1.0, 0.0, float(view.rotations.shape[0] - 1) - 0.001)
        i = int(y)
        rotation = view.rotations[i] + (view.rotations[i + 1] - view.rotations[i]) * (y - float(i))
    return rotation


@wp.func
def position_at(view: CameraView, v: float):
    """The camera's position in `map`, m, when row v of the image, px, is exposed."""
    position = view.position
    if view.rolling != 0:
        y = clamped(v + 1.0, 0.0, float(view.positions.shape[0] - 1) - 0.001)
        i = int(y)
        position = view.positions[i] + (view.positions[i + 1] - view.positions[i]) * (y - float(i))
    return position


@wp.func
def ray_through(view: CameraView, u: float, v: float):
    """Direction in `map` through column u and row v in the image, of unit length along the optical axis: t is depth."""
    ray = ray_at(view, u, v)
    return rotation_at(view, v) * wp.vec3(ray[0], ray[1], 1.0)


@wp.func
def ray_start(view: CameraView, u: float, v: float):
    """Point on the optical axis, in `map`, m, where the ray through column u and row v of the image starts."""
    start = position_at(view, v)
    if view.port != 0:
        start = start + rotation_at(view, v) * wp.vec3(0.0, 0.0, ray_at(view, u, v)[2])
    return start


@wp.func
def pixel_ray(view: CameraView, row: int, column: int):
    """Direction in `map` through the centre of a pixel, of unit length along the optical axis: t is depth."""
    ray = view.rays[row + 1, column + 1]
    rotation = view.rotation
    if view.rolling != 0:
        rotation = view.rotations[row + 1]
    return rotation * wp.vec3(ray[0], ray[1], 1.0)


@wp.func
def pixel_start(view: CameraView, row: int, column: int):
    """Point on the optical axis, in `map`, m, where the ray of a pixel starts."""
    start = view.position
    if view.rolling != 0:
        start = view.positions[row + 1]
    if view.port != 0:
        lift = wp.vec3(0.0, 0.0, view.rays[row + 1, column + 1][2])
        rotation = view.rotation
        if view.rolling != 0:
            rotation = view.rotations[row + 1]
        start = start + rotation * lift
    return start
