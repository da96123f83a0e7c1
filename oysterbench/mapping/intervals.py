"""What adds to the variance of a count of oysters: that they lie in clumps and patches, and doubtful oysters."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import scipy

from oysterbench.core.geometry import Array
from oysterbench.evaluate.exact import TAIL

UNIT_M = 0.5  # edge of the squares that blocks are made of, whatever the cells of a map are
LEAST_BLOCK_M = 2.0  # edge of the smallest blocks: smaller ones share clumps and patches with those beside them
MANY, ENOUGH = 8.0, 5.0  # blocks are as large as leaves the one, and the smallest must be the other: with fewer, an
# interval would be several times as wide as the scatter that it stands for


@dataclass(frozen=True)
class Sampling:
    """How much a count scatters between parts of a reef like the one seen. variance: of the count; block_m: edge of the
    blocks that show it. Both are NaN where too little was seen to tell."""

    variance: float
    block_m: float


def sampling(counts: Array, areas_m2: Array) -> Sampling:
    """Find the variance of a count from counts and seen areas (rows, columns) in squares of UNIT_M.

    Oysters that lie near one another are not independent, so the variance is that between blocks that hold whole
    patches: the squared deviation of each block's count from what the mean density gives for its area, averaged over
    all positions of the blocks (a Bartlett kernel: Conley 1999, J. Econometrics 92, eq. 3.13), but at least Poisson's.
    Blocks are as large as leaves MANY of them, since the size of patches is unknown; few blocks tell a variance
    inaccurately, so it is scaled to give a normal interval the width of Student's t.
    """
    total, area = counts.sum(), areas_m2.sum()
    found = Sampling(math.nan, math.nan)
    residuals = counts - total / area * areas_m2 if area > 0 else counts
    block_m = LEAST_BLOCK_M
    while area > 0:
        side = round(block_m / UNIT_M)
        blocks = float((side * area) ** 2 / (_blocks(areas_m2, side) ** 2).sum())
        if blocks < (ENOUGH if block_m == LEAST_BLOCK_M else MANY):
            break
        # The mean density takes one degree of freedom.
        squares = float((_blocks(residuals, side) ** 2).sum()) / side**2 * blocks / (blocks - 1.0)
        wider = scipy.special.stdtrit(blocks - 1.0, TAIL) / scipy.special.ndtri(TAIL)
        found = Sampling(max(float(total), squares) * float(wider) ** 2, block_m)
        block_m += max(1.0, block_m // 10.0)  # of a reef of 640 m, steps of 1 m would take half a minute
    return found


def _blocks(values: Array, side: int) -> Array:
    """Sums over all squares of `side` x `side` values that hold any of the values (rows, columns)."""
    sums = np.pad(np.pad(values, side).cumsum(axis=0).cumsum(axis=1), ((1, 0), (1, 0)))
    return np.asarray(sums[side:, side:] - sums[:-side, side:] - sums[side:, :-side] + sums[:-side, :-side])


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
