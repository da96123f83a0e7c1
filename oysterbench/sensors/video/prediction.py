"""Predictive coding: macroblocks predicted from the previous frame, or blocks from their neighbours."""

from __future__ import annotations

import warp as wp

from oysterbench.sensors.video.motion import LUMA, moved
from oysterbench.sensors.video.transform import VIDEO_OPTIONS, Quantiser, bits_of, code_block, mat44i, signed_bits

wp.set_module_options(VIDEO_OPTIONS)

INTRA_COST = wp.constant(512)  # absolute differences that a macroblock without prediction must save
CHROMA = wp.constant(4)  # steps of a motion vector (half pixels of luma) per pixel of a colour difference


@wp.func
def code_moved(
    q: Quantiser,
    now: wp.array2d(dtype=wp.int32),
    before: wp.array2d(dtype=wp.int32),
    i: int,
    j: int,
    dy: int,
    dx: int,
    unit: int,
    level: int,
    decoded: wp.array2d(dtype=wp.int32),
    coded: wp.array2d(dtype=wp.int32),
):
    """Code 4 x 4 px from (i, j) on as differences from the moved previous frame, or from a level; return the bits."""
    residual = mat44i()
    guess = mat44i()
    for k in range(16):
        seen = level
        if level < 0:
            seen = moved(before, i + k // 4, j + k % 4, dy, dx, unit)
        guess[k // 4, k % 4] = seen
        residual[k // 4, k % 4] = now[i + k // 4, j + k % 4] - seen
    found, bits = code_block(q, residual)
    for k in range(16):
        decoded[i + k // 4, j + k % 4] = wp.clamp(guess[k // 4, k % 4] + found[k // 4, k % 4], 0, 255)
    coded[i // 4, j // 4] = wp.where(bits > 1, 1, 0)
    return bits


@wp.kernel
def code_inter(
    q: Quantiser,
    chroma: Quantiser,
    now: wp.array2d(dtype=wp.int32),
    now_b: wp.array2d(dtype=wp.int32),
    now_r: wp.array2d(dtype=wp.int32),
    before: wp.array2d(dtype=wp.int32),
    before_b: wp.array2d(dtype=wp.int32),
    before_r: wp.array2d(dtype=wp.int32),
    vectors: wp.array3d(dtype=wp.int32),
    costs: wp.array2d(dtype=wp.int32),
    luma: wp.array2d(dtype=wp.int32),
    blue: wp.array2d(dtype=wp.int32),
    red: wp.array2d(dtype=wp.int32),
    coded: wp.array2d(dtype=wp.int32),
    coded_b: wp.array2d(dtype=wp.int32),
    coded_r: wp.array2d(dtype=wp.int32),
    bits: wp.array2d(dtype=wp.int32),
):
    """Code each macroblock as differences from the previous frame, or from its own mean where that is closer."""
    i, j = wp.tid()
    dy = vectors[i, j, 0]
    dx = vectors[i, j, 1]
    mean = wp.int32(128)
    for k in range(256):
        mean += now[16 * i + k // 16, 16 * j + k % 16]
    mean = mean >> 8
    spread = wp.int32(INTRA_COST)
    for k in range(256):
        spread += wp.abs(now[16 * i + k // 16, 16 * j + k % 16] - mean)
    level = wp.int32(-1)
    colour = wp.int32(-1)
    total = wp.int32(0)
    if spread < costs[i, j]:
        level = mean
        colour = wp.int32(128)
        total = wp.int32(12)
    elif j > 0:
        total = signed_bits(dy - vectors[i, j - 1, 0]) + signed_bits(dx - vectors[i, j - 1, 1])
    else:
        total = signed_bits(dy) + signed_bits(dx)
    # One bit where all is only moved; for groups of 8 x 8 px with levels, the bits of all their blocks.
    levels = wp.int32(0)
    for group in range(4):
        length = wp.int32(0)
        for k in range(4):
            row = 16 * i + 8 * (group // 2) + 4 * (k // 2)
            column = 16 * j + 8 * (group % 2) + 4 * (k % 2)
            length += code_moved(q, now, before, row, column, dy, dx, LUMA, level, luma, coded)
        levels += wp.where(length > 4, length, 0)
    for group in range(2):
        length = wp.int32(0)
        for k in range(4):
            row = 8 * i + 4 * (k // 2)
            column = 8 * j + 4 * (k % 2)
            if group == 0:
                length += code_moved(chroma, now_b, before_b, row, column, dy, dx, CHROMA, colour, blue, coded_b)
            else:
                length += code_moved(chroma, now_r, before_r, row, column, dy, dx, CHROMA, colour, red, coded_r)
        levels += wp.where(length > 4, length, 0)
    total += wp.where(levels > 0, levels + 6, 1)
    bits[i, j] = total


@wp.func
def expected(decoded: wp.array2d(dtype=wp.int32), i: int, j: int, k: int, mode: int, mean: int):
    """Prediction of pixel k of a block: a mean, or the decoded pixel above the block, or the one to its left."""
    value = mean
    if mode == 1:
        value = decoded[wp.max(i - 1, 0), j + k % 4]
    elif mode == 2:
        value = decoded[i + k // 4, wp.max(j - 1, 0)]
    return value


@wp.kernel
def code_intra(
    q: Quantiser,
    now: wp.array2d(dtype=wp.int32),
    decoded: wp.array2d(dtype=wp.int32),
    coded: wp.array2d(dtype=wp.int32),
    bits: wp.array(dtype=wp.int32),
):
    """Code a plane, block by block, as differences from decoded neighbours: one thread per plane."""
    total = wp.int32(0)
    for block in range(coded.shape[0] * coded.shape[1]):
        i = 4 * (block // coded.shape[1])
        j = 4 * (block % coded.shape[1])
        mean = wp.int32(0)
        count = wp.int32(0)
        for k in range(4):
            if i > 0:
                mean += decoded[i - 1, j + k]
                count += 1
            if j > 0:
                mean += decoded[i + k, j - 1]
                count += 1
        mean = wp.where(count > 0, (mean + count // 2) // wp.max(count, 1), 128)
        mode = wp.int32(0)
        least = wp.int32(1 << 30)
        for candidate in range(3):
            if (candidate != 1 or i > 0) and (candidate != 2 or j > 0):
                cost = 4 * candidate
                for k in range(16):
                    cost += wp.abs(now[i + k // 4, j + k % 4] - expected(decoded, i, j, k, candidate, mean))
                if cost < least:
                    least = cost
                    mode = candidate
        residual = mat44i()
        guess = mat44i()
        for k in range(16):
            value = expected(decoded, i, j, k, mode, mean)
            guess[k // 4, k % 4] = value
            residual[k // 4, k % 4] = now[i + k // 4, j + k % 4] - value
        found, length = code_block(q, residual)
        for k in range(16):
            decoded[i + k // 4, j + k % 4] = wp.clamp(guess[k // 4, k % 4] + found[k // 4, k % 4], 0, 255)
        coded[i // 4, j // 4] = wp.where(length > 1, 1, 0)
        total += length + bits_of(mode)
    bits[0] = total
