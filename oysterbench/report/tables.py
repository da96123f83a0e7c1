"""Tables of results: by sequence, standings, pairs, classes of conditions, runs. `renderers` writes them."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np

from oysterbench.core.html import capital
from oysterbench.evaluate.conditions import CONDITIONS, STRATA
from oysterbench.evaluate.metrics import TIMES, TRACKS, find_metric
from oysterbench.evaluate.statistics import LEAST_SEQUENCES, LEVEL, Interval, weighed_means
from oysterbench.report.columns import (
    COSTS_OF_TRACK,
    OF_TRACK,
    STANDING_OF_TRACK,
    lost_column,
    lost_note,
    metric_column,
    name_columns,
)
from oysterbench.report.table import Cell, Column, Estimate, Table, TableRow, Value, interval_column
from oysterbench.results.comparison import Board, SequenceRuns, boards
from oysterbench.results.machines import machines_of
from oysterbench.results.records import ResultRecord, aggregate, comparable_key, mean_weights, method_key, samples
from oysterbench.results.remarks import remarks

NO_SENSORS = ("truth", "tf", "tf_static")
"""First parts of topics that are no sensor's."""

COMPLETE = 0.95
"""Share of the highest coverage on a sequence that a run must reach to be called the best there."""


def several_note(records: Sequence[ResultRecord]) -> str:
    """Sentence on what is shown of several runs of a method on a sequence."""
    failed_as = " or ".join(dict.fromkeys(TRACKS[record.track].failed_as for record in records))
    return f"Of several runs, means are shown; a failed one {failed_as}, and has no errors."


def results_table(records: Sequence[ResultRecord]) -> Table:
    """Table with a row per method and sequence, in order of first appearance; aggregates below if there are two or more
    sequences.

    Of several runs of a method on a sequence, the means are shown, as they are ranked.
    """
    order = list(dict.fromkeys(record.sequence for record in records))
    groups: dict[tuple[str, ...], list[ResultRecord]] = {}
    for record in sorted(records, key=lambda record: order.index(record.sequence)):
        groups.setdefault((record.sequence, *method_key(record), *comparable_key(record)), []).append(record)
    columns = OF_TRACK[records[0].track] if records else ()
    costs = COSTS_OF_TRACK[records[0].track] if records else ()
    columns += tuple(column for column in costs if any(column.key in record.metrics for record in records))
    means = [{column.key: _mean(group, column.key) for column in columns} for group in groups.values()]
    several_machines = len(machines_of(records)) > 1
    competing = [column for column in columns if not (several_machines and column.key in TIMES)]
    failed = [sum(record.failure is not None for record in group) for group in groups.values()]
    # What a failed run spent, it spent on nothing: it is shown, but is no record.
    entered = [
        {**of, **{column.key: _mean_of_successes(group, column.key) for column in costs}}
        for of, group in zip(means, groups.values(), strict=True)
    ]
    best = _best([group[0].sequence for group in groups.values()], entered, competing)
    rows = []
    for group, of, entry, failures in zip(groups.values(), means, entered, failed, strict=True):
        sequence = group[0].sequence
        runs = f" ({len(group)} runs{f', {failures} failed' if failures else ''})" if len(group) > 1 else ""
        name = f"{group[0].method}{runs}"
        lost = failures == len(group)
        values = [Cell(of[c.key], kind="best" if entry[c.key] == best.get((sequence, c.key)) else "") for c in columns]
        method = Cell(name, kind="warn", mark="failed") if lost else name
        rows.append(TableRow((sequence, method, *values), "failed" if lost else ""))
    over_all = aggregate(records) if len(order) > 1 else []
    for mean in over_all:
        name = f"mean of {mean['sequences']}" + (f", {mean['failures']} failed" if mean["failures"] else "")
        if mean["lost"] is not None:
            name = f"over {mean['sequences']}" + (f", {len(mean['lost'])} lost" if mean["lost"] else "")
        rows.append(TableRow((name, mean["method"], *(mean["metrics"].get(c.key) for c in columns)), "mean"))
    several = several_note(records) if any(len(group) > 1 for group in groups.values()) else ""
    about = (several, lost_note(records[0].track) if over_all else "")
    notes = tuple(filter(None, (*about, *failures_and_notes(records))))
    return Table("Results", (*name_columns("sequence", "method"), *columns), tuple(rows), notes)


def _mean(records: Sequence[ResultRecord], key: str) -> float:
    """Mean of a metric over the runs of a method on a sequence that have a value, as in the standings; NaN if none
    has."""
    means = weighed_means(samples(records, key), mean_weights(records, key))
    return means.get(records[0].sequence, math.nan)


def _mean_of_successes(records: Sequence[ResultRecord], key: str) -> float:
    """Mean of a metric over those of the runs of a method on a sequence that did not fail; NaN if there is none."""
    done = [record for record in records if record.failure is None]
    return _mean(done, key) if done else math.nan


def _best(
    sequences: Sequence[str], means: Sequence[dict[str, float]], columns: Sequence[Column]
) -> dict[tuple[str, str], float]:
    """Find the best value for each sequence and column, where methods differ and the metric has a direction.

    Only runs with nearly the coverage of the most complete one compete: a low error over the easy part is no record.
    The score accounts for missing coverage, so that all runs compete for it.
    """
    coverages = [1.0 if math.isnan(covered := of.get("coverage", math.nan)) else covered for of in means]
    most: dict[str, float] = {}
    for sequence, coverage in zip(sequences, coverages, strict=True):
        most[sequence] = max(most.get(sequence, 0.0), coverage)
    values: dict[tuple[str, str], list[float]] = {}
    for sequence, coverage, of in zip(sequences, coverages, means, strict=True):
        for column in columns:
            complete = column.key == "score" or coverage >= COMPLETE * most[sequence]
            if complete and column.better and not math.isnan(of[column.key]):
                values.setdefault((sequence, column.key), []).append(of[column.key])
    choose = {column.key: max if column.better == "higher" else min for column in columns}
    return {place: choose[place[1]](found) for place, found in values.items() if min(found) < max(found)}


def failures_and_notes(records: Sequence[ResultRecord]) -> list[str]:
    """Remarks on single runs, in sentences; a sentence shared by several runs appears once."""
    notes = []
    for record in records:
        name = f"{record.method} on {record.sequence}"
        if record.failure is not None:
            notes.append(f"{name} failed: {record.failure}")
        notes += [f"{name}: {note}" for note in record.notes]
    return [*dict.fromkeys(notes), *topics_notes(records), *path_notes(records)]


def topics_notes(records: Sequence[ResultRecord]) -> list[str]:
    """A sentence for each set of sensors to which the files of some runs were cut: who ran on these, and on what."""
    methods: dict[str, list[str]] = {}
    for record in records:
        if topics := record.info.get("topics"):
            sensors = dict.fromkeys(topic.split("/")[1] for topic in topics)
            named = ", ".join(name for name in sensors if name not in NO_SENSORS)
            methods.setdefault(named, []).append(record.method)
    return [
        f"{', '.join(dict.fromkeys(names))}: run on files that have no "
        f"{f'other sensors than {sensors}' if sensors else 'sensors'}"
        for sensors, names in methods.items()
    ]


def path_notes(records: Sequence[ResultRecord]) -> list[str]:
    """One sentence for each method with several paths: which of them is scored, and what the others achieve."""
    methods: dict[tuple[str, ...], list[ResultRecord]] = {}
    for record in records:
        if "paths" in record.info:
            methods.setdefault(method_key(record), []).append(record)
    notes = []
    for (method, *_), group in methods.items():
        scored = " and ".join(dict.fromkeys(str(record.info["paths"]["scored"]) or "first" for record in group))
        reached: dict[str, list[dict[str, float]]] = {}
        for record in group:
            for name, metrics in record.info["paths"]["alternatives"].items():
                if metrics.get("ate_rmse_m") is not None:
                    reached.setdefault(name, []).append(metrics)
        mean = f", mean of {len(group)}" if len(group) > 1 else ""
        others = []
        for name, all_metrics in reached.items():
            nees = [metrics["nees_position"] for metrics in all_metrics if metrics.get("nees_position") is not None]
            trust = f", NEES of position {np.mean(nees):.2g}" if nees else ""
            others.append(f"{name} (ATE {np.mean([each['ate_rmse_m'] for each in all_metrics]):.2g} m{trust}{mean})")
        beside = f"; not scored: {', '.join(others)}" if others else ""
        notes.append(f"{method}: the {scored} path is scored{beside}")
    return notes


def results_tables(records: Sequence[ResultRecord]) -> list[Table]:
    """Results by sequence, in one table per board: what may not be compared is kept in separate tables."""
    found = boards(records)
    if len(found) < 2:
        return [results_table(found[0].records if found else [])]
    return [replace(results_table(board.records), title=f"Results on {board.name}") for board in found]


def standings_table(board: Board) -> Table:
    """Table of methods by the ranking metric, with its interval and spread, and coverage beside the errors."""
    metric, beside = metric_column(board.metric), STANDING_OF_TRACK[board.track]
    rows = []
    for i, row in enumerate(board.standings):
        found = row.summaries.get(board.metric)
        spread = Interval(found.low, found.high) if found is not None and not found.reason else None
        lost = Cell(row.lost, kind="warn" if row.lost else "", about=f"{row.failures} of {row.runs} runs failed")
        rows.append(
            TableRow(
                (
                    _rank(board, i),
                    row.label,
                    found.mean if found is not None else None,
                    found.interval if found is not None else None,
                    spread,
                    *(row.over.get(column.key) for column in beside),
                    Cell(row.failures, f"{row.failures} of {row.runs}") if row.lost is None else lost,
                )
            )
        )
    failed = Column("failed", "Failed", "runs", "number", "failed")
    columns = (
        Column("rank", "Rank", kind="number", short="rank"),
        *name_columns("method"),
        metric,
        interval_column(metric),
        replace(interval_column(metric, "sequences", "Sequences", "from, to"), wide=True),
        *beside,
        failed if TRACKS[board.track].lost_below is None else lost_column(board.track, len(board.sequences)),
    )
    return Table(f"Standings on {board.name}", columns, tuple(rows), tuple(_reading(board)))


def _rank(board: Board, i: int) -> Cell:
    """Cell of the rank, with the worst possible rank; the place in brackets if sequences are too few for ranks."""
    standing = board.standings[i].standing
    if standing.place is None:
        return Cell(None)
    if standing.rank is None or standing.worst is None:
        return Cell(standing.place, f"({standing.place})")
    worst = "" if standing.rank == standing.worst else f"\N{EN DASH}{standing.worst}"
    return Cell(standing.rank, f"{standing.rank}{worst}")


def _reading(board: Board) -> list[str]:
    n = len(board.sequences)
    count = f"{n} sequence{'' if n == 1 else 's'}"
    metric = find_metric(board.metric)
    beside = "coverage and " if "coverage" in TRACKS[board.track].standing else ""
    failed_as = TRACKS[board.track].failed_as
    notes = [
        f"Means over {count}, each the mean of its runs; a failed run {failed_as}, and errors cover the runs that have "
        f"one: read them together with {beside}failures."
    ]
    if lost := lost_note(board.track):
        notes = [f"Means over {count}, each the mean of its runs; a failed run {failed_as}. {lost}"]
    if metric is not None and metric.weight:
        notes = [f"{metric.heading} is computed over all pixels of {count}; a failed run finds nothing."]
    if any(row.standing.rank is not None for row in board.standings):
        notes.append(
            f"A rank is a range where methods are not significantly different at {LEVEL:.0%}, by resampling the "
            "differences on the same sequences; each pair separately, without correction for the number of pairs."
        )
    elif len(board.standings) > 1:
        notes.append("Places in brackets are only the order of these means: there are too few sequences for ranks.")
    return notes


def pairs_table(board: Board) -> Table:
    """Table of whether, where and by how much a is better than b; pairs with too few sequences to tell are only
    counted."""
    difference = difference_column(metric_column(board.metric))
    difference = difference.resolving(pair.comparison.interval for pair in board.pairs)
    rows, untold = [], 0
    for pair in board.pairs:
        found = pair.comparison
        if not found.interval.known and (pair.condition or len(board.standings) > 2):
            untold += 1
            continue
        where = f"{CONDITIONS[pair.condition].name}: {pair.value}" if pair.condition else "everywhere"
        values: tuple[Value | Cell, ...] = (
            pair.a,
            pair.b,
            where,
            found.difference,
            found.interval,
            Cell(text=f"{found.wins} / {found.ties} / {found.losses}"),
            found.verdict if found.interval.known else "too few to tell",
        )
        rows.append(TableRow(values, "" if pair.condition else "mean"))
    columns = (
        *name_columns("method", "against", "where"),
        difference,
        interval_column(difference),
        Column("won_tied_lost", "Sequences", "won / tied / lost", "number", "sequences", wide=True),
        *name_columns("verdict"),
    )
    count = "one pair is" if untold == 1 else f"{untold} pairs are"
    notes = (
        (f"{capital(count)} left out: fewer than {LEAST_SEQUENCES} sequences are too few to tell.",) if untold else ()
    )
    return Table(f"Pairs on {board.name}", columns, tuple(rows), notes)


def difference_column(of: Column) -> Column:
    """Make a column for differences between another column's numbers."""
    short = f"{of.short.partition(chr(10))[0]}\ndifference"
    return replace(of, key="difference", heading=f"{of.heading} difference", short=short, signed=True, better="")


def strata_table(board: Board) -> Table:
    """Table with a row per class of conditions and a column per method, for conditions with several classes."""
    metric = metric_column(board.metric)
    labels = [row.label for row in board.standings]
    rows = []
    for condition in STRATA:
        found = {(value, label): summary for value, label, summary in board.strata(condition)}
        for value in dict.fromkeys(value for value, _ in found):
            of_class = [found[value, label] for label in labels]
            estimates = [Estimate(summary.mean, summary.interval) for summary in of_class]
            count = len(board.classes(condition)[value])
            rows.append(TableRow((CONDITIONS[condition].name, value, count, *estimates)))
    unit = f"{metric.heading} {metric.unit}".strip()
    columns = (
        *name_columns("condition", "class"),
        Column("sequences", "Sequences", kind="number", short="sequences"),
        *(replace(metric, key=label, heading=label, short="", unit=unit, kind="estimate") for label in labels),
    )
    note = f"Brackets give the {LEVEL:.0%} interval, where there are enough sequences."
    return Table(f"By conditions on {board.name}", columns, tuple(rows), (note,) if rows else ())


def runs_table(board: Board) -> Table:
    """Table of the median and range over the runs of each method on each sequence with several runs."""
    beside = TRACKS[board.track].beside
    metric, error, coverage = (metric_column(key, track=board.track) for key in (board.metric, beside, "coverage"))
    errors = {(cell.label, cell.sequence): cell for cell in board.cells(beside)}
    rows = []
    for cell in (cell for cell in board.cells() if cell.runs > 1):
        of_error = errors[cell.label, cell.sequence]
        values = (
            *(cell.sequence, cell.label, cell.runs, cell.failures),
            *(cell.median, _range(cell), cell.coverage, of_error.median, _range(of_error)),
        )
        rows.append(TableRow(values, "failed" if cell.failures == cell.runs else ""))
    columns = (
        *name_columns("sequence", "method"),
        Column("runs", "Runs", kind="number", short="runs"),
        Column("failed", "Failed", kind="number", short="failed"),
        _median_column(metric),
        interval_column(metric, f"{metric.key}_range", "from, to", ""),
        replace(_median_column(coverage), wide=True),
        _median_column(error),
        replace(interval_column(error, f"{error.key}_range", "from, to", ""), wide=True),
    )
    note = f"A failed run {TRACKS[board.track].failed_as}; errors cover the runs that have one."
    return Table(f"Runs on {board.name}", columns, tuple(rows), (note,) if rows else ())


def _median_column(of: Column) -> Column:
    short = f"{of.short.partition(chr(10))[0]}\n{f'median {of.unit}'.strip()}"
    return replace(of, heading=f"Median {of.heading}", short=short)


def _range(cell: SequenceRuns) -> Interval:
    return Interval(cell.low, cell.high)


def comparison_tables(records: Sequence[ResultRecord]) -> list[Table]:
    """Tables of standings, pairs, classes and runs of every board, each where it has something to show."""
    found = boards(records)
    tables = []
    for board in found:
        if len(board.standings) > 1 or len(board.sequences) > 1:
            tables.append(standings_table(board))
        tables += _with_rows(make(board) for make in (pairs_table, strata_table, runs_table))
    if tables and (notes := remarks(found)):
        tables[0] = replace(tables[0], notes=(*notes, *tables[0].notes))
    return tables


def _with_rows(tables: Iterable[Table]) -> list[Table]:
    return [table for table in tables if table.rows]
