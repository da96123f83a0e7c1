"""Tables on the device: linear interpolation at fractional indices."""

from __future__ import annotations

import warp as wp

from oysterbench.render.arithmetic import clamped


@wp.func
def look_up(table: wp.array(dtype=wp.vec3), place: float):
    """Interpolate a table linearly at a fractional index, clamped."""
    last = table.shape[0] - 1
    inside = clamped(place, 0.0, float(last) - 0.001)
    i = int(inside)
    return table[i] + (table[i + 1] - table[i]) * (inside - float(i))


@wp.func
def look_up_pair(table: wp.array2d(dtype=wp.vec3), row: float, column: float):
    """Interpolate a table bilinearly at fractional indices, clamped; exact where all values are one."""
    y = clamped(row, 0.0, float(table.shape[0] - 1) - 0.001)
    x = clamped(column, 0.0, float(table.shape[1] - 1) - 0.001)
    i = int(y)
    j = int(x)
    u = x - float(j)
    low = table[i, j] + (table[i, j + 1] - table[i, j]) * u
    high = table[i + 1, j] + (table[i + 1, j + 1] - table[i + 1, j]) * u
    return low + (high - low) * (y - float(i))
