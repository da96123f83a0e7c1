"""Numbers as pages show them: columns of metrics, intervals, counts."""

from __future__ import annotations

import math
from dataclasses import replace

from oysterbench.evaluate import statistics
from oysterbench.evaluate.metrics import TRACKS
from oysterbench.evaluate.statistics import Interval
from oysterbench.report.columns import metric_column
from oysterbench.report.table import Bar, Column

ARROWS = {"lower": "\N{DOWNWARDS ARROW}", "higher": "\N{UPWARDS ARROW}", "": ""}
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


def bar(low: float | None, middle: float | None, high: float | None) -> Bar | None:
    """An interval to be drawn, where it is one of shares."""
    if low is None or middle is None or high is None or not 0 <= low <= high <= 1 or not 0 <= middle <= 1:
        return None
    return Bar(low, middle, high)


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
