"""Variety of shells: the spread of proportions and colours across reefs, ages and fouling.

Shells are round on hard ground and slender in mud and in clumps (Galtsoff 1964, ch. 2); their outsides are white, grey,
yellow, green, purple and near black.
"""

from __future__ import annotations

import numpy as np

from oysterbench.core.geometry import Array

PROPORTIONS = 0.16  # standard deviation of ln(length) and of ln(width), for a spread of 1
TINTED = 0.65  # share of the shells that have a tint, for a spread of 1
TINTS = (
    (0.62, 0.60, 0.54),  # chalky, bleached
    (0.44, 0.43, 0.38),  # pale grey
    (0.36, 0.33, 0.18),  # a yellow film
    (0.19, 0.21, 0.11),  # green algae
    (0.25, 0.22, 0.27),  # purple
    (0.07, 0.065, 0.06),  # black, from under mud
    (0.24, 0.19, 0.12),  # rust
)
"""Tints of shells, linear albedo."""


def vary_proportions(scales: Array, spread: float, generator: np.random.Generator) -> Array:
    """Return scales (N, 3) of shells with lengths and widths varied in proportion to `spread`."""
    factors = np.exp(PROPORTIONS * spread * generator.standard_normal((len(scales), 2)))
    return np.asarray(scales * np.column_stack([np.ones(len(scales)), np.clip(factors, 0.6, 1.6)]))


def vary_colours(colours: Array, spread: float, generator: np.random.Generator) -> Array:
    """Return colours (N, 3), linear albedo, some of them tinted to different degrees; `spread` scales how many."""
    n = len(colours)
    tints = np.array(TINTS)[generator.integers(0, len(TINTS), n)] * np.exp(0.15 * generator.standard_normal((n, 1)))
    share = generator.beta(2.5, 1.5, n) * (generator.random(n) < TINTED * spread)
    return np.asarray(colours + (tints - colours) * share[:, None])
