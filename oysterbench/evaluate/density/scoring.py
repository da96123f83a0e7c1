"""Scoring an oyster map against the ground truth, cell by cell."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from oysterbench.evaluate.density.metrics import DENSITY as METRICS
from oysterbench.evaluate.density.restoration import restoration_class
from oysterbench.evaluate.values import Measures, Score

__all__ = ["EVALUATOR", "METRICS", "Cell", "MapCount", "TrueCount", "score_density"]

EVALUATOR = "density 3"
"""Name and version of this evaluator; the version rises whenever a published number may change (docs/versions.md)."""


@dataclass(frozen=True)
class Cell:
    """A cell of which enough was seen: its seen area, m^2, and the live oysters on it."""

    area_m2: float
    live: float

    @property
    def per_m2(self) -> float:
        """Live oysters per square metre."""
        return self.live / self.area_m2


Cells = Mapping[tuple[int, int], Cell]
"""Cells by column and row: x and y in the world frame divided by the edge length of a cell, rounded down."""


@dataclass(frozen=True)
class TrueCount:
    """True count on the ground that was seen. shown, live: oysters visible in some image, and the live ones of these;
    hidden: those visible in none; area_m2: of that ground."""

    cells: Cells
    shown: int
    live: int
    hidden: int
    area_m2: float


@dataclass(frozen=True)
class MapCount:
    """An estimated map. count, live: number of oysters, and of live ones; low, high: interval of the count.

    owners: for each map entry, the true oyster behind it, 0 for none; found: true oysters that are in some entry
    """

    cells: Cells
    count: float
    live: float
    low: float
    high: float
    owners: Sequence[int]
    found: frozenset[int]


def score_density(truth: TrueCount, estimate: MapCount) -> Score:
    """Score a map on the cells that were truly seen, and no others."""
    measures = Measures()
    true_cells = len(truth.cells)
    errors = {at: estimate.cells[at].per_m2 - cell.per_m2 for at, cell in truth.cells.items() if at in estimate.cells}
    none_seen, none_met = "no cell was seen enough to have a number", "no cell that was truly seen has a number"
    measures.ratio("map_score", *_in_common(truth.cells, estimate.cells), none_seen)
    measures.ratio("cell_mae_per_m2", sum(map(abs, errors.values())), len(errors), none_met)
    measures.ratio("cell_bias_per_m2", sum(errors.values()), len(errors), none_met)
    true_class, mapped_class = (
        restoration_class(np.array([cells[at].per_m2 for at in errors])) for cells in (truth.cells, estimate.cells)
    )
    measures.ratio("right_class", int((true_class == mapped_class).sum()), true_cells, none_seen)
    measures.ratio("coverage", len(errors), true_cells, none_seen)

    none_true = "no image shows an oyster"
    measures.ratio("count_error_percent", 100.0 * (estimate.count - truth.shown), truth.shown, none_true)
    measures.ratio("count_off_percent", 100.0 * abs(estimate.count - truth.shown), truth.shown, none_true)
    measures.ratio(
        "live_error_percent", 100.0 * (estimate.live - truth.live), truth.live, "no image shows a live oyster"
    )
    measures["count_within"] = float(estimate.low <= truth.shown <= estimate.high)
    entries = Counter(owner for owner in estimate.owners if owner)
    measures.ratio("twice_percent", 100.0 * (sum(entries.values()) - len(entries)), truth.shown, none_true)
    measures.ratio("lost_percent", 100.0 * len(estimate.found - set(entries)), truth.shown, none_true)
    measures["oysters_truth"], measures["oysters_counted"] = float(truth.shown), float(estimate.count)
    measures.ratio(
        "hidden_percent", 100.0 * truth.hidden, truth.shown + truth.hidden, "there is no oyster on the seen ground"
    )
    measures["area_m2"] = truth.area_m2
    measures.ratio("density_truth_live_per_m2", truth.live, truth.area_m2, "nothing was seen")
    return Score(measures.values, measures.reasons)


def _in_common(truth: Cells, estimate: Cells) -> tuple[float, float]:
    """Live oysters that two maps have in common, and those that either has, on the truly seen cells; on bare ground,
    the cells to which the estimate gives a number, and all of them.

    Their ratio is the similarity of Ruzicka (1958), also called weighted Jaccard index: 1 for equal maps, 0 for an
    empty one, 1/2 for one with twice or half of the oysters everywhere. Where most cells are bare, a mean over cells
    would take an empty map for a good one.
    """
    pairs = [(c.area_m2, c.per_m2, estimate[at].per_m2 if at in estimate else 0.0) for at, c in truth.items()]
    either = sum(area * max(true, found) for area, true, found in pairs)
    if either == 0:
        return float(len(truth.keys() & estimate.keys())), float(len(truth))
    return sum(area * min(true, found) for area, true, found in pairs), either
