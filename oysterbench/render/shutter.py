"""Motion blur: an image of one instant, gathered along the displacement of each pixel's surface in the image.

After McGuire et al. 2012 ("A reconstruction filter for plausible motion blur") and Guertin et al. 2014: where the
whole neighbourhood moves alike, a pixel is the mean along its own displacement; where something faster is near, the
part of it that lies in front of the pixel and reaches it covers it for a share of the time.

A `way` is the displacement of a surface in the image, px, from when the shutter opens to when it closes.
"""

from __future__ import annotations

import numpy as np
import warp as wp

from oysterbench.core.geometry import Array
from oysterbench.render.casting import NOTHING, VEHICLE, Hit
from oysterbench.render.target import KERNEL_OPTIONS
from oysterbench.render.view import CameraView, pixel_ray, pixel_start, rotation_at

wp.set_module_options(KERNEL_OPTIONS)

TILES = 40  # across the image; a way is limited to two tiles, as only neighbouring tiles take it into account
SHARP_PX = wp.constant(0.25)  # shorter ways do not blur
ALIKE_PX = wp.constant(0.75)  # ways that differ by less count as equal
STEP_PX = wp.constant(1.5)  # spacing of samples
LONG_PX = wp.constant(4.0)  # along longer ways, samples are not interpolated between pixels
SOFT_DEPTH = wp.constant(0.02)  # relative step in depth over which one surface comes to be in front of another
LEAST_WEIGHT = wp.constant(1.0e-6)  # of the pixel itself, if everything along its way lies in front of it
LEAST_MOVED_M = wp.constant(1.0e-5)  # while the shutter is open: anything less counts as at rest
OPEN_WATER_M = wp.constant(50.0)  # depth of pixels that see nothing but water


class Shutter:
    """Blurs images (H, W) of vec3 on the device according to the motion while the shutter is open."""

    def __init__(self, shape: tuple[int, int], device: str) -> None:
        self.device = device
        self.shape = shape
        self.side = max(-(-shape[1] // TILES), 4)
        tiles = (-(-shape[0] // self.side), -(-shape[1] // self.side))
        self.ways = wp.zeros(shape, dtype=wp.vec2, device=device)
        self._longest = wp.zeros(tiles, dtype=wp.vec2, device=device)
        self._around = wp.zeros(tiles, dtype=wp.vec2, device=device)

    def trace(
        self, view: CameraView, hits: wp.array, T_map_cam: Array, ends: Array, then: wp.array | None = None
    ) -> None:
        """Find the way (H, W), px, of each pixel from when the shutter opens to when it closes (Passage.ends).

        then (H, W) of vec3: if things move, where in `map` the point seen by each pixel is when the shutter closes.
        """
        motions = []
        for end in ends:
            seen = np.round(np.linalg.inv(end) @ T_map_cam, 9).astype(np.float32)
            motions += [wp.mat33(*seen[:3, :3].ravel().tolist()), wp.vec3(*seen[:3, 3].tolist())]
        tiles = self._longest.shape
        inputs = [view, hits, *motions, 2.0 * self.side]
        wp.launch(find_ways, self.shape, inputs=inputs, outputs=[self.ways], device=self.device)
        if then is not None:
            inputs = [view, hits, then, 2.0 * self.side]
            wp.launch(add_own_ways, self.shape, inputs=inputs, outputs=[self.ways], device=self.device)
        wp.launch(longest_way, tiles, inputs=[self.ways, self.side], outputs=[self._longest], device=self.device)
        wp.launch(longest_around, tiles, inputs=[self._longest], outputs=[self._around], device=self.device)

    def blur(self, picture: wp.array, hits: wp.array, blurred: wp.array) -> None:
        """Write the blurred image into `blurred`."""
        inputs = [picture, hits, self.ways, self._around, self.side]
        wp.launch(gather, self.shape, inputs=inputs, outputs=[blurred], device=self.device)


@wp.func
def through_lens(view: CameraView, i: int, j: int, dx: float, dy: float):
    """Displacement in px that changes the slopes of a pixel's ray by dx, dy, from how slopes vary between pixels."""
    across = (view.rays[i + 1, j + 2] - view.rays[i + 1, j]) * 0.5
    down = (view.rays[i + 2, j + 1] - view.rays[i, j + 1]) * 0.5
    area = across[0] * down[1] - across[1] * down[0]
    return wp.vec2((dx * down[1] - dy * down[0]) / area, (across[0] * dy - across[1] * dx) / area)


@wp.func
def cut(way: wp.vec2, longest: float):
    """Limit a way to a length, px."""
    length = wp.length(way)
    if length > longest:
        way = way * (longest / length)
    return way


@wp.kernel
def find_ways(
    view: CameraView,
    hits: wp.array2d(dtype=Hit),
    first_turn: wp.mat33,
    first_shift: wp.vec3,
    last_turn: wp.mat33,
    last_shift: wp.vec3,
    longest: float,
    ways: wp.array2d(dtype=wp.vec2),
):
    """Find the way of the point seen by each pixel if it is at rest. turn, shift: from the camera's frame now into
    those when the shutter opens and closes."""
    i, j = wp.tid()
    hit = hits[i, j]
    way = wp.vec2(0.0, 0.0)
    if hit.instance != VEHICLE:
        t = wp.min(hit.t, OPEN_WATER_M)
        if hit.instance == NOTHING:
            t = OPEN_WATER_M
        ray = view.rays[i + 1, j + 1]
        p = wp.vec3(ray[0] * t, ray[1] * t, ray[2] + t)
        a = first_turn * p + first_shift
        b = last_turn * p + last_shift
        near = wp.max(a[2] - ray[2], 0.01)
        far = wp.max(b[2] - ray[2], 0.01)
        dx = b[0] / far - a[0] / near
        dy = b[1] / far - a[1] / near
        way = cut(through_lens(view, i, j, dx, dy), longest)
    ways[i, j] = way


@wp.kernel
def add_own_ways(
    view: CameraView,
    hits: wp.array2d(dtype=Hit),
    then: wp.array2d(dtype=wp.vec3),
    longest: float,
    ways: wp.array2d(dtype=wp.vec2),
):
    """Add the motion of moving things, uniform while the shutter is open; then: where they are when it closes."""
    i, j = wp.tid()
    hit = hits[i, j]
    if hit.instance >= 0:
        direction = pixel_ray(view, i, j)
        start = pixel_start(view, i, j)
        moved = then[i, j] - (start + direction * hit.t)
        if wp.length_sq(moved) > LEAST_MOVED_M * LEAST_MOVED_M:
            rotation = rotation_at(view, float(i))
            half = wp.transpose(rotation) * moved
            ray = view.rays[i + 1, j + 1]
            near = wp.max(hit.t - half[2], 0.01)
            far = wp.max(hit.t + half[2], 0.01)
            dx = (ray[0] * hit.t + half[0]) / far - (ray[0] * hit.t - half[0]) / near
            dy = (ray[1] * hit.t + half[1]) / far - (ray[1] * hit.t - half[1]) / near
            ways[i, j] = cut(ways[i, j] + through_lens(view, i, j, dx, dy), longest)


@wp.kernel
def longest_way(ways: wp.array2d(dtype=wp.vec2), side: int, longest: wp.array2d(dtype=wp.vec2)):
    """Find the longest way in each tile."""
    i, j = wp.tid()
    best = wp.vec2(0.0, 0.0)
    for row in range(i * side, wp.min((i + 1) * side, ways.shape[0])):
        for column in range(j * side, wp.min((j + 1) * side, ways.shape[1])):
            if wp.length_sq(ways[row, column]) > wp.length_sq(best):
                best = ways[row, column]
    longest[i, j] = best


@wp.kernel
def longest_around(longest: wp.array2d(dtype=wp.vec2), around: wp.array2d(dtype=wp.vec2)):
    """Find the longest way in each tile and its eight neighbours."""
    i, j = wp.tid()
    best = wp.vec2(0.0, 0.0)
    for row in range(wp.max(i - 1, 0), wp.min(i + 2, longest.shape[0])):
        for column in range(wp.max(j - 1, 0), wp.min(j + 2, longest.shape[1])):
            if wp.length_sq(longest[row, column]) > wp.length_sq(best):
                best = longest[row, column]
    around[i, j] = best


@wp.func
def between(picture: wp.array2d(dtype=wp.vec3), u: float, v: float):
    """Value of an image at column u and row v, px, interpolated bilinearly."""
    x = wp.clamp(u, 0.0, float(picture.shape[1] - 1) - 0.001)
    y = wp.clamp(v, 0.0, float(picture.shape[0] - 1) - 0.001)
    i = int(y)
    j = int(x)
    s = x - float(j)
    low = picture[i, j] + (picture[i, j + 1] - picture[i, j]) * s
    high = picture[i + 1, j] + (picture[i + 1, j + 1] - picture[i + 1, j]) * s
    return low + (high - low) * (y - float(i))


@wp.func
def depth_of(hits: wp.array2d(dtype=Hit), i: int, j: int):
    """Depth of a pixel, m; that of open water where it sees no surface."""
    return wp.where(hits[i, j].instance == NOTHING, OPEN_WATER_M, wp.min(hits[i, j].t, OPEN_WATER_M))


@wp.func
def in_front(hits: wp.array2d(dtype=Hit), depth: float, x: float, y: float):
    """Degree, from 0 to 1, to which the surface at a place, px, lies in front of a depth, m."""
    row = wp.clamp(int(y + 0.5), 0, hits.shape[0] - 1)
    column = wp.clamp(int(x + 0.5), 0, hits.shape[1] - 1)
    other = depth_of(hits, row, column)
    return wp.clamp((depth - other) / (SOFT_DEPTH * wp.min(other, depth)), 0.0, 1.0)


@wp.func
def covers(ways: wp.array2d(dtype=wp.vec2), x: float, y: float, distance: float):
    """Degree, from 0 to 1, to which the surface at a place, px, covers a distance, px, on its own way."""
    row = wp.clamp(int(y + 0.5), 0, ways.shape[0] - 1)
    column = wp.clamp(int(x + 0.5), 0, ways.shape[1] - 1)
    return wp.clamp(0.5 * wp.length(ways[row, column]) - distance + 0.5, 0.0, 1.0)


@wp.kernel
def gather(
    picture: wp.array2d(dtype=wp.vec3),
    hits: wp.array2d(dtype=Hit),
    ways: wp.array2d(dtype=wp.vec2),
    around: wp.array2d(dtype=wp.vec2),
    side: int,
    blurred: wp.array2d(dtype=wp.vec3),
):
    """Compute the mean of each pixel over the exposure."""
    i, j = wp.tid()
    u = float(j)
    v = float(i)
    own = ways[i, j]
    most = around[i // side, j // side]
    longest = wp.max(wp.length(most), wp.length(own))
    total = picture[i, j]
    if longest > SHARP_PX:
        n = wp.max(int(wp.ceil(longest / STEP_PX)), 2)
        step = 1.0 / float(n)
        total = wp.vec3(0.0, 0.0, 0.0)
        if wp.length(most - own) < ALIKE_PX + 0.25 * longest:
            if longest > LONG_PX:
                for k in range(n):
                    at = (float(k) + 0.5) * step - 0.5
                    row = wp.clamp(int(v + own[1] * at + 0.5), 0, picture.shape[0] - 1)
                    column = wp.clamp(int(u + own[0] * at + 0.5), 0, picture.shape[1] - 1)
                    total += picture[row, column]
            else:
                for k in range(n):
                    at = (float(k) + 0.5) * step - 0.5
                    total += between(picture, u + own[0] * at, v + own[1] * at)
            total = total * step
        else:
            # The surface here, without what lies in front of it, overlaid by what passes in front for a share of time.
            depth = depth_of(hits, i, j)
            here = picture[i, j] * LEAST_WEIGHT
            seen = LEAST_WEIGHT
            before = wp.vec3(0.0, 0.0, 0.0)
            hidden = wp.float32(0.0)
            for k in range(n):
                at = (float(k) + 0.5) * step - 0.5
                x = u + own[0] * at
                y = v + own[1] * at
                weight = 1.0 - in_front(hits, depth, x, y)
                here += between(picture, x, y) * weight
                seen += weight
                x = u + most[0] * at
                y = v + most[1] * at
                weight = in_front(hits, depth, x, y)
                if weight > 0.0:
                    weight = weight * covers(ways, x, y, wp.abs(at) * wp.length(most))
                    before += between(picture, x, y) * weight
                    hidden += weight
            total = here * ((1.0 - hidden * step) / seen) + before * step
    blurred[i, j] = total
