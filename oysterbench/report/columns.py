"""The metrics that tables show: their headings, units and decimals."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from oysterbench.evaluate.metric import Metric
from oysterbench.evaluate.metrics import TRACKS, find_metric
from oysterbench.report.table import Column as TableColumn

ABSENT = "\N{EN DASH}"
"""Stands where there is no value."""


@dataclass(frozen=True)
class Column:
    """A metric in a table: key, heading and unit below it, factor to the shown unit.

    decimals: of ordinary values; one more is shown where a value lies below `small`
    """

    key: str
    heading: str
    unit: str
    factor: float = 1.0
    decimals: int = 2
    small: float = 0.1

    def texts(self, values: Sequence[float | None]) -> list[str]:
        """The values as shown, all with the same decimals, so that the eye can compare them.

        Coverage is cut, not rounded: 100 is said of nothing less.
        """
        known = [abs(value * self.factor) for value in values if value is not None and math.isfinite(value)]
        decimals = self.decimals + any(0 < value < self.small for value in known)
        return [ABSENT if value is None or math.isnan(value) else self._text(value, decimals) for value in values]

    def _text(self, value: float, decimals: int) -> str:
        if self.key == "coverage":
            return f"{math.floor(value * self.factor * 10 + 1e-9) / 10:.1f}"
        return f"{value * self.factor:.{decimals}f}"


def find_column(key: str) -> Column:
    """The column of a metric."""
    metric = find_metric(key) or Metric("", key)
    return Column(key, *metric.narrow, metric.factor, metric.digits, metric.small)


def _columns(keys: Iterable[str]) -> tuple[Column, ...]:
    return tuple(find_column(key) for key in keys)


OF_TRACK = {name: _columns(track.table) for name, track in TRACKS.items()}
"""Track -> columns of its results."""

STANDING_OF_TRACK = {name: _columns(track.standing) for name, track in TRACKS.items()}
"""Track -> columns of its standings, beside the metric that ranks."""

ERROR_OF_TRACK = {name: track.beside for name, track in TRACKS.items()}
"""Track -> the metric that is shown beside the one that ranks, over conditions and over runs."""

COLUMNS = OF_TRACK["slam"]


UNITS = {"x": "\N{MULTIPLICATION SIGN} real time"}
"""Unit of a metric -> the same where there is room."""


def metric_column(key: str, sort: bool = False) -> TableColumn:
    """The column of a metric; sort: whether an address may ask for the order of its values."""
    metric = find_metric(key) or Metric("No definition is known to this version.", key)
    unit = metric.unit or ("%" if metric.factor == 100.0 else "")
    return TableColumn(
        key,
        metric.heading or key,
        UNITS.get(unit, unit),
        "number",
        "\n".join(filter(None, metric.narrow)),
        metric.digits,
        metric.small,
        metric.factor,
        cut=key == "coverage",
        better=metric.better,
        about=metric.definition,
        sort=key if sort else "",
    )
