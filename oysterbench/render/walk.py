"""Traversal of trees of boxes (tree.py) by rays: the nearest child of a node, the triangle hit in a leaf."""

from __future__ import annotations

import warp as wp

from oysterbench.render.arithmetic import greater, lesser
from oysterbench.render.tree import Library

MISSED = wp.constant(3.0e38)  # stands for the depth of a box that a ray does not meet
NO_FACE = wp.constant(-1)
STEEPEST = wp.constant(1.0e-12)  # replaces smaller components of a ray's direction
ROUNDING = wp.constant(1.0000005)  # factor on depths, so that no box is missed through rounding (Ize 2013)

Waiting = wp.types.vector(length=40, dtype=wp.int32)  # stack of nodes and leaves: three per level
Depths = wp.types.vector(length=40, dtype=wp.float32)


@wp.struct
class Struck:
    """Nearest triangle: its depth, its index in its mesh or NO_FACE, and the weights of its first two corners."""

    t: wp.float32
    face: wp.int32
    u: wp.float32
    v: wp.float32


@wp.func
def inverse(direction: wp.vec3):
    """Reciprocal of each component of a direction."""
    x = wp.where(wp.abs(direction[0]) < STEEPEST, STEEPEST, direction[0])
    y = wp.where(wp.abs(direction[1]) < STEEPEST, STEEPEST, direction[1])
    z = wp.where(wp.abs(direction[2]) < STEEPEST, STEEPEST, direction[2])
    return wp.vec3(1.0 / x, 1.0 / y, 1.0 / z)


@wp.func
def greater_of_each(a: wp.vec4, b: wp.vec4):
    """Element-wise maximum."""
    return wp.vec4(greater(a[0], b[0]), greater(a[1], b[1]), greater(a[2], b[2]), greater(a[3], b[3]))


@wp.func
def lesser_of_each(a: wp.vec4, b: wp.vec4):
    """Element-wise minimum."""
    return wp.vec4(lesser(a[0], b[0]), lesser(a[1], b[1]), lesser(a[2], b[2]), lesser(a[3], b[3]))


BOX_DEPTHS = """
    const float* plane = planes.data[6 * node].c;
    const int x = inverse.c[0] < 0.0f ? 4 : 0;  // of the near side: the low one, or, after it, the high one
    const int y = inverse.c[1] < 0.0f ? 4 : 0;
    const int z = inverse.c[2] < 0.0f ? 4 : 0;
    wp::vec4 depths;
    for (int k = 0; k < 4; ++k) {
        const float enter_x = (plane[x + k] - start.c[0]) * inverse.c[0];
        const float enter_y = (plane[8 + y + k] - start.c[1]) * inverse.c[1];
        const float enter_z = (plane[16 + z + k] - start.c[2]) * inverse.c[2];
        const float leave_x = (plane[4 - x + k] - start.c[0]) * inverse.c[0];
        const float leave_y = (plane[12 - y + k] - start.c[1]) * inverse.c[1];
        const float leave_z = (plane[20 - z + k] - start.c[2]) * inverse.c[2] * rounding;
        const float enter_across = enter_x > enter_y ? enter_x : enter_y;
        const float enter_down = enter_z > 0.0f ? enter_z : 0.0f;
        const float leave_across = leave_x < leave_y ? leave_x : leave_y;
        const float leave_down = leave_z < max_t ? leave_z : max_t;
        const float enter = enter_across > enter_down ? enter_across : enter_down;
        const float leave = leave_across < leave_down ? leave_across : leave_down;
        depths.c[k] = enter <= leave ? enter : missed;
    }
    return depths;
"""
"""In C++, as the compiler turns this loop into instructions on four numbers, but Warp's vectors into ones on two."""


@wp.func_native(f"const float missed = {MISSED}f, rounding = {ROUNDING}f;{BOX_DEPTHS}")
def box_depths(planes: wp.array(dtype=wp.vec4), node: int, start: wp.vec3, inverse: wp.vec3, max_t: float) -> wp.vec4:
    """Depth at which a ray enters each of the four boxes of a node; MISSED if it does not before max_t."""
    ...


@wp.func
def strike(library: Library, leaf: int, start: wp.vec3, direction: wp.vec3, nearest: Struck):
    """Nearest of a known hit and the four triangles of a leaf on a ray.

    The ray is sheared onto its longest axis; edge functions have signs that agree for both triangles at an edge.
    """
    size = wp.vec3(wp.abs(direction[0]), wp.abs(direction[1]), wp.abs(direction[2]))
    z = wp.where(size[0] > size[1], wp.where(size[0] > size[2], 0, 2), wp.where(size[1] > size[2], 1, 2))
    x = wp.where(z == 2, 0, z + 1)
    y = wp.where(x == 2, 0, x + 1)
    scale = 1.0 / direction[z]
    shear_x = direction[x] * scale
    shear_y = direction[y] * scale
    first = 9 * leaf
    start_x = wp.vec4(start[x])
    start_y = wp.vec4(start[y])
    start_z = wp.vec4(start[z])
    a_z = library.triangles[first + z] - start_z
    b_z = library.triangles[first + 3 + z] - start_z
    c_z = library.triangles[first + 6 + z] - start_z
    a_x = (library.triangles[first + x] - start_x) - a_z * shear_x
    b_x = (library.triangles[first + 3 + x] - start_x) - b_z * shear_x
    c_x = (library.triangles[first + 6 + x] - start_x) - c_z * shear_x
    a_y = (library.triangles[first + y] - start_y) - a_z * shear_y
    b_y = (library.triangles[first + 3 + y] - start_y) - b_z * shear_y
    c_y = (library.triangles[first + 6 + y] - start_y) - c_z * shear_y
    u = wp.cw_mul(c_x, b_y) - wp.cw_mul(c_y, b_x)
    v = wp.cw_mul(a_x, c_y) - wp.cw_mul(a_y, c_x)
    w = wp.cw_mul(b_x, a_y) - wp.cw_mul(b_y, a_x)
    least = lesser_of_each(lesser_of_each(u, v), w)
    most = greater_of_each(greater_of_each(u, v), w)
    found = nearest
    for k in range(4):
        if least[k] >= 0.0 or most[k] <= 0.0:
            total = u[k] + v[k] + w[k]
            if total != 0.0:
                weight = 1.0 / total
                t = (u[k] * a_z[k] + v[k] * b_z[k] + w[k] * c_z[k]) * scale * weight
                if t >= 0.0 and t < found.t:
                    found.t = t
                    found.face = 4 * leaf + k
                    found.u = u[k] * weight
                    found.v = v[k] * weight
    return found


@wp.func
def strike_mesh(library: Library, root: int, start: wp.vec3, direction: wp.vec3, max_t: float, any: int):
    """Nearest triangle of a mesh on a ray before max_t; with `any`, the first one found."""
    found = Struck()
    found.t = max_t
    found.face = NO_FACE
    back = inverse(direction)
    waiting = Waiting()
    depths = Depths()
    count = wp.int32(0)
    item = wp.int32(root)
    going = wp.bool(True)
    while going:
        nearest = wp.float32(MISSED)
        if item < 0:
            found = strike(library, -1 - item, start, direction, found)
            if any != 0 and found.face != NO_FACE:
                count = wp.int32(0)
        else:
            t = box_depths(library.planes, item, start, back, found.t)
            children = library.children[item]
            for k in range(4):
                if t[k] < MISSED:
                    if t[k] < nearest:
                        if nearest < MISSED:
                            waiting[count] = item
                            depths[count] = nearest
                            count += 1
                        nearest = t[k]
                        item = children[k]
                    else:
                        waiting[count] = children[k]
                        depths[count] = t[k]
                        count += 1
        going = nearest < MISSED
        while count > 0 and not going:
            count -= 1
            if depths[count] < found.t:
                item = waiting[count]
                going = wp.bool(True)
    if found.face != NO_FACE:
        found.face = library.faces[found.face]
    return found
