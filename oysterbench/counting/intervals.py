"""Means over many images: ratios of sums with confidence intervals, by resampling blocks of neighbours.

Images are a sample of the bottom. What neighbours have in common is no further evidence: frames of a video follow each
other over the same ground, so blocks of time are resampled, each as a whole (Carlstein 1986), with the mean of the
blocks weighted by their denominators (`evaluate.statistics.bootstrap_interval`). Blocks that are all equal, as where no
oyster is found, have no scatter to resample: the interval is then the exact one of a count or a share
(`evaluate.exact`), which the interval of a few oysters covers, too. An interval covers the scatter of sampling, but not
the method's own over- or undercounting.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from oysterbench.core.geometry import Array
from oysterbench.counting.measure import PictureCount
from oysterbench.evaluate.exact import count_interval, share_interval
from oysterbench.evaluate.statistics import LEAST_SEQUENCES, LEVEL, Interval, bootstrap_interval, mean_of, too_few


@dataclass(frozen=True)
class Exact:
    """The exact interval of a ratio. ends: its ends, from the sums above and below; rarer: from the same, the number of
    things that the ratio rests on."""

    ends: Callable[[float, float], tuple[float, float]]
    rarer: Callable[[float, float], float]


FEW = 10
"""Number of things below which blocks with and without them cannot tell the scatter: one oyster in 60 images would have
a lower upper end than none, and intervals of some four miss the mean in one case of eight instead of one of twenty."""

ROUNDING = 1e-9
"""Relative difference up to which values of blocks are equal: sums of areas are rounded, by how many there are."""

BLOCK_S = 10.0
"""Length of a block of a video, s: at the 0.1 to 0.3 m/s of a survey, a camera then sees other ground."""

LEAST_FOR_LIKENESS = 12
"""Minimum number of blocks to test whether neighbours are correlated."""
ALIKE = 0.4
"""Minimum correlation of neighbouring blocks to be reported, if it is also at least 2 / sqrt(n), twice what chance
gives."""


@dataclass(frozen=True)
class Ratio:
    """Ratio of two sums over images; NaN if there is nothing to divide by. blocks: number of blocks resampled."""

    value: float
    interval: Interval
    blocks: int


def block_labels(pictures: Sequence[PictureCount], neighbours: int | None = None) -> NDArray[np.intp]:
    """Block number (n,) of each image; images are in the order of their names.

    neighbours: how many images of a folder, or frames of a video, form a block; by default, each image does, and the
    frames of a video within the same `BLOCK_S`.
    """
    keys = []
    counted: dict[str, int] = {}
    for one in pictures:
        place = one.name.rpartition("/")[0]
        counted[place] = counted.get(place, -1) + 1
        if neighbours is None and one.video:
            keys.append((place, int((one.time_s or 0.0) // BLOCK_S)))
        else:
            keys.append((place, counted[place] // (neighbours or 1)))
    known = {key: k for k, key in enumerate(dict.fromkeys(keys))}
    return np.array([known[key] for key in keys], dtype=np.intp)


def _of_counts(count: float, size: float) -> tuple[float, float]:
    low, high = count_interval(count, count)
    return low / size, high / size


def _of_percent(part: float, whole: float) -> tuple[float, float]:
    low, high = share_interval(part / 100.0, whole)
    return 100.0 * low, 100.0 * high


OF_COUNTS = Exact(_of_counts, lambda count, size: count)
"""Of a count per unit of the sum below: images, or square metres."""
OF_PERCENT = Exact(_of_percent, lambda part, whole: min(part / 100.0, whole - part / 100.0))
"""Of a share, in %, of things that are counted; the sum above is 100 times their number."""


def ratio(
    above: Sequence[float],
    below: Sequence[float],
    labels: NDArray[np.intp],
    noun: str = "block",
    exact: Exact | None = None,
) -> Ratio:
    """Sum of `above` over that of `below`, each (n,), for images of the blocks `labels` (n,).

    exact: for blocks that all have the same value, which without it have no interval, and for few things, where the
    interval also covers the exact one. The images of a block show the same ground, so what they show counts once.
    """
    sums, weights = _by_block(above, labels), _by_block(below, labels)
    held = weights > 0
    values, weights = sums[held] / weights[held], weights[held]
    n = len(values)
    if n == 0:
        return Ratio(math.nan, Interval(math.nan, math.nan, "there is nothing to count"), 0)
    if n < LEAST_SEQUENCES:
        return Ratio(mean_of(values, weights), Interval(math.nan, math.nan, too_few(n, noun)), n)
    scattered = not np.allclose(values, values[0], rtol=ROUNDING, atol=0.0)
    per_block = np.count_nonzero(np.asarray(below) > 0) / n
    totals = float(sums[held].sum() / per_block), float(weights.sum() / per_block)
    if scattered:
        interval = bootstrap_interval(values, weights)
        if exact is not None and exact.rarer(*totals) < FEW:
            low, high = exact.ends(*totals)
            interval = Interval(min(low, interval.low), max(high, interval.high))
    elif exact is None:
        reason = f"where all {n} {noun}s have the same value, resampling gives no {LEVEL:.0%} interval"
        interval = Interval(math.nan, math.nan, reason)
    else:
        interval = Interval(*exact.ends(*totals))
    return Ratio(mean_of(values, weights), interval, n)


def ratio_of(
    pictures: Sequence[PictureCount],
    labels: NDArray[np.intp],
    above: Callable[[PictureCount], float | None],
    below: Callable[[PictureCount], float] = lambda one: 1.0,
    noun: str = "block",
    exact: Exact | None = None,
) -> Ratio:
    """As `ratio`, of values computed for each image; images for which `above` is None are left out."""
    known = [
        (value, below(one), k) for one, k in zip(pictures, labels, strict=True) if (value := above(one)) is not None
    ]
    sums, weights, own = zip(*known, strict=True) if known else ((), (), ())
    return ratio(sums, weights, np.array(own, dtype=np.intp), noun, exact)


def likeness(values: Sequence[float], labels: NDArray[np.intp]) -> float:
    """Correlation of the means of neighbouring blocks; NaN if there are too few, or it may be due to chance."""
    sizes = np.bincount(labels) if len(labels) else np.zeros(0)
    means = _by_block(values, labels) / np.maximum(sizes, 1)
    n = len(means)
    if n < LEAST_FOR_LIKENESS or means[:-1].std() == 0 or means[1:].std() == 0:
        return math.nan
    found = float(np.corrcoef(means[:-1], means[1:])[0, 1])
    return found if found >= max(ALIKE, 2 / math.sqrt(n)) else math.nan


def _by_block(values: Sequence[float], labels: NDArray[np.intp]) -> Array:
    return np.bincount(labels, np.asarray(values, dtype=float)).astype(float) if len(labels) else np.zeros(0)
