"""What is said of a metric, and which metrics a track shows."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import KW_ONLY, dataclass
from typing import Literal


@dataclass(frozen=True)
class Column:
    """How a metric stands in a narrow column: its heading, and the line below it (a unit, most often).

    digits: decimals; one more is shown where a value lies below `small`
    factor: from the value to the number shown: 100 for a share in %
    """

    heading: str
    unit: str = ""
    digits: int = 3
    factor: float = 1.0
    small: float = 0.0


@dataclass(frozen=True)
class Metric:
    """One number of a result: everything that a table, a report and the board say of it.

    definition: one sentence
    heading:    of a table's column where there is room
    unit:       as written behind the number; empty where it has none
    better:     the direction of improvement; empty for what describes the sequence or the run
    weight:     key of the metric that weighs sequences in a mean over them: that of the denominator of a ratio, so
                that the mean is the ratio over the whole data set; empty where every sequence has one vote
    column:     where there is little room; heading and unit where not given
    limits:     least and greatest value, where better and unit do not say them (`range`)
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
        """Least and greatest value that can be: errors are not below 0, and what has no unit is a share of 1."""
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
        """Below it, a table shows one decimal more."""
        return self.column.small if self.column else 0.1

    @property
    def factor(self) -> float:
        """From the value to the number that a table shows."""
        return self.column.factor if self.column else Column.factor


def higher(
    heading: str,
    unit: str = "",
    column: Column | None = None,
    weight: str = "",
    limits: tuple[float, float] | None = None,
) -> Callable[[str], Metric]:
    """A metric of which greater is better, once called with its definition: `higher("Recall")("Share of ...")`."""
    return lambda text: Metric(text, heading, unit=unit, better="higher", weight=weight, column=column, limits=limits)


def lower(heading: str, unit: str = "", column: Column | None = None, weight: str = "") -> Callable[[str], Metric]:
    """A metric of which less is better; see `higher`."""
    return lambda text: Metric(text, heading, unit=unit, better="lower", weight=weight, column=column)


def neutral(heading: str, unit: str = "", column: Column | None = None, weight: str = "") -> Callable[[str], Metric]:
    """A metric that has no better direction; see `higher`."""
    return lambda text: Metric(text, heading, unit=unit, weight=weight, column=column)


@dataclass(frozen=True)
class TrackMetrics:
    """The metrics of a track by their key, and which are shown.

    title:    of the track
    table:    those of one line per method and sequence, the one that ranks first
    standing: those of the standings, beside rank, score and interval
    beside:   the one that is shown beside the one that ranks, over conditions and over runs
    failed:   the values of a run without a scored estimate: it answers nothing, and its errors do not exist
    costs:    those of what a run cost, behind `table` where any run has them
    wide:     those of both that a terminal leaves out where it is too narrow: the others fit into 80 characters
    errors:   those of both without a bound, which one lost sequence would decide alone: over sequences, the median over
              those that are not lost (`oysterbench.results.lost`) stands for them
    lost_below: of the one that ranks: a sequence that scores less is lost. None where a track has no such thing
    """

    title: str
    metrics: Mapping[str, Metric]
    table: tuple[str, ...]
    standing: tuple[str, ...]
    beside: str
    failed: Mapping[str, float]
    costs: tuple[str, ...] = ("cpu_s", "peak_memory_mb")
    wide: tuple[str, ...] = ("cpu_s", "peak_memory_mb")
    errors: tuple[str, ...] = ()
    lost_below: float | None = None

    @property
    def ranking(self) -> str:
        """Key of the metric that ranks methods."""
        return self.table[0]
