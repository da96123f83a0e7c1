"""Minimum, maximum and clamp of numbers that are never NaN; Warp's own functions check for NaN, which is slower."""

from __future__ import annotations

import warp as wp


@wp.func
def lesser(a: float, b: float):
    """Lesser of two numbers."""
    return wp.where(a < b, a, b)


@wp.func
def greater(a: float, b: float):
    """Greater of two numbers."""
    return wp.where(a > b, a, b)


@wp.func
def clamped(x: float, low: float, high: float):
    """Clamp a number to the range from `low` to `high`."""
    return lesser(greater(x, low), high)
