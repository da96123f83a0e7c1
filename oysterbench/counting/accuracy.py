"""How far a method counts off on labelled pictures, from the results of an evaluation."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

from oysterbench.core.errors import ResultError
from oysterbench.results.records import read_results

TRUTH, ESTIMATE = "count_truth", "count_estimate"


@dataclass(frozen=True)
class Accuracy:
    """labelled, counted: oysters over all labelled pictures; where: which these are."""

    labelled: float
    counted: float
    where: str

    @property
    def percent(self) -> float:
        """Too many, or below 0 too few, of those labelled; NaN where none is."""
        return 100 * (self.counted / self.labelled - 1) if self.labelled else math.nan


def read_accuracy(path: Path, method: str) -> Accuracy:
    """Of a method, over all sequences of a file results.json (or of the folder that has it) of the track detection.
    Raises ResultError where it is of other methods."""
    path = path / "results.json" if path.is_dir() else path
    records = [one for one in read_results(path) if one.track == "detection" and one.failure is None]
    own = [one for one in records if one.method == method and {TRUTH, ESTIMATE} <= one.metrics.keys()]
    if not own:
        methods = ", ".join(dict.fromkeys(one.method for one in records))
        raise ResultError(
            f"{path}: expected results of {method} on the track detection, got {methods or 'none of that track'}; "
            f"`oysterbench run {method} --on LABELLED --out DIR` makes them"
        )
    places = dict.fromkeys(one.split or one.sequence for one in own)
    labelled, counted = (math.fsum(one.metrics[key] for one in own) for key in (TRUTH, ESTIMATE))
    return Accuracy(labelled, counted, ", ".join(places))
