"""The order of a board: means with intervals, places, and groups that share a rank because nothing tells them apart.

The numbers are those of `oysterbench.evaluate.statistics` on the same sequences; here they are had for thousands of
records at once. Walking down the board, each record is held against the first of its group by a paired bootstrap over
sequences; the first that is told from it at 95 % opens the next group. So a board of R records takes R comparisons and
not R^2, and a group's records have one rank, which is what a reader takes from a table. Being told apart is not
transitive: the last of a group may well be told from its second; `oysterbench compare` answers that.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from types import MappingProxyType
from typing import Any, Literal

import numpy as np
from scipy.stats import norm, t

from oysterbench.core.geometry import Array
from oysterbench.evaluate.metrics import FAILED, find_metric
from oysterbench.evaluate.statistics import LEVEL, TIE, compare, resample_counts, summarise
from oysterbench.results.comparison import PRIMARY

MISSED = {"union_px": "truth_px"}
"""Key of a metric's weight -> key of the same weight where nothing was answered: the union of an empty mask with the
truth is the truth."""

BATCH = 256
"""Records whose resamples are in memory at once: 20 MB."""

FIRST_LOOK = 8
"""Records that are held against a new leader at once; each look after that takes twice as many."""

Intervals = Mapping[str, tuple[float, float]]
"""Digest -> low and high, NaN where there is none."""

Map = Callable[[Callable[[Any], Any], Iterable[Any]], Iterable[Any]]
"""As the built-in `map`: in order, here or in other processes."""


@dataclass(frozen=True)
class Answers:
    """What ranks a record: the mean of its runs on each sequence that it has.

    values:  of the ranking metric, NaN where there is none
    weights: of the values in a mean; None where each sequence has one vote
    missed:  what would weigh on a sequence where nothing is answered; empty where each has one vote
    """

    digest: str
    values: Mapping[str, float]
    weights: Mapping[str, float] | None = None
    missed: Mapping[str, float] | None = None

    def answers_all(self, names: Iterable[str]) -> bool:
        """Whether it has a value, and a weight where values have one, on each of these sequences."""
        return all(name in self.values and (self.weights is None or name in self.weights) for name in names)


@dataclass(frozen=True)
class Standing:
    """Of a record on its board; see `board.Row` for place and rank. NaN where there is no score or no interval."""

    digest: str
    place: int | None
    rank: int | None
    score: float
    low: float
    high: float


def standings(
    answers: Iterable[Answers],
    sequences: Sequence[str],
    track: str,
    ranked: Iterable[str],
    using: Map = map,
    known_intervals: Intervals = MappingProxyType({}),
) -> list[Standing]:
    """All records in the board's order: those that are ranked first, by their score, equal ones by digest.

    sequences: of the board; a record that lacks one failed there
    ranked:    digests of the records that have a place; the others have a score alone, and follow in their own order
    using:     runs the intervals, batch by batch
    known_intervals: of records on a board of the same sequences, from before; those of records that answer all of them
               hold whatever else is on the board, and take longer than all else
    """
    metric = PRIMARY[track]
    found = find_metric(metric)
    assert found is not None
    better: Literal["lower", "higher"] = "lower" if found.better == "lower" else "higher"
    names = sorted(sequences)  # as `statistics.sequence_means` has them: the resamples are of sequences in this order
    known = sorted(answers, key=lambda one: one.digest)
    table = Table.of(known, names, FAILED[track][metric], bool(found.weight))
    scores, chosen = table.means(), set(ranked)

    sign = -1 if better == "higher" else 1
    has_place = [one.digest in chosen and not math.isnan(score) for one, score in zip(known, scores, strict=True)]
    keys = (sign * scores).tolist()
    order = sorted(
        range(len(known)),
        key=lambda i: (not has_place[i], math.isnan(keys[i]), 0.0 if math.isnan(keys[i]) else keys[i], known[i].digest),
    )
    table, scores = table.take(order), scores[order]
    count = sum(has_place)
    intervals = np.full((len(order), 2), np.nan)
    wanted = []
    for k, i in enumerate(order):
        if known[i].digest in known_intervals and known[i].answers_all(names):
            intervals[k] = known_intervals[known[i].digest]
        else:
            wanted.append(k)
    batches = [wanted[i : i + BATCH] for i in range(0, len(wanted), BATCH)]
    for rows, found_here in zip(batches, using(Table.intervals, map(table.take, batches)), strict=True):
        intervals[rows] = found_here
    places = _places(scores[:count])
    ranks = _ranks(table.take(range(count)), places, better)
    return [
        Standing(
            known[i].digest,
            places[k] if k < count else None,
            ranks[k] if k < count else None,
            float(scores[k]),
            *map(float, intervals[k]),
        )
        for k, i in enumerate(order)
    ]


def _places(scores: Array) -> list[int]:
    """1 + the number of better scores, of scores (R,) in order: equal ones share the place of the first."""
    places: list[int] = []
    for k, score in enumerate(scores.tolist()):
        places.append(places[-1] if k and score == scores[k - 1] else k + 1)
    return places


def _ranks(table: Table, places: Sequence[int], better: Literal["lower", "higher"]) -> list[int | None]:
    """Place of the first of each record's group; None where there are too few sequences to tell any apart."""
    count = len(places)
    if table.shares is None:
        return [None] * count
    ranks: list[int | None] = []
    leader = 0
    while leader < count:
        ranks.append(places[leader])
        low, look, end = leader + 1, FIRST_LOOK, count
        while low < count:
            told = table.told(leader, low, min(low + look, count), better)
            if told.any():
                end = low + int(np.argmax(told))
                break
            low, look = low + look, min(2 * look, BATCH)
        ranks += [places[leader]] * (end - leader - 1)
        leader = end
    return ranks


@dataclass(frozen=True)
class Table:
    """Values (R, n) of R records on the n sequences of a board, NaN where there is none, and their weights (R, n)."""

    names: tuple[str, ...]
    values: Array
    weights: Array | None

    @classmethod
    def of(cls, answers: Sequence[Answers], names: Sequence[str], failed: float, weighed: bool) -> Table:
        """The table of some answers; what a record lacks counts as `failed`, with the weight of a missed sequence."""
        values = np.array([[one.values.get(name, failed) for name in names] for one in answers], float)
        values = values.reshape(len(answers), len(names))
        if not weighed:
            return cls(tuple(names), values, None)
        missed = {name: _missed_weight(answers, name) for name in names}
        weights = np.array(
            [[(one.weights or {}).get(name, missed[name]) for name in names] for one in answers], float
        ).reshape(values.shape)
        return cls(tuple(names), values, weights)

    def take(self, rows: Sequence[int]) -> Table:
        """Some of its rows."""
        chosen = np.asarray(rows, int)
        return Table(self.names, self.values[chosen], None if self.weights is None else self.weights[chosen])

    @property
    def shares(self) -> Array | None:
        """(RESAMPLES, n) share of each sequence in each resample; None where there are too few sequences."""
        return _shares(len(self.names))

    @property
    def whole(self) -> Any:
        """(R,) bool: which records have a value on every sequence."""
        return ~np.isnan(self.values).any(axis=1)

    def means(self) -> Array:
        """(R,) as `statistics.summarise` has them."""
        if self.weights is None:
            return np.array([_mean([v for v in row if not math.isnan(v)]) for row in self.values.tolist()])
        rows = zip(self.values.tolist(), self.weights.tolist(), strict=True)
        return np.array([_weighed_mean([(v, w) for v, w in zip(*row, strict=True) if v == v]) for row in rows])

    def intervals(self) -> Array:
        """(R, 2) low and high of the means, NaN where there is none, as `statistics.summarise` has them."""
        found = np.full((len(self.values), 2), np.nan)
        shares, whole = self.shares, self.whole
        if shares is not None and whole.any():
            drawn = self._resampled(np.flatnonzero(whole), shares)
            found[whole] = np.quantile(drawn, _tails(len(self.names)), axis=1).T
        for k in np.flatnonzero(~whole):
            interval = summarise(*self._samples(int(k))).interval
            found[k] = (interval.low, interval.high)
        return np.array([[float(f"{value:.12g}") for value in row] for row in found.tolist()]).reshape(found.shape)

    def told(self, leader: int, start: int, end: int, better: Literal["lower", "higher"]) -> Any:
        """(end - start,) bool: whether each of these records is told from the leader, as `statistics.compare` says."""
        shares, whole = self.shares, self.whole
        assert shares is not None
        rows = np.arange(start, end)
        told = np.zeros(len(rows), bool)
        fast = whole[rows] & whole[leader]
        if fast.any():
            told[fast] = _off_zero(self._differences(leader, rows[fast], shares), len(self.names))
        for k in np.flatnonzero(~fast):
            told[k] = self._told_one_by_one(leader, int(rows[k]), better)
        return told

    def _resampled(self, rows: Any, shares: Array) -> Array:
        """(len(rows), RESAMPLES) means; the plain one where the weights of a resample are all 0."""
        values = self.values[rows]
        plain = values @ shares.T
        if self.weights is None:
            return plain
        weights = self.weights[rows]
        total = weights @ shares.T
        known = total > 0
        return np.where(known, ((weights * values) @ shares.T) / np.where(known, total, 1.0), plain)

    def _differences(self, leader: int, rows: Any, shares: Array) -> Array:
        """(len(rows), RESAMPLES) differences of the leader's mean from each record's."""
        if self.weights is not None:
            return self._resampled(np.array([leader]), shares) - self._resampled(rows, shares)
        a, b = self.values[leader], self.values[rows]
        equal = np.abs(a - b) <= TIE * np.maximum(np.abs(a), np.abs(b))
        return np.where(equal, 0.0, a - b) @ shares.T

    def _samples(self, row: int) -> tuple[dict[str, list[float]], dict[str, list[float]] | None]:
        values = {name: [float(v)] for name, v in zip(self.names, self.values[row], strict=True)}
        if self.weights is None:
            return values, None
        return values, {name: [float(w)] for name, w in zip(self.names, self.weights[row], strict=True)}

    def _told_one_by_one(self, a: int, b: int, better: Literal["lower", "higher"]) -> bool:
        (of_a, weights_a), (of_b, weights_b) = self._samples(a), self._samples(b)
        weights = None if weights_a is None or weights_b is None else (weights_a, weights_b)
        return compare(of_a, of_b, better, weights).verdict != "not significantly different"


@lru_cache(maxsize=4)
def _shares(n: int) -> Array | None:
    counts = resample_counts(n)
    return None if counts is None else counts / n


def _missed_weight(answers: Sequence[Answers], name: str) -> float:
    """Of a sequence where nothing is answered: as any record knows it, or at most what the least answer weighs."""
    known = [one.missed[name] for one in answers if one.missed and not math.isnan(one.missed.get(name, math.nan))]
    least = [one.weights[name] for one in answers if one.weights and name in one.weights]
    return min(known or least or [0.0])


def _mean(values: Sequence[float]) -> float:
    return math.fsum(values) / len(values) if values else math.nan


def _weighed_mean(pairs: Sequence[tuple[float, float]]) -> float:
    if not any(w for _, w in pairs):
        return _mean([v for v, _ in pairs])
    return math.fsum(v * w for v, w in pairs) / math.fsum(w for _, w in pairs)


def _tails(n: int) -> tuple[float, float]:
    """Quantiles of the resamples of n sequences between which the mean lies: expanded percentiles (Hesterberg 2015), as
    `statistics.resampled_interval` takes them."""
    tail = float(norm.cdf(-math.sqrt(n / (n - 1)) * t.ppf(0.5 + LEVEL / 2, n - 1)))
    return tail, 1 - tail


def _off_zero(differences: Array, n: int) -> Any:
    """(R,) bool: whether the interval of each row (R, RESAMPLES) leaves zero out.

    A quantile lies between two neighbours of the sorted values: where both have one sign, so has it, and counting is
    enough. Only where zero falls between just these two is it computed.
    """
    tails = _tails(n)
    neighbour = math.floor(tails[0] * (differences.shape[1] - 1))
    beyond = np.array([np.count_nonzero(differences <= 0, axis=1), np.count_nonzero(differences >= 0, axis=1)])
    told = (beyond <= neighbour).any(axis=0)
    for k in np.flatnonzero((beyond == neighbour + 1).any(axis=0) & ~told):
        low, high = np.quantile(differences[k], tails)
        told[k] = low > 0 or high < 0
    return told
