"""Several runs of a method on a sequence, counted as one."""

from __future__ import annotations

import math
from collections.abc import Sequence


def times_of(runs: Sequence[int] | None, sequences: int) -> tuple[int, ...]:
    """How many times what is joined of all runs on each sequence counts, (C,), so that each sequence counts as often as
    any other. runs: (C,) numbers of runs, None for one; of equal numbers, each counts once.

    >>> times_of([3, 2], 2), times_of([3, 3], 2), times_of(None, 2)
    ((2, 3), (1, 1), (1, 1))
    """
    runs = runs or (1,) * sequences
    common = math.lcm(*runs)
    return tuple(common // count for count in runs)


def sum_as_of_one_run(totals: Sequence[float], runs: Sequence[int] | None) -> float:
    """Sum over sequences of totals (C,) over all runs on each, as of one run. runs: (C,) numbers of runs, None for one.

    A run that the machine lost has no result, so that sequences may differ in their number.

    >>> sum_as_of_one_run([30.0, 20.0], [3, 2])
    20.0
    """
    # By the least common multiple, since totals are whole numbers: of equal numbers of runs, the sum is divided once.
    common = math.lcm(*(runs or ()))
    times = times_of(runs, len(totals))
    return sum(total * count for total, count in zip(totals, times, strict=True)) / common


def span_of_runs(runs: Sequence[int]) -> str:
    """Numbers of runs in words.

    >>> span_of_runs([3, 3]), span_of_runs([3, 2])
    ('3 runs', '2 to 3 runs')
    """
    least, most = min(runs), max(runs)
    return f"{most} runs" if least == most else f"{least} to {most} runs"
