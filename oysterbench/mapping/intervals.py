"""Intervals of counts and densities: counting, clumping, doubt and area together."""

from __future__ import annotations

import math

import numpy as np
from scipy.special import gammaincinv

from oysterbench.core.geometry import Array

LEVEL = 0.95


def count_interval(count: float, variance: float, level: float = LEVEL) -> tuple[float, float]:
    """Ends of the interval of a mean of which `count` was counted, with that variance.

    The exact interval of a Poisson count (Garwood 1936) where the variance is the count; of a count D times as
    scattered, D times that of count / D (McCullagh & Nelder 1989, sec. 6.2). Of 0 the upper end is that of the exact
    interval.
    """
    times = variance / count if count > 0 and variance > 0 else 1.0
    tail = (1.0 - level) / 2.0
    whole = count / times
    low = times * float(gammaincinv(whole, tail)) if count > 0 else 0.0
    return low, times * float(gammaincinv(whole + 1.0, 1.0 - tail))


def clumping(counts: Array, areas_m2: Array) -> float:
    """1 / k of the negative binomial with means (sum of counts / sum of areas) * area, by moments; 0 for no clumping.

    Of cells (N,) with different areas: the excess of the squared deviations over Poisson's (Bliss & Fisher 1953).
    NaN with fewer than three cells.
    """
    if len(counts) < 3 or counts.sum() <= 0:
        return math.nan
    means = counts.sum() / areas_m2.sum() * areas_m2
    # One degree of freedom went into the mean.
    excess = ((counts - means) ** 2).sum() * len(counts) / (len(counts) - 1) - means.sum()
    return max(0.0, float(excess / (means**2).sum()))


def doubt_variance(cut: Array, doubt: Array, score: Array) -> Array:
    """(N,) variance that each oyster (N,) brings into a count: of one that is always cut 1/4, of one that may be the
    part of another d (1 - d), of one that may be none s (1 - s)."""
    d, s = np.clip(doubt, 0.0, 0.5), np.clip(score, 0.0, 1.0)
    return 0.25 * cut + d * (1.0 - d) + s * (1.0 - s)
