"""A camera's place and rays on the device."""

from __future__ import annotations

import warp as wp


@wp.struct
class CameraView:
    """A camera: rotation takes its optical axes into `map`.

    rays (H + 2, W + 2): x and y at z = 1 of the ray through a pixel, and z where it starts, with a border of a pixel
    (lens.pixel_rays); focal, px, gives a pixel's width.
    """

    position: wp.vec3
    rotation: wp.mat33
    rays: wp.array2d(dtype=wp.vec3)
    focal: wp.float32
    max_range: wp.float32
    port: wp.int32


@wp.func
def ray_at(view: CameraView, u: float, v: float):
    """The ray of a place in the picture, px, between those of its neighbours."""
    x = wp.clamp(u + 1.0, 0.0, float(view.rays.shape[1] - 1) - 0.001)
    y = wp.clamp(v + 1.0, 0.0, float(view.rays.shape[0] - 1) - 0.001)
    i = int(y)
    j = int(x)
    s = x - float(j)
    low = view.rays[i, j] + (view.rays[i, j + 1] - view.rays[i, j]) * s
    high = view.rays[i + 1, j] + (view.rays[i + 1, j + 1] - view.rays[i + 1, j]) * s
    return low + (high - low) * (y - float(i))


@wp.func
def ray_through(view: CameraView, u: float, v: float):
    """Direction in `map` through a place in the picture, of unit length along the optical axis: t is depth."""
    ray = ray_at(view, u, v)
    return view.rotation * wp.vec3(ray[0], ray[1], 1.0)


@wp.func
def ray_start(view: CameraView, u: float, v: float):
    """Where on the optical axis the ray of a place in the picture starts, in `map`, m."""
    start = view.position
    if view.port != 0:
        start = start + view.rotation * wp.vec3(0.0, 0.0, ray_at(view, u, v)[2])
    return start


@wp.func
def pixel_ray(view: CameraView, row: int, column: int):
    """Direction in `map` through the centre of a pixel, of unit length along the optical axis: t is depth."""
    ray = view.rays[row + 1, column + 1]
    return view.rotation * wp.vec3(ray[0], ray[1], 1.0)


@wp.func
def pixel_start(view: CameraView, row: int, column: int):
    """Where on the optical axis the ray of a pixel starts, in `map`, m."""
    start = view.position
    if view.port != 0:
        start = start + view.rotation * wp.vec3(0.0, 0.0, view.rays[row + 1, column + 1][2])
    return start
