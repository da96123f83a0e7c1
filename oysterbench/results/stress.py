"""Scores against the strength of single disturbances: which of them breaks which method, and from where on."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from oysterbench.recipe import UNDISTURBED
from oysterbench.results.comparison import Board

BROKEN_SHARE = 0.5
"""Of a method's score on the calm dive: below it a disturbance has broken the method."""


@dataclass(frozen=True)
class Disturbance:
    """A disturbance of a dive: the scores by method (medians over its runs), at strengths from 0, which is the calm
    dive, upwards; 0 where all runs failed, NaN where there was none."""

    name: str
    strengths: tuple[int, ...]
    scores: Mapping[str, tuple[float, ...]]

    def breaks_at(self, label: str) -> int | None:
        """The least strength from which on the method stays below BROKEN_SHARE of what it scores on the calm dive; None
        where it withstands the strongest."""
        calm, *disturbed = self.scores[label]
        whole = [value >= BROKEN_SHARE * calm for value in disturbed]
        last = max((i for i, withstood in enumerate(whole) if withstood), default=-1)
        return self.strengths[last + 2] if last + 1 < len(whole) else None


def disturbances(board: Board) -> list[Disturbance]:
    """The disturbances of a board's split, in the order of its sequences; none where it has no calm dive to hold them
    against, and a disturbance at one strength only counts like any other."""
    about = {name: board.conditions(name) for name in (*board.sequences, *board.left_out)}
    calm = [name for name, conditions in about.items() if conditions.get("disturbance") == UNDISTURBED]
    if len(calm) != 1:
        return []
    medians = {
        (cell.label, cell.sequence): 0.0 if cell.failures == cell.runs else cell.median for cell in board.cells()
    }
    labels = [row.label for row in board.standings]
    found = []
    for disturbance in dict.fromkeys(str(each["disturbance"]) for each in about.values() if "disturbance" in each):
        if disturbance == UNDISTURBED:
            continue
        by_strength = {
            int(each["strength"]): name for name, each in about.items() if each.get("disturbance") == disturbance
        }
        dives = {0: calm[0], **dict(sorted(by_strength.items()))}
        scores = {label: tuple(medians.get((label, name), float("nan")) for name in dives.values()) for label in labels}
        found.append(Disturbance(disturbance, tuple(dives), scores))
    return found
