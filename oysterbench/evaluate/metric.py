"""What is said of a metric, and which metrics a track shows."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal


@dataclass(frozen=True)
class Metric:
    """One number of a result: everything that a table, a report and the board say of it.

    unit:       as written behind the number; empty where it has none
    better:     the direction of improvement; empty for what describes the sequence or the run
    definition: one sentence
    heading:    of a table's column where there is room
    weight:     key of the metric that weighs sequences in a mean over them: that of the denominator of a ratio, so
                that the mean is the ratio over the whole data set; empty where every sequence has one vote
    column:     heading of a narrow column, and the line below it (a unit, most often); heading and unit where not given
    factor:     from the value to the number shown in a table: 100 for a share in %
    digits:     decimals in a table; one more is shown where a value lies below `small`
    """

    unit: str
    better: Literal["lower", "higher", ""]
    definition: str
    heading: str = ""
    weight: str = ""
    column: tuple[str, str] | None = None
    factor: float = 1.0
    digits: int = 3
    small: float = 0.1

    @property
    def narrow(self) -> tuple[str, str]:
        """The two lines over a narrow column."""
        return self.column or (self.heading, self.unit)


@dataclass(frozen=True)
class TrackMetrics:
    """The metrics of a track by their key, and which are shown.

    table:    those of one line per method and sequence, the one that ranks first: as many as 80 characters hold
    standing: those of the standings, beside rank, score and interval
    beside:   the one that is shown beside the one that ranks, over conditions and over runs
    failed:   the values of a run without a scored estimate: it answers nothing, and its errors do not exist
    """

    metrics: Mapping[str, Metric]
    table: tuple[str, ...]
    standing: tuple[str, ...]
    beside: str
    failed: Mapping[str, float]

    @property
    def ranking(self) -> str:
        """Key of the metric that ranks methods."""
        return self.table[0]
