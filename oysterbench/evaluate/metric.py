"""What is said of a metric."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal


@dataclass(frozen=True)
class Metric:
    """One number of a result.

    unit:       as written behind the number; empty where it has none
    better:     the direction of improvement; empty for what describes the sequence or the run
    definition: one sentence
    short:      heading of a table's column
    weight:     key of the metric that weighs sequences in a mean over them: that of the denominator of a ratio, so
                that the mean is the ratio over the whole data set; empty where every sequence has one vote
    """

    unit: str
    better: Literal["lower", "higher", ""]
    definition: str
    short: str = ""
    weight: str = ""
