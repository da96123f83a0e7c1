"""Distinction of live from dead oysters: each state as a class of its own, and the states of those that were found."""

from __future__ import annotations

import math
from dataclasses import astuple, dataclass
from operator import add

import numpy as np

from oysterbench.evaluate.detection.panoptic import Pairing

STATE_METRICS = ("f1_live", "f1_dead", "state_accuracy", "live_error")

ALIVE = 0.5
"""Probability from which an oyster counts as live, and below which as dead."""

NO_STATES = "the truth does not tell live oysters from dead ones"
NOT_PREDICTED = "the estimate does not tell live oysters from dead ones"


@dataclass(frozen=True)
class StateCounts:
    """Sums over images.

    live, dead:         true ones that are visible in an image
    predicted_live, predicted_dead: estimated ones, except those that are excused or matched to a truth of unknown state
    live_as_live ...:   matches, by true and estimated state
    """

    live: int = 0
    dead: int = 0
    predicted_live: int = 0
    predicted_dead: int = 0
    live_as_live: int = 0
    live_as_dead: int = 0
    dead_as_live: int = 0
    dead_as_dead: int = 0

    def __add__(self, other: StateCounts) -> StateCounts:
        return StateCounts(*map(add, astuple(self), astuple(other)))

    def __mul__(self, times: int) -> StateCounts:
        return StateCounts(*(times * value for value in astuple(self)))


def states_of(pairing: Pairing) -> StateCounts:
    """Count the states in an image. An estimate is live from a probability of `ALIVE`."""
    true = np.array([one.live for one in pairing.truths], dtype=float)
    said = np.array([one.live for one in pairing.estimates], dtype=float)
    live, dead = true >= ALIVE, true < ALIVE  # neither for NaN
    predicted_live, predicted_dead = said >= ALIVE, said < ALIVE
    matches = pairing.overlap > 0
    seen = matches.any(axis=1) | pairing.missed
    judged = matches[live | dead].any(axis=0) | pairing.extra
    by_truth = [
        int((matches & rows[:, None] & columns[None, :]).sum())
        for rows in (live, dead)
        for columns in (predicted_live, predicted_dead)
    ]
    totals = [int(part.sum()) for part in (live & seen, dead & seen, predicted_live & judged, predicted_dead & judged)]
    return StateCounts(*totals, *by_truth)


def state_metrics(counts: StateCounts) -> tuple[dict[str, float], dict[str, str]]:
    """Compute the values of `STATE_METRICS`, and the reasons for those that are NaN."""
    if counts.live + counts.dead == 0 or counts.predicted_live + counts.predicted_dead == 0:
        why = NO_STATES if counts.live + counts.dead == 0 else NOT_PREDICTED
        return dict.fromkeys(STATE_METRICS, math.nan), dict.fromkeys(STATE_METRICS, why)
    found_live = counts.live_as_live + counts.live_as_dead
    found_dead = counts.dead_as_live + counts.dead_as_dead
    metrics, reasons = {}, {}
    for key, value, over, why in (
        ("f1_live", 2 * counts.live_as_live, counts.live + counts.predicted_live, "nothing is alive, nor said to be"),
        ("f1_dead", 2 * counts.dead_as_dead, counts.dead + counts.predicted_dead, "nothing is dead, nor said to be"),
    ):
        metrics[key] = value / over if over else math.nan
        if not over:
            reasons[key] = why
    if found_live and found_dead:
        metrics["state_accuracy"] = (counts.live_as_live / found_live + counts.dead_as_dead / found_dead) / 2
    else:
        metrics["state_accuracy"] = math.nan
        reasons["state_accuracy"] = "no match of a live oyster and one of a dead one, of which the estimate tells"
    metrics["live_error"] = float(counts.predicted_live - counts.live)
    return metrics, reasons
