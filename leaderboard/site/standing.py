"""A record's results on the sequences of a board, including those for which it has none."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from types import MappingProxyType

from oysterbench.evaluate.metrics import find_metric
from oysterbench.evaluate.statistics import sequence_means
from oysterbench.results.comparison import Board, boards
from oysterbench.results.records import ResultRecord, samples
from oysterbench.results.standings import PRIMARY, UNPREDICTED_WEIGHT
from oysterbench_leaderboard.storage.record import Record

NOT_ANSWERED = "was not answered"


def named(record: Record, label: str) -> tuple[ResultRecord, ...]:
    """A record's results under one label, with the settings of the method dropped."""
    return tuple(replace(result, method=label, method_settings={}) for result in record.results)


def filled(
    results: Sequence[ResultRecord],
    sequences: Sequence[str],
    known: Sequence[ResultRecord],
    lowest: Mapping[str, float] = MappingProxyType({}),
) -> tuple[ResultRecord, ...]:
    """The results on the sequences of a board, with a failed run added for each that has none, which is how the board
    ranks them.

    known: results of others, which give the conditions of such a sequence, and its weight in a mean
    lowest: `Site.lowest_scores`
    """
    answered = {result.sequence for result in results}
    missing = []
    for sequence in sequences:
        if sequence in answered:
            continue
        like = next((other for other in known if other.sequence == sequence), None)
        missing.append(
            replace(
                results[0],
                sequence=sequence,
                metrics={PRIMARY[results[0].track]: lowest[sequence]} if sequence in lowest else {},
                reasons={},
                failure=NOT_ANSWERED,
                conditions=like.conditions if like else {},
                truth_digest=like.truth_digest if like else "",
                run=0,
                notes=(),
                info={},
            )
        )
    return weighed((*(result for result in results if result.sequence in sequences), *missing), known)


def weighed(results: Sequence[ResultRecord], known: Sequence[ResultRecord]) -> tuple[ResultRecord, ...]:
    """The same results, with the weights added by which failed runs count in a mean: those of a sequence without any
    estimate, taken from another result on it."""
    found = []
    for result in results:
        lacking = {}
        for key in result.metrics if result.failure is not None else ():
            metric = find_metric(key)
            if metric is not None and metric.weight and metric.weight not in result.metrics:
                lacking[metric.weight] = _weight(metric.weight, result.sequence, (*results, *known))
        found.append(replace(result, metrics={**result.metrics, **lacking}) if lacking else result)
    return tuple(found)


def _weight(key: str, sequence: str, known: Sequence[ResultRecord]) -> float:
    there = [result for result in known if result.sequence == sequence and result.failure is None]
    missed = UNPREDICTED_WEIGHT.get(key, key)
    for result in there:
        if not math.isnan(value := result.metrics.get(missed, math.nan)):
            return value
    return min((result.metrics[key] for result in there if key in result.metrics), default=0.0)


def means(results: Sequence[ResultRecord], key: str) -> Mapping[str, float]:
    """Sequence -> mean of a metric over its runs, for sequences that have a value."""
    return sequence_means(samples(results, key))


def board(results: Sequence[ResultRecord]) -> Board:
    """All results as one board, as `oysterbench compare` would make it."""
    return boards(results)[0]
