"""Numbers as tables show them: with as many digits as they are worth, all of a column alike, units in the heading."""

from __future__ import annotations

import math
from collections.abc import Sequence

from oysterbench.evaluate import statistics
from oysterbench.evaluate.metrics import find_metric
from oysterbench.report import columns
from oysterbench_leaderboard.site.page import Bar, Cell, Column

ARROWS = {"lower": "\N{DOWNWARDS ARROW}", "higher": "\N{UPWARDS ARROW}", "": ""}
LEVEL = f"{100 * statistics.LEVEL:.0f} %"
ABSENT = columns.ABSENT
MINUS = "\N{MINUS SIGN}"

UNITS = {"x": "\N{MULTIPLICATION SIGN} real time", "% false": "%"}
"""Unit in a terminal's narrow column -> unit on a page."""


def track_name(track: str) -> str:
    """As headings write it."""
    return "SLAM" if track == "slam" else track.capitalize()


def heading(key: str, sort: bool = False) -> Column:
    """The column of a metric."""
    metric, shown = find_metric(key), columns.find_column(key)
    text = metric.heading if metric is not None and metric.heading else shown.heading
    unit = metric.unit if metric is not None and metric.unit else shown.unit
    if shown.unit.lower() in text.lower() and unit == shown.unit:
        unit = ""
    return Column(
        key,
        text,
        UNITS.get(unit, unit),
        number=True,
        about=metric.definition if metric is not None else "",
        better=metric.better if metric is not None else "",
        sort=key if sort else "",
    )


def texts(key: str, values: Sequence[float | None]) -> list[str]:
    """The values of a column as shown."""
    known = [None if value is None or not math.isfinite(value) else value for value in values]
    return [text.replace("-", MINUS) for text in columns.find_column(key).texts(known)]


def cells(key: str, values: Sequence[float | None]) -> list[Cell]:
    """A column: what is shown, and the values with every digit."""
    return [Cell(text, finite(value)) for text, value in zip(texts(key, values), values, strict=True)]


def interval(key: str, low: float | None, high: float | None) -> str:
    """Both ends, or a dash."""
    if low is None or high is None or not (math.isfinite(low) and math.isfinite(high)):
        return ABSENT
    return " to ".join(texts(key, [low, high]))


def signed(key: str, difference: float | None, beside: Sequence[Cell] = ()) -> str:
    """A difference, with its sign, and with as many decimals as the cells that it is the difference of."""
    if difference is None or not math.isfinite(difference):
        return ABSENT
    column = columns.find_column(key)
    decimals = max((len(cell.text.partition(".")[2]) for cell in beside), default=column.decimals)
    return f"{difference * column.factor:+.{decimals}f}".replace("-", MINUS)


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

    >>> count(1, "record"), count(12000, "record")
    ('1 record', '12 000 records')
    """
    written = f"{number:,}".replace(",", "\N{NARROW NO-BREAK SPACE}") if number >= 10_000 else str(number)
    return f"{written} {noun}{'' if number == 1 else 's'}"
