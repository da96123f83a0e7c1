"""The trials of a search over a method's options."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

from oysterbench.evaluate.metrics import find_metric
from oysterbench.evaluate.statistics import mean_over_sequences
from oysterbench.report.table import Column, Table, TableRow
from oysterbench.results.records import ResultRecord, mean_weights, samples
from oysterbench.results.standings import PRIMARY

SHOWN = 10


def mean_scores(records: Sequence[ResultRecord], names: Mapping[str, str]) -> dict[str, float]:
    """Mean of the track's ranking metric over the sequences, for each trial, as methods are ranked: a failed run counts
    as one that estimates nothing, and a sequence on which the metric has no value in no mean. NaN if there is none, or
    where a trial lacks a run on a sequence that others ran on, as it may be a hard one."""
    found: dict[str, list[ResultRecord]] = {name: [] for name in names}
    for record in records:
        if record.method in found:
            found[record.method].append(record)
    sequences = {record.sequence for of_trial in found.values() for record in of_trial}
    return {name: _mean_score(of_trial, sequences) for name, of_trial in found.items()}


def _mean_score(records: Sequence[ResultRecord], sequences: set[str]) -> float:
    if not records or {record.sequence for record in records} != sequences:
        return math.nan
    metric = PRIMARY[records[0].track]
    return mean_over_sequences(samples(records, metric), mean_weights(records, metric))


def ranking_heading(track: str) -> str:
    """Heading of the ranking metric of a track."""
    metric = find_metric(PRIMARY[track], track)
    assert metric is not None
    assert metric.column is not None
    return metric.column.heading


def best_of(records: Sequence[ResultRecord], names: Mapping[str, str]) -> tuple[str, float]:
    """Name and mean score of the best trial; of equal ones, the first."""
    means = mean_scores(records, names)
    return max(means.items(), key=lambda item: -math.inf if math.isnan(item[1]) else item[1])


def trials_table(records: Sequence[ResultRecord], names: Mapping[str, str]) -> Table:
    """Table of the best trials, and the first, which is the method with its defaults. names: method -> reference"""
    heading = ranking_heading(records[0].track) if records else "score"
    means = mean_scores(records, names)
    order = sorted(means, key=lambda name: math.inf if math.isnan(means[name]) else -means[name])
    first = next(iter(names))
    chosen = order[:SHOWN] if first in order[:SHOWN] else [*order[:SHOWN], first]
    failures = {name: sum(r.method == name and r.failure is not None for r in records) for name in names}
    columns = (
        Column("trial", "Trial", kind="number", digits=0),
        Column("score", heading[0].upper() + heading[1:], kind="number", digits=3, better="higher"),
        Column("failures", "Failures", kind="number", digits=0, better="lower"),
        Column("reference", "Options"),
    )
    numbers = {name: number for number, name in enumerate(names)}
    rows = []
    for name in chosen:
        options = names[name].partition("[")[2].removesuffix("]").replace(",", ", ") or "as it is"
        rows.append(TableRow((numbers[name], means[name], failures[name], options)))
    return Table(
        "Trials", columns, tuple(rows), (f"The best of {len(names)} trials; 0 is the method with its defaults.",)
    )
