"""Planes of a frame: conversion of RGB to luma and colour differences and back, and the loop filter."""

from __future__ import annotations

import warp as wp

from oysterbench.sensors.video.motion import moved
from oysterbench.sensors.video.transform import VIDEO_OPTIONS

wp.set_module_options(VIDEO_OPTIONS)


@wp.kernel
def deblock(
    plane: wp.array2d(dtype=wp.int32),
    coded: wp.array2d(dtype=wp.int32),
    side: int,
    axis: int,
    edge: int,
    slope: int,
    most: int,
):
    """Smooth the step across an edge of 4 x 4 blocks where either was coded, or of macroblocks (`side` px): the filter
    for bS < 4, on the two pixels at the edge. edge, slope, most: alpha, beta and tc of the quantiser."""
    line, block = wp.tid()
    at = 4 * (block + 1)
    i = wp.where(axis == 0, at, line)
    j = wp.where(axis == 0, line, at)
    di = wp.where(axis == 0, 1, 0)
    dj = 1 - di
    smooth = coded[i // 4, j // 4] + coded[(i - di) // 4, (j - dj) // 4] > 0 or at % side == 0
    if smooth:
        p1 = plane[i - 2 * di, j - 2 * dj]
        p0 = plane[i - di, j - dj]
        q0 = plane[i, j]
        q1 = plane[i + di, j + dj]
        if wp.abs(p0 - q0) < edge and wp.abs(p1 - p0) < slope and wp.abs(q1 - q0) < slope:
            delta = wp.clamp((((q0 - p0) << 2) + (p1 - q1) + 4) >> 3, -most, most)
            plane[i - di, j - dj] = wp.clamp(p0 + delta, 0, 255)
            plane[i, j] = wp.clamp(q0 - delta, 0, 255)


@wp.kernel
def split_colours(
    picture: wp.array3d(dtype=wp.uint8),
    luma: wp.array2d(dtype=wp.int32),
    blue: wp.array2d(dtype=wp.int32),
    red: wp.array2d(dtype=wp.int32),
):
    """Split RGB into luma and colour differences of 2 x 2 px (BT.601, full range); edge pixels are repeated beyond the
    frame."""
    i, j = wp.tid()
    b = wp.int32(0)
    r = wp.int32(0)
    for k in range(4):
        row = wp.min(2 * i + k // 2, picture.shape[0] - 1)
        column = wp.min(2 * j + k % 2, picture.shape[1] - 1)
        red_now = int(picture[row, column, 0])
        green_now = int(picture[row, column, 1])
        blue_now = int(picture[row, column, 2])
        luma[2 * i + k // 2, 2 * j + k % 2] = (77 * red_now + 150 * green_now + 29 * blue_now + 128) >> 8
        b += -43 * red_now - 85 * green_now + 128 * blue_now
        r += 128 * red_now - 107 * green_now - 21 * blue_now
    blue[i, j] = wp.clamp(((b + 512) >> 10) + 128, 0, 255)
    red[i, j] = wp.clamp(((r + 512) >> 10) + 128, 0, 255)


@wp.kernel
def join_colours(
    luma: wp.array2d(dtype=wp.int32),
    blue: wp.array2d(dtype=wp.int32),
    red: wp.array2d(dtype=wp.int32),
    picture: wp.array3d(dtype=wp.uint8),
):
    """Convert luma and colour differences, which are interpolated, back to RGB."""
    i, j = wp.tid()
    y = luma[i, j]
    # A pixel's centre lies a quarter of a colour pixel off the centre of the colour pixel.
    b = moved(blue, i // 2, j // 2, 2 * (i % 2) - 1, 2 * (j % 2) - 1, 4) - 128
    r = moved(red, i // 2, j // 2, 2 * (i % 2) - 1, 2 * (j % 2) - 1, 4) - 128
    picture[i, j, 0] = wp.uint8(wp.clamp(y + ((359 * r + 128) >> 8), 0, 255))
    picture[i, j, 1] = wp.uint8(wp.clamp(y - ((88 * b + 183 * r + 128) >> 8), 0, 255))
    picture[i, j, 2] = wp.uint8(wp.clamp(y + ((454 * b + 128) >> 8), 0, 255))
