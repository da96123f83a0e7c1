"""Descriptions of metrics, and which metrics a track shows."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import KW_ONLY, dataclass
from typing import Literal


@dataclass(frozen=True)
class Column:
    """How a metric is shown in a narrow column: its heading, and the line below it (usually a unit).

    digits: decimals; one more is shown for values below `small`
    factor: multiplies the value to give the number shown: 100 for a share in %
    """

    heading: str
    unit: str = ""
    digits: int = 3
    factor: float = 1.0
    small: float = 0.0


@dataclass(frozen=True)
class Metric:
    """One number of a result, with everything that a table, a report and the board say about it.

    definition: one sentence
    heading:    column heading in a table with enough room
    unit:       as written after the number; empty where there is none
    better:     the direction of improvement; empty for a number that describes the sequence or the run
    weight:     key of the metric that weights sequences in a mean over them: the denominator of a ratio, so that the
                mean is the ratio over the whole data set; empty where all sequences have equal weight
    column:     used where there is little room; default: heading and unit
    limits:     minimum and maximum value, where `better` and `unit` do not imply them (`range`)
    """

    definition: str
    heading: str
    _: KW_ONLY
    unit: str = ""
    better: Literal["lower", "higher", ""] = ""
    weight: str = ""
    column: Column | None = None
    limits: tuple[float, float] | None = None

    @property
    def range(self) -> tuple[float, float]:
        """Minimum and maximum possible value: errors are at least 0, and a value without a unit is a share of 1."""
        if self.limits is not None:
            return self.limits
        if not self.better:
            return -math.inf, math.inf
        return 0.0, 1.0 if self.better == "higher" and not self.unit else math.inf

    @property
    def narrow(self) -> tuple[str, str]:
        """Heading of a narrow column, and the line below it."""
        return (self.column.heading, self.column.unit) if self.column else (self.heading, self.unit)

    @property
    def digits(self) -> int:
        """Decimals in a table."""
        return self.column.digits if self.column else Column.digits

    @property
    def small(self) -> float:
        """Value below which a table shows one decimal more."""
        return self.column.small if self.column else 0.1

    @property
    def factor(self) -> float:
        """Factor that converts the value to the number shown in a table."""
        return self.column.factor if self.column else Column.factor


def higher(
    heading: str,
    unit: str = "",
    column: Column | None = None,
    weight: str = "",
    limits: tuple[float, float] | None = None,
) -> Callable[[str], Metric]:
    """Return a function that makes a greater-is-better metric of a definition: `higher("Recall")("Share of ...")`."""
    return lambda text: Metric(text, heading, unit=unit, better="higher", weight=weight, column=column, limits=limits)


def lower(heading: str, unit: str = "", column: Column | None = None, weight: str = "") -> Callable[[str], Metric]:
    """Return a function that makes a lower-is-better metric of a definition; see `higher`."""
    return lambda text: Metric(text, heading, unit=unit, better="lower", weight=weight, column=column)


def neutral(heading: str, unit: str = "", column: Column | None = None, weight: str = "") -> Callable[[str], Metric]:
    """Return a function that makes a metric without a better direction of a definition; see `higher`."""
    return lambda text: Metric(text, heading, unit=unit, weight=weight, column=column)


def counted(heading: str, unit: str = "", column: Column | None = None) -> Callable[[str], Metric]:
    """Return a function that makes the metric of a number of things, at least 0, of a definition; see `higher`."""
    return lambda text: Metric(text, heading, unit=unit, column=column, limits=(0.0, math.inf))


IMAGES_PER_S = higher("Speed", "per s")("Images processed per wall time of the method.")
"""Metric of every track that is run on images."""


@dataclass(frozen=True)
class TrackMetrics:
    """The metrics of a track by their key, and which of them are shown where.

    title:    of the track
    table:    metrics in a table with one line per method and sequence; the first is the ranking metric
    standing: metrics in the standings, beside rank, score and interval
    beside:   the metric shown beside the ranking one, over conditions and over runs
    failed:   values of a run without a scored estimate: it answers nothing, and its errors do not exist. A record may
              have a lower one, where the metric can be negative
    failed_as: the same for the ranking metric, in words, after "a failed run"
    costs:    metrics of what a run cost, shown after `table` where any run has them
    wide:     metrics of `table` and `costs` that a narrow terminal leaves out: the others fit into 80 characters
    errors:   metrics of both that are unbounded, so that a single lost sequence would dominate their mean: over
              sequences they are given as the median over those that are not lost (`oysterbench.results.lost`)
    lost_below: value of the ranking metric below which a sequence is lost; None for a track without this notion
    """

    title: str
    metrics: Mapping[str, Metric]
    table: tuple[str, ...]
    standing: tuple[str, ...]
    beside: str
    failed: Mapping[str, float]
    failed_as: str = "scores 0"
    costs: tuple[str, ...] = ("cpu_s", "peak_memory_mb")
    wide: tuple[str, ...] = ("cpu_s", "peak_memory_mb")
    errors: tuple[str, ...] = ()
    lost_below: float | None = None

    @property
    def ranking(self) -> str:
        """Key of the metric that ranks methods."""
        return self.table[0]
