"""Kernels of the video codec: motion search, prediction, the integer transform of H.264, and its loop filter.

All arithmetic is in whole numbers, so that every processor makes the same bytes. Formulas and tables are those of
ITU-T H.264; a macroblock is 16 x 16 px of luma and 8 x 8 of each colour difference, all coded in blocks of 4 x 4.
"""

from __future__ import annotations

import warp as wp

from oysterbench.render.target import KERNEL_OPTIONS

wp.set_module_options(KERNEL_OPTIONS)

mat44i = wp.types.matrix(shape=(4, 4), dtype=wp.int32)
FORWARD = wp.constant(mat44i(1, 1, 1, 1, 2, 1, -1, -2, 1, -1, -1, 1, 1, -2, 2, -1))
REACH = wp.constant(8)  # of the search on pictures of a quarter of the size, px
VECTOR_COST = wp.constant(2)  # absolute differences that a half pixel of motion must save, at least
INTRA_COST = wp.constant(512)  # and that a macroblock without prediction must save
LUMA, CHROMA = wp.constant(2), wp.constant(4)  # steps of a motion vector, in half pixels of luma, in a pixel of a plane


@wp.struct
class Quantiser:
    """Step of quantisation and its tables: scale (6, 3) of levels and step (6, 3) of coefficients, by qp mod 6 and kind
    of place; zigzag (16,). intra: 1 where levels are rounded at a third of a step, 0 at a sixth."""

    qp: wp.int32
    intra: wp.int32
    scale: wp.array2d(dtype=wp.int32)
    step: wp.array2d(dtype=wp.int32)
    zigzag: wp.array(dtype=wp.int32)


@wp.func
def bits_of(value: int):
    """Length of the Exp-Golomb code of a number from 0."""
    n = value + 1
    length = wp.int32(1)
    while n > 1:
        n = n >> 1
        length += 2
    return length


@wp.func
def signed_bits(value: int):
    """Length of the Exp-Golomb code of a number with a sign."""
    return wp.where(value > 0, bits_of(2 * value - 1), bits_of(-2 * value))


@wp.func
def kind_of_place(i: int, j: int):
    """Norm of a coefficient's basis: 0 where both its indices are even, 1 where both are odd, else 2."""
    return wp.where((i & 1) == 0 and (j & 1) == 0, 0, wp.where((i & 1) == 1 and (j & 1) == 1, 1, 2))


@wp.func
def code_block(q: Quantiser, residual: mat44i):
    """A block as it is decoded again, and the bits of its levels: runs of zeros and levels in Exp-Golomb codes."""
    shift = 15 + q.qp // 6
    part = wp.where(q.intra == 1, 3, 6)
    rounding = (1 << shift) / part
    coefficients = FORWARD * residual * wp.transpose(FORWARD)
    decoded = mat44i()
    bits = wp.int32(0)
    run = wp.int32(0)
    for k in range(16):
        place = q.zigzag[k]
        i = place // 4
        j = place % 4
        kind = kind_of_place(i, j)
        value = coefficients[i, j]
        level = (wp.abs(value) * q.scale[q.qp % 6, kind] + rounding) >> shift
        if level > 0:
            level = wp.where(value < 0, -level, level)
            bits += bits_of(run) + signed_bits(level)
            run = wp.int32(0)
            decoded[i, j] = (level * q.step[q.qp % 6, kind]) << (q.qp // 6)
        else:
            run += 1
    if bits > 0:
        decoded = inverse(decoded)
    return decoded, bits + 1


@wp.func
def inverse(c: mat44i):
    """The inverse transform, rounded to pixels."""
    for i in range(4):
        a = c[i, 0] + c[i, 2]
        b = c[i, 0] - c[i, 2]
        d = (c[i, 1] >> 1) - c[i, 3]
        e = c[i, 1] + (c[i, 3] >> 1)
        c[i, 0] = a + e
        c[i, 1] = b + d
        c[i, 2] = b - d
        c[i, 3] = a - e
    for j in range(4):
        a = c[0, j] + c[2, j]
        b = c[0, j] - c[2, j]
        d = (c[1, j] >> 1) - c[3, j]
        e = c[1, j] + (c[3, j] >> 1)
        c[0, j] = (a + e + 32) >> 6
        c[1, j] = (b + d + 32) >> 6
        c[2, j] = (b - d + 32) >> 6
        c[3, j] = (a - e + 32) >> 6
    return c


@wp.func
def moved(plane: wp.array2d(dtype=wp.int32), row: int, column: int, dy: int, dx: int, unit: int):
    """A plane at a pixel moved by fractions 1 / unit of one, bilinear."""
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
    """Means of 4 x 4 px."""
    i, j = wp.tid()
    total = wp.int32(8)
    for k in range(16):
        total += plane[4 * i + k // 4, 4 * j + k % 4]
    small[i, j] = total >> 4


@wp.func
def difference(
    now: wp.array2d(dtype=wp.int32), before: wp.array2d(dtype=wp.int32), i: int, j: int, dy: int, dx: int, most: int
):
    """Absolute differences of a macroblock to the picture before, moved by half pixels; given up beyond `most`."""
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
    """Absolute differences of a macroblock on pictures of a quarter of the size, moved by whole pixels of them."""
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
    """Motion (row, column) of each macroblock in half pixels: of what lies within REACH on small pictures, what moves
    nowhere, and what moves as before (`known`), the best; and then nearby."""
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
        step = 4 >> radius  # two pixels, one, half of one
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
    """Code 4 x 4 px from (i, j) on, as what they differ from the picture before, or from a level; the bits of it."""
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
    """Code each macroblock as what it differs from the picture before, or from its own mean where that is nearer."""
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
    # A bit for what moves and is left as it is; of groups of 8 x 8 px that have levels the bits of all their blocks.
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
    """What is expected in place k of a block: a mean, or the decoded pixel above the block, or left of it."""
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
    """Code a plane, block after block, as what each differs from its decoded neighbours: one thread a plane."""
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
    """Smooth the step across an edge of 4 x 4 blocks where either was coded, and of macroblocks (`side` px): the filter
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
    """Luma and, of 2 x 2 px, colour differences (BT.601, full range); beyond the picture its last pixels go on."""
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
    """RGB again; colour differences are interpolated."""
    i, j = wp.tid()
    y = luma[i, j]
    # A pixel's centre lies a quarter of a colour pixel beside that one's.
    b = moved(blue, i // 2, j // 2, 2 * (i % 2) - 1, 2 * (j % 2) - 1, 4) - 128
    r = moved(red, i // 2, j // 2, 2 * (i % 2) - 1, 2 * (j % 2) - 1, 4) - 128
    picture[i, j, 0] = wp.uint8(wp.clamp(y + ((359 * r + 128) >> 8), 0, 255))
    picture[i, j, 1] = wp.uint8(wp.clamp(y - ((88 * b + 183 * r + 128) >> 8), 0, 255))
    picture[i, j, 2] = wp.uint8(wp.clamp(y + ((454 * b + 128) >> 8), 0, 255))
