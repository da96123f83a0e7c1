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
"""Intervals of a table, at least, that are drawn whole."""

LEVEL = f"{100 * statistics.LEVEL:.0f} %"


def track_name(track: str) -> str:
    """As headings write it; of a track that is not known here, its own word."""
    return TRACKS[track].title if track in TRACKS else track.capitalize()


def text(key: str, value: float | None) -> str:
    """One value of a metric as shown."""
    return metric_column(key).text(finite(value))


def difference_column(key: str) -> Column:
    """The column of a metric's differences, with their signs."""
    return replace(metric_column(key), key="difference", signed=True, cut=False, sort="")


def interval(low: float | None, high: float | None) -> Interval:
    """From both ends, where there are."""
    if low is None or high is None:
        return Interval(math.nan, math.nan, "too few sequences")
    return Interval(low, high)


def unit(of: Column) -> str:
    """Of a column, with an arrow to where better is."""
    return f"{of.unit} {ARROWS[of.better]}".strip()


def bar(
    low: float | None, middle: float | None, high: float | None, axis: tuple[float, float] = (0.0, 1.0), name: str = ""
) -> Bar | None:
    """An interval to be drawn on an axis; None where it has no ends, or one of shares leaves the axis of these.

    name: of the axis's ends as pages write them, where it is another than that of shares
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
    """From where to where the intervals of a table, the best first, are drawn: round values around those of its better
    half, which differ by less than they do from the others. None where there are none.

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
    """A setting as pages show it."""
    return "none" if value in (None, [], ()) else ", ".join(map(str, value)) if isinstance(value, list) else str(value)


def finite(value: float | None) -> float | None:
    """None for what is no number."""
    return None if value is None or not math.isfinite(value) else value


def count(number: int, noun: str) -> str:
    """A number of things.

    >>> count(1, "record"), count(999, "record")
    ('1 record', '999 records')
    """
    written = f"{number:,}".replace(",", "\N{NARROW NO-BREAK SPACE}") if number >= 10_000 else str(number)
    return f"{written} {noun}{'' if number == 1 else 's'}"
