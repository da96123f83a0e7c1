"""Motion of macroblocks of 16 x 16 px from the previous frame, in half pixels, and sub-pixel shifts of planes."""

from __future__ import annotations

import warp as wp

from oysterbench.sensors.video.transform import VIDEO_OPTIONS

wp.set_module_options(VIDEO_OPTIONS)

REACH = wp.constant(8)  # reach of the search on frames of a quarter of the size, px
VECTOR_COST = wp.constant(2)  # absolute differences that a half pixel of motion must save, at least
LUMA = wp.constant(2)  # steps of a motion vector per pixel of luma


@wp.func
def moved(plane: wp.array2d(dtype=wp.int32), row: int, column: int, dy: int, dx: int, unit: int):
    """Value of a plane at a pixel moved by (dy, dx) / unit pixels, bilinear."""
    y = wp.clamp(row * unit + dy, 0, (plane.shape[0] - 1) * unit)
    x = wp.clamp(column * unit + dx, 0, (plane.shape[1] - 1) * unit)
    i = y // unit
    j = x // unit
    v = y - i * unit
    u = x - j * unit
    value = plane[i, j] * (unit - v) * (unit - u)
    if u > 0:
        value += plane[i, j + 1] * (unit - v) * u
    if v > 0:
        value += plane[i + 1, j] * v * (unit - u)
        if u > 0:
            value += plane[i + 1, j + 1] * v * u
    return (value + unit * unit / 2) // (unit * unit)


@wp.kernel
def quarter(plane: wp.array2d(dtype=wp.int32), small: wp.array2d(dtype=wp.int32)):
    """Reduce a plane to a quarter of its size: means of 4 x 4 px."""
    i, j = wp.tid()
    total = wp.int32(8)
    for k in range(16):
        total += plane[4 * i + k // 4, 4 * j + k % 4]
    small[i, j] = total >> 4


@wp.func
def difference(
    now: wp.array2d(dtype=wp.int32), before: wp.array2d(dtype=wp.int32), i: int, j: int, dy: int, dx: int, most: int
):
    """Sum of absolute differences of a macroblock from the previous frame, moved by half pixels; stops at `most`."""
    total = wp.int32(0)
    row = wp.int32(0)
    y = 16 * i + (dy >> 1)
    x = 16 * j + (dx >> 1)
    whole = ((dy | dx) & 1) == 0
    inside = y >= 0 and x >= 0 and y + 16 <= before.shape[0] and x + 16 <= before.shape[1]
    while row < 16 and total < most:
        if whole and inside:
            for column in range(16):
                total += wp.abs(now[16 * i + row, 16 * j + column] - before[y + row, x + column])
        else:
            for column in range(16):
                seen = moved(before, 16 * i + row, 16 * j + column, dy, dx, LUMA)
                total += wp.abs(now[16 * i + row, 16 * j + column] - seen)
        row += 1
    return total


@wp.func
def coarse_difference(
    now: wp.array2d(dtype=wp.int32), before: wp.array2d(dtype=wp.int32), i: int, j: int, y: int, x: int, most: int
):
    """Sum of absolute differences of a macroblock on frames of a quarter of the size, moved by whole pixels there."""
    total = wp.abs(y) + wp.abs(x)
    row = wp.int32(0)
    while row < 4 and total < most:
        for column in range(4):
            total += wp.abs(now[4 * i + row, 4 * j + column] - before[4 * i + row + y, 4 * j + column + x])
        row += 1
    return total


@wp.kernel
def search(
    now: wp.array2d(dtype=wp.int32),
    before: wp.array2d(dtype=wp.int32),
    small_now: wp.array2d(dtype=wp.int32),
    small_before: wp.array2d(dtype=wp.int32),
    known: wp.array3d(dtype=wp.int32),
    vectors: wp.array3d(dtype=wp.int32),
    costs: wp.array2d(dtype=wp.int32),
):
    """Find the motion (row, column) of each macroblock in half pixels: the best of the search within REACH on the small
    frames, no motion, and the previous motion (`known`), refined nearby."""
    i, j = wp.tid()
    least = wp.int32(1 << 30)
    y = wp.int32(0)
    x = wp.int32(0)
    for dy in range(wp.max(-REACH, -4 * i), wp.min(REACH, small_now.shape[0] - 4 * i - 4) + 1):
        for dx in range(wp.max(-REACH, -4 * j), wp.min(REACH, small_now.shape[1] - 4 * j - 4) + 1):
            total = coarse_difference(small_now, small_before, i, j, dy, dx, least)
            if total < least:
                least = total
                y = 8 * dy
                x = 8 * dx
    best = difference(now, before, i, j, 0, 0, 1 << 30)
    best_y = wp.int32(0)
    best_x = wp.int32(0)
    for candidate in range(2):
        if candidate == 1:
            y = known[i, j, 0]
            x = known[i, j, 1]
        cost = VECTOR_COST * (wp.abs(y) + wp.abs(x))
        total = difference(now, before, i, j, y, x, best - cost) + cost
        if total < best:
            best = total
            best_y = y
            best_x = x
    for radius in range(3):
        step = 4 >> radius  # two pixels, one, half a pixel
        y = best_y
        x = best_x
        for k in range(9):
            dy = y + (k // 3 - 1) * step
            dx = x + (k % 3 - 1) * step
            if k != 4:
                cost = VECTOR_COST * (wp.abs(dy) + wp.abs(dx))
                total = difference(now, before, i, j, dy, dx, best - cost) + cost
                if total < best:
                    best = total
                    best_y = dy
                    best_x = dx
    vectors[i, j, 0] = best_y
    vectors[i, j, 1] = best_x
    costs[i, j] = best
