"""What adds to the variance of a count of oysters: clumping, and doubtful oysters."""

from __future__ import annotations

import math

import numpy as np

from oysterbench.core.geometry import Array


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
