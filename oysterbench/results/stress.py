"""Scores against the strength of single disturbances: which disturbance breaks which method, and at what strength."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

from oysterbench.recipe import UNDISTURBED
from oysterbench.results.comparison import Board

BROKEN_SHARE = 0.5
"""Share of a method's score on the calm dive below which a disturbance has broken the method."""


@dataclass(frozen=True)
class Disturbance:
    """A disturbance of a dive: scores by method at increasing strengths from 0, the calm dive: means of its runs, as
    they are ranked, of which a failed one counts 0; NaN where there was none."""

    name: str
    strengths: tuple[int, ...]
    scores: Mapping[str, tuple[float, ...]]

    def can_break(self, label: str) -> bool:
        """Whether the method has a score above 0 on the calm dive, without which there is nothing to break."""
        return self.scores[label][0] > 0

    def breaks_at(self, label: str) -> int | None:
        """Least strength from which on the method's score stays below BROKEN_SHARE of that on the calm dive, among
        those that it was run at; None if it withstands the strongest of these, or cannot break."""
        if not self.can_break(label):
            return None
        calm, *disturbed = self.scores[label]
        broken = None
        for strength, value in zip(reversed(self.strengths), reversed(disturbed), strict=False):
            if value >= BROKEN_SHARE * calm:
                break
            broken = broken if math.isnan(value) else strength
        return broken


def disturbances(board: Board) -> list[Disturbance]:
    """Disturbances of a board's split, in the order of its sequences; none if there is no calm dive to compare with.
    A disturbance at only one strength counts like any other."""
    about = {name: board.conditions(name) for name in (*board.sequences, *board.left_out)}
    calm = [name for name, conditions in about.items() if conditions.get("disturbance") == UNDISTURBED]
    if len(calm) != 1:
        return []
    labels = [row.label for row in board.standings]
    means = {label: board.runs_of(label).means(board.metric) for label in labels}
    found = []
    for disturbance in dict.fromkeys(str(each["disturbance"]) for each in about.values() if "disturbance" in each):
        if disturbance == UNDISTURBED:
            continue
        by_strength = {
            int(each["strength"]): name for name, each in about.items() if each.get("disturbance") == disturbance
        }
        dives = {0: calm[0], **dict(sorted(by_strength.items()))}
        scores = {label: tuple(means[label].get(name, math.nan) for name in dives.values()) for label in labels}
        found.append(Disturbance(disturbance, tuple(dives), scores))
    return found
