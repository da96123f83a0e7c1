"""Kernel distance between two sets of images, from their features, with its confidence interval.

KID (Binkowski et al. 2018, ICLR): the squared maximum mean discrepancy (Gretton et al. 2012) with a polynomial kernel,
unbiased: 0 on average for two samples from one source, and sometimes below. Unlike FID it can be estimated from a few
tens of images.
"""

from __future__ import annotations

import numpy as np
import scipy.special

from oysterbench.core.geometry import Array
from oysterbench.core.streams import stream
from oysterbench.evaluate.statistics import LEVEL, Interval

HALVES = 400
"""Number of random halves of the images that are drawn for an interval."""
LEAST_BLOCKS = 4
"""Minimum number of blocks of which halves can be drawn."""


def kernel(a: Array, b: Array) -> Array:
    """Kernel matrix (N, M) of features (N, d) and (M, d): (a.b / d + 1)^3, as in KID."""
    return np.asarray((a @ b.T / a.shape[1] + 1.0) ** 3)


def kid(a: Array, b: Array) -> float:
    """KID between features (N, d) and (M, d), of at least two images each."""
    weights = np.ones(len(a)), np.ones(len(b))
    return float(_discrepancy(kernel(a, a), kernel(b, b), kernel(a, b), *(w[None] for w in weights))[0])


def kid_between(a: Array, b: Array, blocks_a: Array, blocks_b: Array) -> tuple[float, Interval]:
    """KID with its 95 % confidence interval. blocks (N,), (M,): block numbers of the images; those of a block are drawn
    together, as neighbouring images of a video are nearly the same.

    Halves of the blocks are drawn without replacement, as copies would be nearer to each other than any two images; an
    estimate from half of the sample scatters about that from all of it as the latter does about the true value
    (delete-half jackknife, Shao & Wu 1989). As that scatter is known from few blocks, the quantile is that of Student's
    t, with a degree of freedom less than the smaller set has blocks.
    """
    own, other, both = kernel(a, a), kernel(b, b), kernel(a, b)
    value = float(_discrepancy(own, other, both, np.ones((1, len(a))), np.ones((1, len(b))))[0])
    fewest = min(len(np.unique(blocks_a)), len(np.unique(blocks_b)))
    if fewest < LEAST_BLOCKS:
        return value, Interval(np.nan, np.nan, f"{fewest} blocks of images are too few, {LEAST_BLOCKS} are needed")
    rng = stream(0, b"", "realism", "halves")
    halves = _discrepancy(own, other, both, _halves(blocks_a, rng), _halves(blocks_b, rng))
    quantile = float(scipy.special.stdtrit(fewest - 1, 0.5 + LEVEL / 2))
    reach = quantile * float(np.sqrt(np.mean((halves - value) ** 2)))
    return value, Interval(value - reach, value + reach, "")


def kid_within(a: Array, blocks: Array) -> float:
    """KID between the two halves of one set, its first blocks and its last: the value that two sets of one place would
    have. NaN where a half has fewer than two images."""
    numbers = np.unique(blocks)
    first = np.isin(blocks, numbers[: len(numbers) // 2])
    if min(first.sum(), (~first).sum()) < 2:
        return float("nan")
    return kid(a[first], a[~first])


def _halves(blocks: Array, rng: np.random.Generator) -> Array:
    """Draw weights (HALVES, N): 1 for the images of a random half of the blocks, 0 for the others.

    An estimate from k of n blocks has (n - k) / k of the variance that is wanted. Of an odd n, half rounded down is
    therefore drawn as often as makes the mean of these ratios 1, which is in half / n of all draws, and half rounded up
    in the others.
    """
    numbers, places = np.unique(blocks, return_inverse=True)
    count, half = len(numbers), len(numbers) // 2
    turns = np.arange(HALVES + 1) * half // count
    sizes = np.where((np.diff(turns) > 0) | (count % 2 == 0), half, half + 1)
    drawn = np.argsort(rng.random((HALVES, count)), axis=1) < sizes[:, None]
    return drawn[:, places].astype(float)


def _discrepancy(own: Array, other: Array, both: Array, a: Array, b: Array) -> Array:
    """Squared discrepancy (K,) from kernels (N, N), (M, M), (N, M), with weights (K, N) and (K, M) of 0 and 1."""

    def mean(matrix: Array, w: Array) -> Array:
        """Mean over pairs of different images."""
        sums = np.einsum("kn,nm,km->k", w, matrix, w, optimize=True) - w**2 @ np.diag(matrix)
        count = w.sum(axis=1)
        return np.asarray(sums / (count * (count - 1)))

    cross = np.einsum("kn,nm,km->k", a, both, b, optimize=True) / (a.sum(axis=1) * b.sum(axis=1))
    return np.asarray(mean(own, a) + mean(other, b) - 2 * cross)
