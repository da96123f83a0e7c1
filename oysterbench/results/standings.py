"""Standings of methods: places by the mean, ranks by significant differences.

The one rule for `oysterbench compare`, reports and the leaderboard. Methods are ordered by their means over the
sequences. **The rank of a method is 1 + the number of methods that are significantly better than it, and at least the
rank of any method placed above it.** Significance is decided by the paired bootstrap over sequences
(`evaluate.statistics.compare`), at 95 %.

1 + the number of significantly better systems is the lower end of the rank ranges of WMT's human evaluations (Bojar et
al. 2013) and the rank of Chatbot Arena (Chiang et al. 2024); [1 + better, R - worse] is the form of the confidence
interval of a rank in Mogstad, Romano, Shaikh & Wilhelm (2024, "Inference for ranks"). Counting alone may give a method
a better rank than one with a better mean whose values scatter less; "at least the rank of any above" rules that out,
and never takes a rank past its place.

Consequences: equal values have equal ranks; names and the order of methods do not matter; a rank never gets worse up
the board; a new method does not change the comparison of any two others. The price of the last is that there is no
correction for the number of pairs. In a simulation of methods of equal skill on twelve sequences, the interval from
rank to worst contained rank 1 for 97 % of 2 methods, 92 % of 4, 83 % of 8 and 79 % of 12: on a long board of close
methods some differences are due to chance.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from oysterbench.core.geometry import Array
from oysterbench.evaluate.metrics import FAILED, TRACKS, find_metric
from oysterbench.evaluate.statistics import LEAST_SEQUENCES, bootstrap_intervals, mean_of, significant_signs

PRIMARY = {name: track.ranking for name, track in TRACKS.items()}
"""Track -> key of its ranking metric."""

UNPREDICTED_WEIGHT = {"union_px": "truth_px"}
"""Key of a metric's weight -> key of the same weight where nothing was predicted: the union of an empty mask and the
ground truth is the ground truth."""

REFERENCES = 50
"""Number of best-placed methods that all others are tested against; methods significantly worse than all of these share
the rank after them. A board of tens of thousands is thus ranked within seconds, and one of up to 50 in full."""

BATCH = 256
"""Number of methods whose resamples are in memory at once: 20 MB."""

Direction = Literal["lower", "higher"]


def direction(key: str) -> Direction:
    """Which values of a metric are better: higher ones, unless the metric says otherwise."""
    found = find_metric(key)
    return "lower" if found is not None and found.better == "lower" else "higher"


@dataclass(frozen=True)
class Standing:
    """Standing of a method among others.

    place: 1 + the number of methods with a better mean; equal means share a place. None without a value
    rank:  1 + the number of methods that are significantly better than it, and at least that of any method placed
           above it: its best possible rank. None if it has values on too few sequences for any test
    worst: the number of methods minus those that are significantly worse than it, and at most that of any method
           placed below it: its worst possible rank
    """

    place: int | None
    rank: int | None
    worst: int | None


@dataclass(frozen=True)
class SequenceScores:
    """Scores that rank a method: the mean of its runs on each sequence.

    values:      of the ranking metric, NaN where there is none although the sequence was run
    weights:     of the values in a mean; None if all sequences count equally
    unpredicted: weights of the sequences if nothing is predicted there; empty if all sequences count equally
    """

    values: Mapping[str, float]
    weights: Mapping[str, float] | None = None
    unpredicted: Mapping[str, float] | None = None


@dataclass(frozen=True)
class ScoreTable:
    """Values (R, n) of R methods on n sequences, NaN where there is none, and their weights (R, n), if any."""

    values: Array
    weights: Array | None = None

    @classmethod
    def of(
        cls,
        scores: Sequence[SequenceScores],
        sequences: Iterable[str],
        track: str,
        trusted: Sequence[SequenceScores] | None = None,
    ) -> ScoreTable:
        """Make the table of a track's ranking metric; a sequence that a method lacks counts as failed, weighted as if
        nothing were predicted there. Where a failure may be worth less than `failed`, as below chance in steering, it
        counts as the lowest score there: no method gains by leaving out what it is bad at.

        trusted: scores of the methods from which that weight, or that score, is taken; by default all
        """
        names = sorted(sequences)  # the bootstrap resamples sequences in this order, as in `summarise`
        metric = PRIMARY[track]
        found, failed = find_metric(metric), FAILED[track][metric]
        shape = len(scores), len(names)
        known = scores if trusted is None else trusted
        lowest = {name: min([failed, *(one.values[name] for one in known if name in one.values)]) for name in names}
        values = np.array([[one.values.get(name, lowest[name]) for name in names] for one in scores], float)
        values = values.reshape(shape)
        if found is None or not found.weight:
            return cls(values)
        lacking = {name: _unpredicted_weight(known, name) for name in names}
        weights = [[(one.weights or {}).get(name, lacking[name]) for name in names] for one in scores]
        return cls(values, np.array(weights, float).reshape(shape))

    def take(self, rows: Sequence[int] | NDArray[np.int64] | slice) -> ScoreTable:
        """Select the given methods (rows)."""
        return ScoreTable(self.values[rows], None if self.weights is None else self.weights[rows])

    def means(self) -> Array:
        """Means (R,) over the sequences that have a value, NaN where none has; identical to those of `summarise` to
        the last digit."""
        found = []
        for k, row in enumerate(self.values):
            known = ~np.isnan(row)
            weights = None if self.weights is None else self.weights[k][known]
            found.append(mean_of(row[known], weights) if known.any() else math.nan)
        return np.array(found, float)

    def intervals(self) -> Array:
        """Confidence intervals (R, 2), low and high, of the means; NaN where there is none."""
        found = [np.empty((0, 2))]
        for start in range(0, len(self.values), BATCH):
            part = self.take(slice(start, start + BATCH))
            found.append(bootstrap_intervals(part.values, part.weights))
        return np.concatenate(found)

    def standings(self, better: Direction) -> list[Standing]:
        """Standing of each method, in the order of the table."""
        means = self.means() * (-1 if better == "higher" else 1)
        order = np.argsort(means, kind="stable")[: np.count_nonzero(~np.isnan(means))]
        if not len(order):
            return [Standing(None, None, None)] * len(means)
        places = 1 + np.searchsorted(means[order], means[order])
        above, below = self.take(order)._significant(better)
        # Methods with equal means share the rank of the last of them and the worst rank of the first.
        ends = np.searchsorted(places, places, side="right") - 1
        ranks = np.minimum(np.maximum.accumulate(1 + above)[ends], places)
        worst = np.minimum.accumulate((len(order) - below)[::-1])[::-1]
        worst = np.maximum(worst[np.searchsorted(places, places)], places)
        enough = np.count_nonzero(~np.isnan(self.values[order]), axis=1) >= LEAST_SEQUENCES
        found = [Standing(None, None, None)] * len(means)
        for k, i in enumerate(order.tolist()):
            interval = (int(ranks[k]), int(worst[k])) if enough[k] else (None, None)
            found[i] = Standing(int(places[k]), *interval)
        return found

    def _significant(self, better: Direction) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Count, for each method (R,), how many of the first `REFERENCES` methods are significantly better, and how
        many methods are significantly worse; methods are in the order of their means."""
        count, sign = len(self.values), 1 if better == "higher" else -1
        above, below = np.zeros(count, int), np.zeros(count, int)
        for start in range(0, count, BATCH):
            rows = np.arange(start, min(start + BATCH, count))
            for j in range(min(REFERENCES, rows[-1])):
                others = rows[rows > j]
                weights = (None, None) if self.weights is None else (self.weights[j], self.weights[others])
                signs = sign * significant_signs(self.values[j], self.values[others], *weights)
                above[others] += signs > 0
                below[others] += signs < 0
                above[j] += np.count_nonzero(signs < 0)
                below[j] += np.count_nonzero(signs > 0)
            if above[rows].max() == REFERENCES:  # no method below ranks better, and none can rank worse
                break
        return above, below


def _unpredicted_weight(scores: Sequence[SequenceScores], name: str) -> float:
    """Weight of a sequence where nothing is predicted: the least that any method reports for this case or, if none
    does, the least weight that any method has on the sequence."""
    known = [one.unpredicted[name] for one in scores if one.unpredicted and name in one.unpredicted]
    least = [one.weights[name] for one in scores if one.weights and name in one.weights]
    return min([value for value in known if not math.isnan(value)] or least or [0.0])
