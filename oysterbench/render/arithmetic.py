"""Least, greatest and clamped of numbers that are never NaN: Warp's own look for NaN, which takes longer."""

from __future__ import annotations

import warp as wp


@wp.func
def lesser(a: float, b: float):
    """The lesser of two."""
    return wp.where(a < b, a, b)


@wp.func
def greater(a: float, b: float):
    """The greater of two."""
    return wp.where(a > b, a, b)


@wp.func
def clamped(x: float, low: float, high: float):
    """A number where it lies from `low` to `high`, else the nearer of these."""
    return lesser(greater(x, low), high)
