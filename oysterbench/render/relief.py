"""Ray casting into a height field with a pyramid of maxima (Tevs, Ihrke & Seidel 2008, "Maximum mipmaps")."""

from __future__ import annotations

import numpy as np
import warp as wp
from numpy.typing import NDArray

from oysterbench.render.arithmetic import clamped, greater, lesser

LEVELS = 7  # the coarsest cell is 64 cells wide

TOP = wp.constant(LEVELS - 1)


@wp.struct
class Relief:
    """Heights (n + 1, n + 1) in m, indexed [y, x], over the square that starts at (start, start) with n cells per side.

    top: the highest of all, m. highest: maxima over blocks of 1, 2, 4... cells, level after level, row by row; first:
    where each level starts in it.
    """

    heights: wp.array2d(dtype=wp.float32)
    start: wp.float32
    step: wp.float32
    cells: wp.int32
    top: wp.float32
    highest: wp.array(dtype=wp.float32)
    first: wp.array(dtype=wp.int32)


def build_relief(heights: NDArray[np.float32], start: float, step: float, device: str) -> Relief:
    """Build a relief on a device from heights (n + 1, n + 1) in m on a grid of `step` m."""
    level = np.maximum(np.maximum(heights[:-1, :-1], heights[1:, :-1]), np.maximum(heights[:-1, 1:], heights[1:, 1:]))
    levels = [level]
    for _ in range(LEVELS - 1):
        odd = level.shape[0] % 2
        level = np.pad(level, ((0, odd), (0, odd)), mode="edge")
        level = np.maximum(
            np.maximum(level[::2, ::2], level[1::2, ::2]), np.maximum(level[::2, 1::2], level[1::2, 1::2])
        )
        levels.append(level)
    relief = Relief()
    relief.heights = wp.array(np.ascontiguousarray(heights), dtype=wp.float32, device=device)
    relief.start, relief.step, relief.cells = start, step, heights.shape[0] - 1
    relief.top = float(heights.max()) + 1e-4
    relief.highest = wp.array(np.concatenate([level.ravel() for level in levels]), dtype=wp.float32, device=device)
    relief.first = wp.array(np.cumsum([0, *(level.size for level in levels)]), dtype=wp.int32, device=device)
    return relief


@wp.func
def bilinear(relief: Relief, x: float, y: float):
    """Height, m, at (x, y) in cells from the start, clamped to the square."""
    last = float(relief.cells) - 0.001
    cx = clamped(x, 0.0, last)
    cy = clamped(y, 0.0, last)
    j = int(cx)
    i = int(cy)
    u = cx - float(j)
    v = cy - float(i)
    low = relief.heights[i, j] * (1.0 - u) + relief.heights[i, j + 1] * u
    high = relief.heights[i + 1, j] * (1.0 - u) + relief.heights[i + 1, j + 1] * u
    return low * (1.0 - v) + high * v


@wp.func
def over_relief(relief: Relief, p: wp.vec3):
    """Whether a point lies above or below the square."""
    size = relief.step * float(relief.cells)
    x = p[0] - relief.start
    y = p[1] - relief.start
    return x >= 0.0 and y >= 0.0 and x <= size and y <= size


@wp.func
def relief_normal(relief: Relief, p: wp.vec3):
    """Smooth unit normal at a point over the square, from central differences."""
    x = (p[0] - relief.start) / relief.step
    y = (p[1] - relief.start) / relief.step
    slope_x = bilinear(relief, x + 1.0, y) - bilinear(relief, x - 1.0, y)
    slope_y = bilinear(relief, x, y + 1.0) - bilinear(relief, x, y - 1.0)
    return wp.normalize(wp.vec3(-slope_x, -slope_y, 2.0 * relief.step))


@wp.func
def above(relief: Relief, i: int, j: int, u: float, v: float, z: float):
    """Height of a point at u, v, z above the ground in cell (row i, column j), whose two triangles meet on u = v."""
    a = relief.heights[i, j]
    d = relief.heights[i + 1, j + 1]
    corner = relief.heights[i, j + 1]
    ground = a + u * (corner - a) + v * (d - corner)
    if v > u:
        corner = relief.heights[i + 1, j]
        ground = a + v * (corner - a) + u * (d - corner)
    return z - ground


@wp.func
def cast_relief(relief: Relief, origin: wp.vec3, direction: wp.vec3, max_t: float):
    """First t at which a ray passes below the triangles of the square, or -1 if it does not before max_t."""
    x0 = (origin[0] - relief.start) / relief.step
    y0 = (origin[1] - relief.start) / relief.step
    dx = direction[0] / relief.step
    dy = direction[1] / relief.step
    # A ray that does not move along an axis crosses none of its grid lines: substitute a tiny step.
    if wp.abs(dx) < 1.0e-9:
        dx = wp.float32(1.0e-9)
    if wp.abs(dy) < 1.0e-9:
        dy = wp.float32(1.0e-9)
    inverse_x = 1.0 / dx
    inverse_y = 1.0 / dy
    n = relief.cells
    size = float(n)
    enter_x = lesser(-x0 * inverse_x, (size - x0) * inverse_x)
    enter_y = lesser(-y0 * inverse_y, (size - y0) * inverse_y)
    leave_x = greater(-x0 * inverse_x, (size - x0) * inverse_x)
    leave_y = greater(-y0 * inverse_y, (size - y0) * inverse_y)
    t = greater(greater(enter_x, enter_y), 0.0)
    end = lesser(lesser(leave_x, leave_y), max_t)
    # Nothing can be hit before the ray is down to the highest ground.
    if direction[2] < 0.0:
        t = greater(t, (relief.top - origin[2]) / direction[2])
    elif origin[2] > relief.top:
        end = wp.float32(-1.0)
    found = wp.float32(-1.0)
    j = wp.clamp(int(wp.floor(x0 + dx * t)), 0, n - 1)
    i = wp.clamp(int(wp.floor(y0 + dy * t)), 0, n - 1)
    level = wp.int32(5)
    while t < end and found < 0.0:
        width = 1 << level
        row = i >> level
        column = j >> level
        # The lines through which the ray leaves this node, as whole numbers of cells.
        line_x = column * width
        if dx > 0.0:
            line_x = (column + 1) * width
        line_y = row * width
        if dy > 0.0:
            line_y = (row + 1) * width
        out_x = (float(line_x) - x0) * inverse_x
        out_y = (float(line_y) - y0) * inverse_y
        out = lesser(lesser(out_x, out_y), end)
        lowest = origin[2] + direction[2] * wp.where(direction[2] < 0.0, out, t)
        per_row = (n + width - 1) >> level
        if lowest <= relief.highest[relief.first[level] + row * per_row + column]:
            if level > 0:
                level -= 1
                continue
            u = x0 + dx * t - float(j)
            v = y0 + dy * t - float(i)
            before = above(relief, i, j, u, v, origin[2] + direction[2] * t)
            # Between entry, diagonal and exit the height over the ground is linear in t.
            middle = t + (v - u) / (dx - dy)
            if middle > t and middle < out:
                w = x0 + dx * middle - float(j)
                at_middle = above(relief, i, j, w, w, origin[2] + direction[2] * middle)
                if at_middle <= 0.0:
                    found = t + (middle - t) * greater(before, 0.0) / (greater(before, 0.0) - at_middle + 1.0e-12)
                before = at_middle
                t = middle
            if found < 0.0:
                u = x0 + dx * out - float(j)
                v = y0 + dy * out - float(i)
                after = above(relief, i, j, u, v, origin[2] + direction[2] * out)
                if after <= 0.0:
                    found = t + (out - t) * greater(before, 0.0) / (greater(before, 0.0) - after + 1.0e-12)
        # Step to the next node: exactly across the line that is crossed, and to the ray's place along the other axis.
        if out_x <= out_y:
            j = line_x
            if dx < 0.0:
                j = line_x - 1
            i = wp.clamp(int(wp.floor(y0 + dy * out)), row * width, row * width + width - 1)
        else:
            i = line_y
            if dy < 0.0:
                i = line_y - 1
            j = wp.clamp(int(wp.floor(x0 + dx * out)), column * width, column * width + width - 1)
        if i < 0 or j < 0 or i >= n or j >= n:
            end = wp.float32(-1.0)
        t = greater(out, t)
        level = wp.min(level + 1, TOP)
    return found
