"""Exact confidence intervals of counts and shares, where the scatter of samples says too little or nothing."""

from __future__ import annotations

from scipy.special import betaincinv, gammaincinv

from oysterbench.evaluate.statistics import LEVEL

TAIL = (1.0 - LEVEL) / 2.0


def count_interval(count: float, variance: float) -> tuple[float, float]:
    """Ends of the confidence interval of the mean behind a `count` with a given variance, 0 of a certain one.

    If the variance equals the count, this is the exact interval of a Poisson count (Garwood 1936); if it is D times the
    count, D times the interval of count / D (McCullagh & Nelder 1989, sec. 6.2). For a count of 0, the upper end is
    that of the exact interval.

    >>> [round(end, 2) for end in count_interval(0, 0)], count_interval(12.0, 0.0)
    ([0.0, 3.69], (12.0, 12.0))
    """
    if count > 0 and variance == 0:
        return count, count
    times = variance / count if count > 0 else 1.0
    whole = count / times
    low = times * float(gammaincinv(whole, TAIL)) if count > 0 else 0.0
    return low, times * float(gammaincinv(whole + 1.0, 1.0 - TAIL))


def share_interval(part: float, whole: float) -> tuple[float, float]:
    """Ends of the exact confidence interval of the share behind `part` of `whole` (Clopper & Pearson 1934).

    >>> [round(end, 3) for end in share_interval(0, 20)]
    [0.0, 0.168]
    """
    low = float(betaincinv(part, whole - part + 1.0, TAIL)) if part > 0 else 0.0
    high = float(betaincinv(part + 1.0, whole - part, 1.0 - TAIL)) if part < whole else 1.0
    return low, high
