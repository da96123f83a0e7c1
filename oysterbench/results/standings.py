"""The standings of methods: places by the mean, ranks by what is significant.

The one rule of `oysterbench compare`, of reports and of the leaderboard. Methods are put in the order of their means
over the sequences. **The rank of a method is 1 + the number of methods that are significantly better than it, or than
one placed above it.** "Significantly" is by the paired bootstrap over sequences (`evaluate.statistics.compare`), at
95 %.

1 + the number of significantly better systems is the lower end of the rank ranges of WMT's human evaluations (Bojar et
al. 2013) and the rank of Chatbot Arena (Chiang et al. 2024); [1 + better, R - worse] is the form of the confidence
interval of a rank in Mogstad, Romano, Shaikh & Wilhelm (2024, "Inference for ranks"). Counting alone may give a method
a better rank than one with a better mean whose values scatter less; "or than one placed above it" rules that out, and
never takes a rank past its place.

What follows: equal values have equal ranks; names and the order of methods do not matter; a rank never gets worse up
the board; a method that joins changes no comparison of two others. The price of the last is that pairs are not
corrected for their number. Simulated, of methods of equal skill on twelve sequences the interval from rank to worst
held rank 1 for 97 % of 2, 92 % of 4, 83 % of 8 and 79 % of 12: on a long board of close methods some differences are
chance.
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
"""Track -> the metric that ranks."""

UNPREDICTED_WEIGHT = {"union_px": "truth_px"}
"""Key of a metric's weight -> key of the same weight where nothing was predicted: the union of an empty mask with the
truth is the truth."""

REFERENCES = 50
"""Methods, the best placed, against which all others are tested: what is significantly worse than all of them shares
the rank after them. So a board of tens of thousands is ranked within seconds, and one of up to 50 in full."""

BATCH = 256
"""Methods whose resamples are in memory at once: 20 MB."""

Direction = Literal["lower", "higher"]


def direction(key: str) -> Direction:
    """Which values of a metric are better: higher ones, unless it says otherwise."""
    found = find_metric(key)
    return "lower" if found is not None and found.better == "lower" else "higher"


@dataclass(frozen=True)
class Standing:
    """A method among others.

    place: 1 + the number of methods with a better mean; equal means share one. None without a value
    rank:  1 + the number of methods that are significantly better than it, or than one placed above it: the best that
           it may be. None where it has values on too few sequences to say so of any
    worst: the number of methods less those that are significantly worse than it, or than one placed below it: the
           worst that it may be
    """

    place: int | None
    rank: int | None
    worst: int | None


@dataclass(frozen=True)
class SequenceScores:
    """What ranks a method: the mean of its runs on each sequence.

    values:      of the ranking metric, NaN where it has none although the sequence was run
    weights:     of the values in a mean; None where each sequence has one vote
    unpredicted: weights of the sequences where nothing is predicted; empty where each has one vote
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
    def of(cls, scores: Sequence[SequenceScores], sequences: Iterable[str], track: str) -> ScoreTable:
        """The table of a track's ranking metric; a sequence that a method lacks counts as failed, with the weight of
        one where nothing is predicted."""
        names = sorted(sequences)  # the resamples are of sequences in this order, as in `summarise`
        metric = PRIMARY[track]
        found, failed = find_metric(metric), FAILED[track][metric]
        shape = len(scores), len(names)
        values = np.array([[one.values.get(name, failed) for name in names] for one in scores], float).reshape(shape)
        if found is None or not found.weight:
            return cls(values)
        lacking = {name: _unpredicted_weight(scores, name) for name in names}
        weights = [[(one.weights or {}).get(name, lacking[name]) for name in names] for one in scores]
        return cls(values, np.array(weights, float).reshape(shape))

    def take(self, rows: Sequence[int] | NDArray[np.int64] | slice) -> ScoreTable:
        """Some of its methods."""
        return ScoreTable(self.values[rows], None if self.weights is None else self.weights[rows])

    def means(self) -> Array:
        """(R,) means over the sequences that have a value, NaN where none has: to the last digit those of
        `summarise`."""
        found = []
        for k, row in enumerate(self.values):
            known = ~np.isnan(row)
            weights = None if self.weights is None else self.weights[k][known]
            found.append(mean_of(row[known], weights) if known.any() else math.nan)
        return np.array(found, float)

    def intervals(self) -> Array:
        """(R, 2) low and high of the means, NaN where there is none."""
        found = [np.empty((0, 2))]
        for start in range(0, len(self.values), BATCH):
            part = self.take(slice(start, start + BATCH))
            found.append(bootstrap_intervals(part.values, part.weights))
        return np.concatenate(found)

    def standings(self, better: Direction) -> list[Standing]:
        """Of each method, in the order of the table."""
        means = self.means() * (-1 if better == "higher" else 1)
        order = np.argsort(means, kind="stable")[: np.count_nonzero(~np.isnan(means))]
        if not len(order):
            return [Standing(None, None, None)] * len(means)
        places = 1 + np.searchsorted(means[order], means[order])
        above, below = self.take(order)._significant(better)
        # Equal means are one step of the stairs: the rank of the last of them, and the worst of the first, is all's.
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
        """(R,) how many of the first `REFERENCES` methods are significantly better than each, and how many methods are
        significantly worse than each, of methods in the order of their means."""
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
            if above[rows].max() == REFERENCES:  # no rank below is better, and none can be worse
                break
        return above, below


def _unpredicted_weight(scores: Sequence[SequenceScores], name: str) -> float:
    """Of a sequence where nothing is predicted: as any method knows it, or at most the least weight that one has."""
    known = [one.unpredicted[name] for one in scores if one.unpredicted and name in one.unpredicted]
    least = [one.weights[name] for one in scores if one.weights and name in one.weights]
    return min([value for value in known if not math.isnan(value)] or least or [0.0])
