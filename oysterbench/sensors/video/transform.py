"""The integer transform of H.264 (8.5 of ITU-T H.264) on 4 x 4 blocks, its quantisation, and the bits of its levels."""

from __future__ import annotations

import warp as wp

from oysterbench.render.target import KERNEL_OPTIONS

# With more unrolling, the video kernels take 37 s to compile instead of 10, and are no faster.
VIDEO_OPTIONS = {**KERNEL_OPTIONS, "max_unroll": 3}
wp.set_module_options(VIDEO_OPTIONS)

mat44i = wp.types.matrix(shape=(4, 4), dtype=wp.int32)
FORWARD = wp.constant(mat44i(1, 1, 1, 1, 2, 1, -1, -2, 1, -1, -1, 1, 1, -2, 2, -1))


@wp.struct
class Quantiser:
    """Quantiser parameter and its tables: scale (6, 3) of levels and step (6, 3) of coefficients, by qp mod 6 and
    `kind_of_place`; zigzag (16,). intra: 1 to round levels with an offset of a third of a step, 0 with a sixth."""

    qp: wp.int32
    intra: wp.int32
    scale: wp.array2d(dtype=wp.int32)
    step: wp.array2d(dtype=wp.int32)
    zigzag: wp.array(dtype=wp.int32)


@wp.func
def bits_of(value: int):
    """Length of the Exp-Golomb code of a non-negative number, bits."""
    n = value + 1
    length = wp.int32(1)
    while n > 1:
        n = n >> 1
        length += 2
    return length


@wp.func
def signed_bits(value: int):
    """Length of the Exp-Golomb code of a signed number, bits."""
    return wp.where(value > 0, bits_of(2 * value - 1), bits_of(-2 * value))


@wp.func
def kind_of_place(i: int, j: int):
    """Class of a coefficient by the norm of its basis function: 0 if both indices are even, 1 if both are odd, else
    2."""
    return wp.where((i & 1) == 0 and (j & 1) == 0, 0, wp.where((i & 1) == 1 and (j & 1) == 1, 1, 2))


@wp.func
def code_block(q: Quantiser, residual: mat44i):
    """Code a residual block; return it as decoded, and the bits of its zero runs and levels in Exp-Golomb codes."""
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
    """Inverse transform, rounded to pixel values."""
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
