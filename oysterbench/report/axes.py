"""Axis of a plot: the positions of values, and the ticks."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from oysterbench.core.geometry import Array


@dataclass(frozen=True)
class Axis:
    """A range of values and the pixels that it is drawn on (begin > end for an upward axis); spacing: between ticks,
    px."""

    low: float
    high: float
    begin: float
    end: float
    spacing: float = 75.0
    logarithmic: bool = False
    named: tuple[tuple[float, str], ...] = ()  # ticks to use instead of those by spacing

    def place(self, values: Array | float) -> Array:
        """Convert values to pixels."""
        low, high, values = self.low, self.high, np.asarray(values, dtype=float)
        if self.logarithmic:
            low, high, values = math.log10(low), math.log10(high), np.log10(np.maximum(values, self.low))
        return self.begin + (values - low) / (high - low) * (self.end - self.begin)

    def ticks(self) -> list[tuple[float, str]]:
        """Values and labels of the ticks, as many as fit."""
        room = abs(self.end - self.begin)
        if self.named:
            return list(self.named)
        if self.logarithmic:
            powers = range(math.ceil(math.log10(self.low) - 1e-9), math.floor(math.log10(self.high) + 1e-9) + 1)
            return [(10.0**power, _number(10.0**power, max(0, -power))) for power in powers]
        return nice_ticks(self.low, self.high, max(3, round(room / self.spacing)))


def nice_ticks(low: float, high: float, count: int) -> list[tuple[float, str]]:
    """Round values within [low, high] and their labels: the finest steps of 1, 2 or 5 that give count + 2 at most."""
    exponent = math.floor(math.log10((high - low) / (count + 2)))
    for power, factor in ((exponent + k, factor) for k in (0, 1) for factor in (1, 2, 5)):
        step = factor * 10.0**power
        first, last = math.ceil(low / step - 1e-9), math.floor(high / step + 1e-9)
        if last - first + 1 <= count + 2:
            break
    return [(k * step, _number(k * step, max(0, -power))) for k in range(first, last + 1)]


def _number(value: float, decimals: int) -> str:
    return f"{value + 0.0:.{decimals}f}".replace("-", "\N{MINUS SIGN}")
