"""Numbers as pages show them: columns of metrics, intervals, counts."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

from oysterbench.evaluate import statistics
from oysterbench.evaluate.metrics import TRACKS
from oysterbench.evaluate.statistics import Interval
from oysterbench.report.columns import metric_column
from oysterbench.report.table import Bar, Column

ARROWS = {"lower": "\N{DOWNWARDS ARROW}", "higher": "\N{UPWARDS ARROW}", "": ""}
LEAST_DRAWN = 4
"""Least number of intervals of a table that are drawn in full."""

LEVEL = f"{100 * statistics.LEVEL:.0f} %"


def track_name(track: str) -> str:
    """Title of a track for headings; for an unknown track, its own name capitalised."""
    return TRACKS[track].title if track in TRACKS else track.capitalize()


def text(key: str, value: float | None) -> str:
    """Format a value of a metric as pages show it."""
    return metric_column(key).text(finite(value))


def difference_column(key: str) -> Column:
    """Column of a metric's signed differences."""
    return replace(metric_column(key), key="difference", signed=True, cut=False, sort="")


def interval(low: float | None, high: float | None) -> Interval:
    """Interval from its two ends; unknown, with the reason, where one is None."""
    if low is None or high is None:
        return Interval(math.nan, math.nan, "too few sequences")
    return Interval(low, high)


def unit(of: Column) -> str:
    """Unit of a column, with an arrow towards better values."""
    return f"{of.unit} {ARROWS[of.better]}".strip()


def bar(
    low: float | None, middle: float | None, high: float | None, axis: tuple[float, float] = (0.0, 1.0), name: str = ""
) -> Bar | None:
    """Interval as a bar on an axis; None where it has no ends, or leaves the default axis from 0 to 1.

    name: the axis's ends as pages write them, for any other axis
    """
    if low is None or middle is None or high is None or not low <= high:
        return None
    begin, end = axis
    if not name and not (begin <= low and high <= end and begin <= middle <= end):
        return None
    low, middle, high = ((value - begin) / (end - begin) for value in (low, middle, high))
    zero = -begin / (end - begin) if begin < 0 < end else None
    return Bar(low, middle, high, zero, f"interval drawn from {name or '0 to 1'}")


def bars_axis(intervals: Sequence[tuple[float | None, float | None]]) -> tuple[float, float] | None:
    """Ends of the axis on which the intervals of a table, best first, are drawn: round values around those of the
    better half, which differ less from each other than from the rest. None where there are none.

    >>> bars_axis([(0.92, 0.96), (0.86, 0.95), (0.8, 0.9), (0.7, 0.9), (0.1, 0.5), (0.0, 0.0)])
    (0.65, 1.0)
    """
    known = [(low, high) for low, high in intervals if low is not None and high is not None]
    if not known:
        return None
    better = known[: max(LEAST_DRAWN, -(-len(known) // 2))]
    low, high = min(low for low, _ in better), max(high for _, high in better)
    step = 0.5 * 10.0 ** math.floor(math.log10(max(high - low, 0.02 * abs(high), 1e-6)))
    return round((math.ceil(low / step) - 1) * step, 9), round((math.floor(high / step) + 1) * step, 9)


def setting_text(value: Any) -> str:
    """Format a setting as pages show it."""
    return "none" if value in (None, [], ()) else ", ".join(map(str, value)) if isinstance(value, list) else str(value)


def finite(value: float | None) -> float | None:
    """Return the value, or None where it is not finite."""
    return None if value is None or not math.isfinite(value) else value


def count(number: int, noun: str) -> str:
    """Format a number of things, with the noun in singular or plural.

    >>> count(1, "record"), count(999, "record")
    ('1 record', '999 records')
    """
    written = f"{number:,}".replace(",", "\N{NARROW NO-BREAK SPACE}") if number >= 10_000 else str(number)
    return f"{written} {noun}{'' if number == 1 else 's'}"
