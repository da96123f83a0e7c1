"""Counting error of a method on labelled images: from the results of an evaluation, or the card of its weights."""

from __future__ import annotations

import math
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from oysterbench.core.errors import MethodError, ResultError
from oysterbench.hub.model import Figure
from oysterbench.hub.weights import weights_here
from oysterbench.methods.weights import find_weights, weights_names
from oysterbench.recipe import split_names
from oysterbench.results.card_figures import weights_in
from oysterbench.results.records import ResultRecord, read_results

TRUTH, ESTIMATE = "count_truth", "count_estimate"
TRACK = "detection"
EARLIER = " (earlier)"
"""End of the name of data, in a card, of which weights have also seen another version."""
OF_COUNTS = ("count_bias", "count_mae")
"""Metrics of the track that state the error of counts."""


@dataclass(frozen=True)
class Accuracy:
    """Accuracy of counts. labelled, counted: oysters over all labelled images; where: names of their splits or
    sequences; other_weights: whether they were counted with other weights than those here; threshold: minimum score of
    what was counted, None if unknown; rendered: whether all images are of splits of oysterbench. Oysters of every size
    were counted."""

    labelled: float
    counted: float
    where: str
    other_weights: bool = False
    threshold: float | None = None
    rendered: bool = False

    @property
    def tells(self) -> bool:
        """Whether it says how far counts with the weights that are here are off on other images than rendered ones."""
        return math.isfinite(self.percent) and not self.other_weights and not self.rendered

    @property
    def percent(self) -> float:
        """Error of the count in % of those labelled: above 0 for too many; NaN if none is labelled."""
        return 100 * (self.counted / self.labelled - 1) if self.labelled else math.nan


def read_accuracy(path: Path, method: str, weights: Mapping[str, str] | None = None) -> Accuracy:
    """Read the accuracy of a method from a results.json of the detection track (or its folder), over all sequences,
    with the mean counts of several runs on one.

    weights: SHA-256 of the weights that are here, by name. Raises ResultError if it has no results of the method.
    """
    path = path / "results.json" if path.is_dir() else path
    remedy = f"`oysterbench run {method} --track {TRACK} --on LABELLED --out DIR` makes them"
    if not path.exists():
        raise ResultError(f"{path}: no such file; expected results of {method}: {remedy}")
    records = [one for one in read_results(path) if one.track == TRACK and one.failure is None]
    own = [one for one in records if one.method == method and {TRUTH, ESTIMATE} <= one.metrics.keys()]
    if not own:
        methods = ", ".join(dict.fromkeys(one.method for one in records))
        raise ResultError(
            f"{path}: expected results of {method} on the track detection, got {methods or 'none of that track'}; "
            f"{remedy}"
        )
    places = dict.fromkeys(one.split or one.sequence for one in own)
    runs: dict[tuple[str, str], list[ResultRecord]] = {}
    for one in own:
        runs.setdefault((one.split, one.sequence), []).append(one)
    labelled, counted = (
        math.fsum(math.fsum(one.metrics[key] for one in of) / len(of) for of in runs.values())
        for key in (TRUTH, ESTIMATE)
    )
    other = any(weights_in(one) != dict(weights) for one in own if weights_in(one)) if weights else False
    rendered = all(one.split in split_names() for one in own)
    return Accuracy(labelled, counted, ", ".join(places), other, own[0].settings.get("threshold"), rendered)


def saw_rendered_reefs_alone(weights: Mapping[str, Path]) -> bool:
    """Whether cards of weights, by name, or checkpoints without one, say that all that any of them has learnt from is
    splits of oysterbench."""
    data = [name for weight, path in weights.items() for name in _data_of(weight, path)]
    learnt_from = {part for name in data for part in name.removesuffix(EARLIER).split("+")}
    return bool(data) and learnt_from <= {*split_names()}


def _data_of(name: str, path: Path) -> list[str]:
    """Names of the data that weights have learnt from; none where that is not known."""
    here = weights_here(path)
    if here is not None and here.model is not None:
        return list(here.model.training.data)
    if here is not None and name in weights_names():
        with suppress(MethodError, ModuleNotFoundError):
            return list(find_weights(name).describe(path).data)
    return []


def figures_of_counts(weights: Mapping[str, Path], method: str) -> list[Figure]:
    """Figures on a method's counting error from the cards of weights, by name; none for weights without a card."""
    here = (weights_here(path) for path in weights.values())
    figures = (one for known in here if known is not None and known.model is not None for one in known.model.figures)
    return [one for one in figures if one.track == TRACK and one.method == method and one.metric in OF_COUNTS]
