"""How far a method counts off on labelled pictures: from the results of an evaluation, or the card of its weights."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from oysterbench.core.errors import ResultError
from oysterbench.hub.model import Figure
from oysterbench.hub.weights import weights_here
from oysterbench.results.reached import weights_in
from oysterbench.results.records import read_results

TRUTH, ESTIMATE = "count_truth", "count_estimate"
TRACK = "detection"
OF_COUNTS = ("count_bias", "count_mae")
"""Metrics of the track that say how far counts are off."""


@dataclass(frozen=True)
class Accuracy:
    """labelled, counted: oysters over all labelled pictures; where: which these are; other_weights: whether they were
    counted with other weights than are here."""

    labelled: float
    counted: float
    where: str
    other_weights: bool = False

    @property
    def percent(self) -> float:
        """Too many, or below 0 too few, of those labelled; NaN where none is."""
        return 100 * (self.counted / self.labelled - 1) if self.labelled else math.nan


def read_accuracy(path: Path, method: str, weights: Mapping[str, str] | None = None) -> Accuracy:
    """Of a method, over all sequences of a file results.json (or of the folder that has it) of the track detection.

    weights: SHA-256 of those that are here, by name. Raises ResultError where the results are of other methods.
    """
    path = path / "results.json" if path.is_dir() else path
    records = [one for one in read_results(path) if one.track == TRACK and one.failure is None]
    own = [one for one in records if one.method == method and {TRUTH, ESTIMATE} <= one.metrics.keys()]
    if not own:
        methods = ", ".join(dict.fromkeys(one.method for one in records))
        raise ResultError(
            f"{path}: expected results of {method} on the track detection, got {methods or 'none of that track'}; "
            f"`oysterbench run {method} --on LABELLED --out DIR` makes them"
        )
    places = dict.fromkeys(one.split or one.sequence for one in own)
    labelled, counted = (math.fsum(one.metrics[key] for one in own) for key in (TRUTH, ESTIMATE))
    other = any(weights_in(one) != dict(weights) for one in own if weights_in(one)) if weights else False
    return Accuracy(labelled, counted, ", ".join(places), other)


def figures_of_counts(weights: Mapping[str, Path], method: str) -> list[Figure]:
    """What the cards of weights, by name, say of how far a method counts off; nothing of weights that have no card."""
    here = (weights_here(path) for path in weights.values())
    figures = (one for known in here if known is not None and known.model is not None for one in known.model.figures)
    return [one for one in figures if one.track == TRACK and one.method == method and one.metric in OF_COUNTS]
