"""Confidence intervals of counts and densities: counting, clumping, doubtful oysters and area combined."""

from __future__ import annotations

import math

import numpy as np
from scipy.special import gammaincinv

from oysterbench.core.geometry import Array

LEVEL = 0.95


def count_interval(count: float, variance: float) -> tuple[float, float]:
    """Ends of the 95 % confidence interval of the mean behind a `count` with a given variance.

    If the variance equals the count, this is the exact interval of a Poisson count (Garwood 1936); if it is D times the
    count, D times the interval of count / D (McCullagh & Nelder 1989, sec. 6.2). For a count of 0, the upper end is
    that of the exact interval.
    """
    times = variance / count if count > 0 and variance > 0 else 1.0
    tail = (1.0 - LEVEL) / 2.0
    whole = count / times
    low = times * float(gammaincinv(whole, tail)) if count > 0 else 0.0
    return low, times * float(gammaincinv(whole + 1.0, 1.0 - tail))


def clumping(counts: Array, areas_m2: Array) -> float:
    """1 / k of the negative binomial with means (sum of counts / sum of areas) * area, by moments; 0 for no clumping.

    For cells (N,) of different areas: the excess of the squared deviations over Poisson's (Bliss & Fisher 1953).
    NaN with fewer than three cells or without oysters.
    """
    if len(counts) < 3 or counts.sum() <= 0:
        return math.nan
    means = counts.sum() / areas_m2.sum() * areas_m2
    # The mean takes one degree of freedom.
    excess = ((counts - means) ** 2).sum() * len(counts) / (len(counts) - 1) - means.sum()
    return max(0.0, float(excess / (means**2).sum()))


def doubt_variance(cut: Array, doubt: Array, score: Array) -> Array:
    """Variance (N,) that each oyster (N,) contributes to a count: 1/4 if it is cut in every image, d (1 - d) for a
    probability d of being part of another one, s (1 - s) for a probability s of being an oyster at all."""
    d, s = np.clip(doubt, 0.0, 0.5), np.clip(score, 0.0, 1.0)
    return 0.25 * cut + d * (1.0 - d) + s * (1.0 - s)
