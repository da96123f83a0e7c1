"""Comparison of methods: standings with ties, pairwise comparisons, and both again within each class of conditions."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from itertools import combinations
from typing import Any

import numpy as np

from oysterbench.core.errors import ResultError
from oysterbench.evaluate.conditions import CONDITIONS, STRATA
from oysterbench.evaluate.metrics import TRACKS
from oysterbench.evaluate.statistics import (
    Comparison,
    Sample,
    Summary,
    compare,
    sequence_weights,
    summarise,
    weighed_means,
)
from oysterbench.results.labels import few, method_labels
from oysterbench.results.lost import kept_median
from oysterbench.results.records import (
    ResultRecord,
    comparable_key,
    lost_of,
    mean_weights,
    method_key,
    plain,
    samples,
)
from oysterbench.results.standings import PRIMARY, ScoreTable, SequenceScores, Standing, direction


@dataclass(frozen=True)
class MethodRuns:
    """A method with its settings: a label that is unique on its board, and all its runs."""

    label: str
    records: tuple[ResultRecord, ...]

    @property
    def failures(self) -> int:
        """Number of runs that produced nothing that could be scored."""
        return sum(record.failure is not None for record in self.records)

    def sample(self, key: str, sequences: Iterable[str]) -> Sample:
        """Values of a metric on some sequences."""
        found = samples(self.records, key)
        return {name: found[name] for name in sequences if name in found}

    def weights(self, key: str, sequences: Iterable[str]) -> Sample | None:
        """Weights of the same values in a mean; None where each sequence has one vote."""
        found = mean_weights(self.records, key)
        return None if found is None else {name: found[name] for name in sequences if name in found}

    def summary(self, key: str, sequences: Iterable[str]) -> Summary:
        """Summarise a metric over the given sequences."""
        names = list(sequences)
        return summarise(self.sample(key, names), self.weights(key, names))

    def over(self, key: str, sequences: Iterable[str], summary: Summary | None = None) -> float:
        """Aggregate a metric over the given sequences: the mean or, for an error, the median over those that are not
        lost. summary: the summary of the same metric and sequences, if it is known already."""
        names = list(sequences)
        if key in TRACKS[self.records[0].track].errors:
            return kept_median(self.sample(key, names), lost_of(self.records) or ())
        return (self.summary(key, names) if summary is None else summary).mean

    def means(self, key: str) -> Mapping[str, float]:
        """Sequence -> mean of a metric over the runs that have a value, as in the standings."""
        return weighed_means(samples(self.records, key), mean_weights(self.records, key))

    def scores(self, key: str, sequences: Iterable[str]) -> SequenceScores:
        """Scores that rank the method by a metric on the given sequences."""
        names = list(sequences)
        sample, weights = self.sample(key, names), self.weights(key, names)
        values = {**dict.fromkeys(names, math.nan), **weighed_means(sample, weights)}
        return SequenceScores(values, None if weights is None else sequence_weights(sample, weights))

    def compare(self, other: MethodRuns, key: str, sequences: Iterable[str]) -> Comparison:
        """Compute by how much it is better than another in a metric, on those sequences where both have a value."""
        names = list(sequences)
        own, others = self.weights(key, names), other.weights(key, names)
        weights = None if own is None or others is None else (own, others)
        return compare(self.sample(key, names), other.sample(key, names), direction(key), weights)


@dataclass(frozen=True)
class RankedMethod:
    """A row of the standings; coverage is shown beside every error.

    over: each metric over all sequences (`MethodRuns.over`); lost: how many of these are lost, None if the track does
    not define lost sequences
    """

    label: str
    standing: Standing
    summaries: Mapping[str, Summary]
    over: Mapping[str, float]
    runs: int
    failures: int
    lost: int | None


@dataclass(frozen=True)
class MethodPair:
    """Comparison of two methods: where (in a class of conditions, or everywhere) and by how much a is better than b."""

    a: str
    b: str
    condition: str
    value: str
    comparison: Comparison


@dataclass(frozen=True)
class SequenceRuns:
    """One method on one sequence: the median and range of a metric over its runs."""

    label: str
    sequence: str
    runs: int
    failures: int
    median: float
    low: float
    high: float
    coverage: float


@dataclass(frozen=True)
class Board:
    """Results that may be compared with each other: one track, split, evaluator and setting.

    apart:     what distinguishes it from other boards of the same split; empty if there are none
    sequences: those that every method was run on; standings and pairs cover only these
    left_out:  those that at least one method was not run on
    """

    track: str
    split: str
    split_digest: str
    evaluator_version: str
    settings: Mapping[str, Any]
    entries: tuple[MethodRuns, ...]
    given: tuple[ResultRecord, ...]
    sequences: tuple[str, ...]
    left_out: tuple[str, ...]
    apart: str = ""

    @property
    def records(self) -> list[ResultRecord]:
        """All its records, each with the method's label as the method name, in the order given."""
        labels = {id(record): entry.label for entry in self.entries for record in entry.records}
        return [replace(record, method=labels[id(record)]) for record in self.given]

    @property
    def metric(self) -> str:
        """Key of the ranking metric."""
        return PRIMARY[self.track]

    @cached_property
    def keys(self) -> list[str]:
        """Keys of all metrics that any record holds."""
        return list(dict.fromkeys(key for entry in self.entries for record in entry.records for key in record.metrics))

    @cached_property
    def standings(self) -> list[RankedMethod]:
        """Methods in order of place, those without a value last."""
        scores = [entry.scores(self.metric, self.sequences) for entry in self.entries]
        found = []
        standings = ScoreTable.of(scores, self.sequences, self.track).standings(direction(self.metric))
        for entry, standing in zip(self.entries, standings, strict=True):
            chosen = [record for record in entry.records if record.sequence in self.sequences]
            summaries = {key: entry.summary(key, self.sequences) for key in self.keys}
            failures = sum(record.failure is not None for record in chosen)
            over = {key: entry.over(key, self.sequences, summary) for key, summary in summaries.items()}
            lost = lost_of(chosen)
            count = None if lost is None else len(lost)
            found.append(RankedMethod(entry.label, standing, summaries, over, len(chosen), failures, count))
        return sorted(found, key=lambda row: row.standing.place or math.inf)

    @cached_property
    def pairs(self) -> list[MethodPair]:
        """Comparisons of every two methods, the better placed first: over all sequences, and within each class of
        conditions.

        A condition with only one class is left out, since that class is everywhere.
        """
        labels = [row.label for row in self.standings]
        by_place = zip(*(self.compare(a, b) for a, b in combinations(labels, 2)), strict=True)
        return [pair for pairs in by_place for pair in pairs]

    def compare(self, a: str, b: str) -> list[MethodPair]:
        """Compare two methods, given by their labels: over all sequences, and within each class of conditions where
        there are several."""
        places = [("", "", self.sequences)]
        places += [(key, name, names) for key in STRATA for name, names in self.classes(key).items()]
        of_a, of_b = self.runs_of(a), self.runs_of(b)
        return [MethodPair(a, b, key, value, of_a.compare(of_b, self.metric, names)) for key, value, names in places]

    def classes(self, condition: str) -> dict[str, tuple[str, ...]]:
        """Sequences grouped by their class of a condition; empty if all are of one class, or if the class of any is
        unknown."""
        known = {name: self.conditions(name).get(condition) for name in self.sequences}
        values = sorted({str(value) for value in known.values() if value is not None})
        if None in known.values() or len(values) < 2:
            return {}
        return {value: tuple(name for name in self.sequences if str(known[name]) == value) for value in values}

    def strata(self, condition: str) -> list[tuple[str, str, Summary]]:
        """Class, method and summary of the ranking metric, where there are several classes."""
        return [
            (value, row.label, self.runs_of(row.label).summary(self.metric, names))
            for value, names in self.classes(condition).items()
            for row in self.standings
        ]

    def conditions(self, sequence: str) -> Mapping[str, float | str]:
        """Conditions of a sequence."""
        records = (record for entry in self.entries for record in entry.records if record.sequence == sequence)
        return next((record.conditions for record in records if record.conditions), {})

    def varying(self) -> dict[str, dict[str, float]]:
        """Numeric conditions that differ between sequences: key -> sequence -> value."""
        found = {}
        for key in CONDITIONS:
            values = {name: self.conditions(name).get(key) for name in (*self.sequences, *self.left_out)}
            numbers = {name: float(v) for name, v in values.items() if isinstance(v, int | float)}
            if len(numbers) > 1 and len(set(numbers.values())) > 1:
                found[key] = numbers
        return found

    def cells(self, key: str | None = None) -> list[SequenceRuns]:
        """Median and range of a metric (by default the ranking one) over the runs of each method on each sequence."""
        key = key or self.metric
        found = []
        for name in (*self.sequences, *self.left_out):
            for row in self.standings:
                records = [record for record in self.runs_of(row.label).records if record.sequence == name]
                if not records:
                    continue
                median, low, high = _median_and_range([record.metrics.get(key, math.nan) for record in records])
                coverage = _median_and_range([record.metrics.get("coverage", math.nan) for record in records])[0]
                failures = sum(record.failure is not None for record in records)
                found.append(SequenceRuns(row.label, name, len(records), failures, median, low, high, coverage))
        return found

    def runs_of(self, label: str) -> MethodRuns:
        """Runs of the method with this label."""
        return next(entry for entry in self.entries if entry.label == label)

    @property
    def name(self) -> str:
        """What the methods were run on, for a heading."""
        return self._base + (f" ({self.apart})" if self.apart else "")

    @property
    def _base(self) -> str:
        return self.split or ", ".join((*self.sequences, *self.left_out))


def _median_and_range(values: Sequence[float]) -> tuple[float, float, float]:
    known = [value for value in values if not math.isnan(value)]
    return (float(np.median(known)), min(known), max(known)) if known else (math.nan,) * 3


def boards(records: Iterable[ResultRecord]) -> list[Board]:
    """Sort records into boards, in order of first appearance; a record that is given twice counts once, even if
    it was computed again elsewhere, with the same numbers.

    Raises ResultError where one sequence was scored against two ground truths, and for a track without a ranking
    metric.
    """
    groups: dict[tuple[str, ...], list[ResultRecord]] = {}
    for record in _distinct(list(records)):
        groups.setdefault(comparable_key(record), []).append(record)
    found = [_board(group) for group in groups.values()]
    return [replace(board, apart=_apart(board, found)) for board in found]


def _distinct(records: Sequence[ResultRecord]) -> Iterator[ResultRecord]:
    """The records without those that another one equals but for when and where it was computed. Only records of one run
    are written as text and compared, as that takes longer than all else."""
    counts, seen = Counter(map(_run, records)), set[str]()
    for record in records:
        text = replace(record, created="", hardware={}).to_json() if counts[_run(record)] > 1 else ""
        if text not in seen:
            yield record
        if text:
            seen.add(text)


def _run(record: ResultRecord) -> tuple[str | int, ...]:
    return record.track, record.split, record.sequence, record.method, record.run


def _apart(board: Board, found: Sequence[Board]) -> str:
    """What distinguishes a board from others of the same name."""
    others = [other for other in found if other is not board and other.name == board.name]
    parts = []
    if any(other.split_digest != board.split_digest for other in others):
        parts.append(f"recipe {board.split_digest[:8]}")
    if any(other.evaluator_version != board.evaluator_version for other in others):
        parts.append(board.evaluator_version)
    alike = [other for other in others if other.track == board.track]  # settings of another track differ anyway
    parts += [f"{k} = {v}" for k, v in board.settings.items() if any(other.settings.get(k) != v for other in alike)]
    return few(parts)


def _board(records: Sequence[ResultRecord]) -> Board:
    first = records[0]
    if first.track not in PRIMARY:
        raise ResultError(f"track {first.track!r}: expected one of {', '.join(PRIMARY)}, which have a ranking metric")
    truths: dict[str, set[str]] = {}
    for record in records:
        truths.setdefault(record.sequence, set()).add(record.truth_digest)
    for name, digests in truths.items():
        if len(digests - {""}) > 1:
            raise ResultError(
                f"sequence {name!r} was scored against {len(digests - {''})} different truths: expected one sequence "
                "per name; compare fewer results, or score again, from truth files with different names if they are "
                "different sequences"
            )
    by_method: dict[tuple[str, str], list[ResultRecord]] = {}
    for record in records:
        by_method.setdefault(method_key(record), []).append(record)
    labels = method_labels(list(by_method))
    entries = tuple(MethodRuns(labels[key], tuple(group)) for key, group in by_method.items())
    run_on = [{record.sequence for record in entry.records} for entry in entries]
    shared = set.intersection(*run_on)
    return Board(
        first.track,
        first.split,
        first.split_digest,
        first.evaluator_version,
        first.settings,
        entries,
        tuple(records),
        tuple(name for name in truths if name in shared),
        tuple(name for name in truths if name not in shared),
    )


def per_sequence(board: Board) -> list[dict[str, Any]]:
    """Results of each method on each sequence with the sequence's conditions, as in `as_plain`."""
    return [{**asdict(cell), "conditions": board.conditions(cell.sequence)} for cell in board.cells()]


def as_plain(board: Board) -> dict[str, Any]:
    """Convert a board to plain values for JSON; numbers that do not exist are null, with the reason beside them."""

    def pair(found: MethodPair) -> dict[str, Any]:
        return {**{key: getattr(found, key) for key in ("a", "b", "condition", "value")}, **asdict(found.comparison)}

    document: dict[str, Any] = plain(
        {
            "track": board.track,
            "split": board.split,
            "split_digest": board.split_digest,
            "evaluator_version": board.evaluator_version,
            "settings": board.settings,
            "metric": board.metric,
            "sequences": board.sequences,
            "left_out": board.left_out,
            "standings": [
                {
                    "method": row.label,
                    **asdict(row.standing),
                    "runs": row.runs,
                    "failures": row.failures,
                    "lost": row.lost,
                    "metrics": row.over,
                    "statistics": {key: asdict(summary) for key, summary in row.summaries.items()},
                }
                for row in board.standings
            ],
            "pairs": [pair(found) for found in board.pairs],
            "strata": [
                {"condition": condition, "value": value, "method": label, **asdict(summary)}
                for condition in STRATA
                for value, label, summary in board.strata(condition)
            ],
            "per_sequence": per_sequence(board),
        }
    )
    return document
