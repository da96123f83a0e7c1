"""Several runs of a method on a sequence, counted as one."""

from __future__ import annotations

import math
from collections.abc import Sequence


def sum_as_of_one_run(totals: Sequence[float], runs: Sequence[int] | None) -> float:
    """Sum over sequences of totals (C,) over all runs on each, as of one run. runs: (C,) numbers of runs, None for one.

    A run that the machine lost has no result, so that sequences may differ in their number.

    >>> sum_as_of_one_run([30.0, 20.0], [3, 2])
    20.0
    """
    runs = runs or (1,) * len(totals)
    # By the least common multiple, since totals are whole numbers: of equal numbers of runs, the sum is divided once.
    common = math.lcm(*runs)
    return sum(total * (common // count) for total, count in zip(totals, runs, strict=True)) / common


def span_of_runs(runs: Sequence[int]) -> str:
    """Numbers of runs in words.

    >>> span_of_runs([3, 3]), span_of_runs([3, 2])
    ('3 runs', '2 to 3 runs')
    """
    least, most = min(runs), max(runs)
    return f"{most} runs" if least == most else f"{least} to {most} runs"
