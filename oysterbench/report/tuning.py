"""The trials of a search over a method's options."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from statistics import fmean

from oysterbench.evaluate.metrics import FAILED, find_metric
from oysterbench.report.table import Column, Table, TableRow
from oysterbench.results.records import ResultRecord
from oysterbench.results.standings import PRIMARY

SHOWN = 10


def mean_scores(records: Sequence[ResultRecord], names: Mapping[str, str]) -> dict[str, float]:
    """Mean of the track's ranking metric over the runs of each trial; a failed run counts as one that estimates
    nothing. NaN if there are no runs."""
    found: dict[str, list[float]] = {name: [] for name in names}
    for record in records:
        if record.method in found:
            metric = PRIMARY[record.track]
            found[record.method].append(record.metrics.get(metric, FAILED[record.track][metric]))
    return {name: fmean(scores) if scores else math.nan for name, scores in found.items()}


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
