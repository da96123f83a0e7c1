"""Tables as data: results by sequence, standings, pairs and classes. `formats` writes them, in whatever form."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from oysterbench.evaluate.conditions import CONDITIONS, STRATA
from oysterbench.evaluate.metrics import find_metric
from oysterbench.evaluate.statistics import LEVEL, Interval
from oysterbench.report.columns import (
    ABSENT,
    COLUMNS,
    ERROR_OF_TRACK,
    OF_TRACK,
    STANDING_OF_TRACK,
    Column,
    find_column,
)
from oysterbench.results.comparison import Board, Cell, boards, remarks
from oysterbench.results.records import ResultRecord, aggregate, comparable_key, method_key

COMPLETE = 0.95
"""Of the highest coverage on a sequence: what a run must answer to be called the best there."""

MINUS = "\N{MINUS SIGN}"


@dataclass(frozen=True)
class Heading:
    """Of a column: text and unit below it; the metric that defines it; numbers stand to the right.

    A name is written as it is, everything else with a capital where that is usual.
    """

    text: str
    unit: str = ""
    key: str = ""
    number: bool = True
    name: bool = False


@dataclass(frozen=True)
class Line:
    """Cells as shown; kind is "failed" or "mean"; which cells are the best of their sequence."""

    cells: tuple[str, ...]
    kind: str = ""
    best: tuple[bool, ...] = ()


@dataclass(frozen=True)
class Table:
    """Title, headings, lines, and sentences that stand below."""

    title: str
    headings: tuple[Heading, ...]
    lines: tuple[Line, ...]
    notes: tuple[str, ...] = ()


@dataclass(frozen=True)
class Row:
    """A line of the results: sequence (or the mean), method, texts by column, which of them are the best."""

    name: str
    method: str
    cells: tuple[str, ...]
    best: tuple[bool, ...] = (False,) * len(COLUMNS)
    failed: bool = False
    mean: bool = False


def rows(records: Sequence[ResultRecord]) -> list[Row]:
    """Methods by sequence, in the order of their first appearance, then the means where there are two sequences.

    Of several runs of a method on a sequence the medians are shown.
    """
    order = list(dict.fromkeys(record.sequence for record in records))
    groups: dict[tuple[str, ...], list[ResultRecord]] = {}
    for record in sorted(records, key=lambda record: order.index(record.sequence)):
        groups.setdefault((record.sequence, *method_key(record), *comparable_key(record)), []).append(record)
    columns = columns_of(records)
    medians = [{column.key: median(group, column.key) for column in columns} for group in groups.values()]
    means = aggregate(records) if len(order) > 1 else []
    best = _best([group[0].sequence for group in groups.values()], medians, columns)
    values = [*medians, *(mean["metrics"] for mean in means)]
    cells = list(zip(*(c.texts([of.get(c.key) for of in values]) for c in columns), strict=True))
    found = []
    for group, of, texts in zip(groups.values(), medians, cells, strict=False):
        failures = sum(record.failure is not None for record in group)
        several = f" ({len(group)} runs{f', {failures} failed' if failures else ''})" if len(group) > 1 else ""
        marked = tuple(of[c.key] == best.get((group[0].sequence, c.key), math.nan) for c in columns)
        found.append(Row(group[0].sequence, group[0].method + several, texts, marked, failed=failures == len(group)))
    for mean, texts in zip(means, cells[len(medians) :], strict=True):
        failed = f", {mean['failures']} failed" if mean["failures"] else ""
        unmarked = (False,) * len(columns)
        found.append(Row(f"mean of {mean['sequences']}{failed}", mean["method"], texts, unmarked, mean=True))
    return found


def columns_of(records: Sequence[ResultRecord]) -> tuple[Column, ...]:
    """Of the track that the records are of."""
    return OF_TRACK[records[0].track] if records else COLUMNS


def median(records: Sequence[ResultRecord], key: str) -> float:
    """Of the runs that have a value; NaN where none has."""
    known = [value for record in records if not math.isnan(value := record.metrics.get(key, math.nan))]
    return float(np.median(known)) if known else math.nan


def _best(
    sequences: Sequence[str], medians: Sequence[dict[str, float]], columns: Sequence[Column]
) -> dict[tuple[str, str], float]:
    """Best value of each sequence and column, where methods were compared and the metric has a direction.

    Only runs that answer nearly as much as the most complete one compete: an error over the easy part is no record.
    The score counts what is not answered, and so they all compete for it.
    """

    def coverage(of: dict[str, float]) -> float:
        covered = of.get("coverage", math.nan)
        return 1.0 if math.isnan(covered) else covered

    most: dict[str, float] = {}
    for sequence, of in zip(sequences, medians, strict=True):
        most[sequence] = max(most.get(sequence, 0.0), coverage(of))
    values: dict[tuple[str, str], list[float]] = {}
    for sequence, of in zip(sequences, medians, strict=True):
        for column in columns:
            complete = column.key == "score" or coverage(of) >= COMPLETE * most[sequence]
            if complete and not math.isnan(of[column.key]):
                values.setdefault((sequence, column.key), []).append(of[column.key])
    best = {}
    for (sequence, key), found in values.items():
        metric = find_metric(key)
        if metric is not None and metric.better and len(found) > 1 and min(found) < max(found):
            best[sequence, key] = max(found) if metric.better == "higher" else min(found)
    return best


def failures_and_notes(records: Sequence[ResultRecord]) -> list[str]:
    """What must be said about single runs, in sentences; the same sentence of several runs once."""
    said = []
    for record in records:
        name = f"{record.method} on {record.sequence}"
        if record.failure is not None:
            said.append(f"{name} failed: {record.failure}")
        said += [f"{name}: {note}" for note in record.notes]
    return [*dict.fromkeys(said), *paths_said(records)]


def paths_said(records: Sequence[ResultRecord]) -> list[str]:
    """A sentence for each method that has several paths: which of them is scored, and what the others reach."""
    methods: dict[tuple[str, ...], list[ResultRecord]] = {}
    for record in records:
        if "paths" in record.info:
            methods.setdefault(method_key(record), []).append(record)
    said = []
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
        said.append(f"{method}: scored is the {scored} path{beside}")
    return said


def results_tables(records: Sequence[ResultRecord]) -> list[Table]:
    """Results by sequence, in a table for each board: what may not be compared does not stand in one."""
    found = boards(records)
    if len(found) < 2:
        return [results_table(found[0].records if found else [])]
    return [replace(results_table(board.records), title=f"Results on {board.name}") for board in found]


def results_table(records: Sequence[ResultRecord]) -> Table:
    """A line per method and sequence, the means below."""
    headings = (
        Heading("sequence", number=False),
        Heading("method", number=False),
        *(Heading(column.heading, column.unit, column.key) for column in columns_of(records)),
    )
    lines = []
    for row in rows(records):
        kind = "mean" if row.mean else "failed" if row.failed else ""
        lines.append(Line((row.name, row.method, *row.cells), kind, (False, False, *row.best)))
    return Table("Results", headings, tuple(lines), tuple(failures_and_notes(records)))


def interval_text(interval: Interval, column: Column) -> str:
    """Both ends, or a dash."""
    if not interval.known:
        return ABSENT
    low, high = (f"{value * column.factor:.{column.decimals}f}" for value in (interval.low, interval.high))
    return f"{low} to {high}".replace("-", MINUS)


def standings_table(board: Board) -> Table:
    """Methods by the ranking metric, with its interval and spread, and coverage beside the errors."""
    metric = find_column(board.metric)
    shown = [row.summaries.get(board.metric) for row in board.standings]
    texts = {
        column.key: column.texts([s.mean if (s := row.summaries.get(column.key)) else None for row in board.standings])
        for column in (metric, *STANDING_OF_TRACK[board.track])
    }
    lines = []
    for i, (row, summary) in enumerate(zip(board.standings, shown, strict=True)):
        spread = ABSENT
        if summary is not None and not summary.reason:
            spread = f"{summary.low:.{metric.decimals}f} to {summary.high:.{metric.decimals}f}"
        lines.append(
            Line(
                (
                    _rank(board, i),
                    row.label,
                    texts[metric.key][i],
                    interval_text(summary.interval, metric) if summary is not None else ABSENT,
                    spread,
                    *(texts[column.key][i] for column in STANDING_OF_TRACK[board.track]),
                    f"{row.failures} of {row.runs}",
                )
            )
        )
    headings = (
        Heading("rank"),
        Heading("method", number=False),
        Heading(metric.heading, metric.unit, metric.key),
        Heading(f"{LEVEL:.0%}", "interval"),
        Heading("sequences", "from, to"),
        *(Heading(column.heading, column.unit, column.key) for column in STANDING_OF_TRACK[board.track]),
        Heading("failed", "runs"),
    )
    return Table(f"Standings on {board.name}", headings, tuple(lines), tuple(_reading(board)))


def _rank(board: Board, i: int) -> str:
    """The rank, with the worst that it may be; a place in brackets where nothing can be told apart."""
    standing = board.standings[i].standing
    if standing.place is None:
        return ABSENT
    if standing.rank is None or standing.worst is None:
        return f"({standing.place})"
    return f"{standing.rank}" if standing.rank == standing.worst else f"{standing.rank}\N{EN DASH}{standing.worst}"


def _reading(board: Board) -> list[str]:
    n = len(board.sequences)
    count = f"{n} sequence{'' if n == 1 else 's'}"
    metric = find_metric(board.metric)
    said = [
        f"Means over {count}, each the mean of its runs; a failed run scores 0, and errors are those of the runs "
        "that have one: read them beside coverage and failures."
    ]
    if metric is not None and metric.weight:
        said = [f"{metric.heading} is that of all pixels of {count} together; a failed run finds nothing."]
    if any(row.standing.rank is not None for row in board.standings):
        said.append(
            f"A rank is a range where methods cannot be told apart at {LEVEL:.0%}, by resampling the differences on "
            "the same sequences; each pair by itself, with no correction for their number."
        )
    elif len(board.standings) > 1:
        said.append("Places in brackets are the order of these means: which method is better cannot be told.")
    return said


def pairs_table(board: Board) -> Table:
    """Is a better than b, where, and by how much."""
    metric = find_column(board.metric)
    lines = []
    for pair in board.pairs:
        found = pair.comparison
        where = f"{CONDITIONS[pair.condition].name}: {pair.value}" if pair.condition else "everywhere"
        difference = ABSENT if math.isnan(found.difference) else f"{found.difference:+.{metric.decimals}f}"
        lines.append(
            Line(
                (
                    pair.a,
                    pair.b,
                    where,
                    difference.replace("-", MINUS),
                    interval_text(found.interval, metric),
                    f"{found.wins} / {found.ties} / {found.losses}",
                    found.verdict if found.interval.known else f"{_short(found.interval.reason)}: too few to tell",
                ),
                "" if pair.condition else "mean",
            )
        )
    headings = (
        Heading("method", number=False),
        Heading("against", number=False),
        Heading("where", number=False),
        Heading(metric.heading, "difference", metric.key),
        Heading(f"{LEVEL:.0%}", "interval"),
        Heading("sequences", "won / tied / lost"),
        Heading("verdict", number=False),
    )
    return Table(f"Pairs on {board.name}", headings, tuple(lines))


def _short(reason: str) -> str:
    return reason.partition(":")[0]


def strata_table(board: Board) -> Table:
    """A line per class of conditions, a column per method, where there are several classes."""
    metric = find_column(board.metric)
    labels = [row.label for row in board.standings]
    lines = []
    for condition in STRATA:
        found = {(value, label): summary for value, label, summary in board.strata(condition)}
        for value in dict.fromkeys(value for value, _ in found):
            of_class = [found[value, label] for label in labels]
            cells = [metric.texts([s.mean])[0] + _bracketed(s.interval, metric) for s in of_class]
            count = str(len(board.classes(condition)[value]))
            lines.append(Line((CONDITIONS[condition].name, value, count, *cells)))
    headings = (
        Heading("condition", number=False),
        Heading("class", number=False),
        Heading("sequences"),
        *(Heading(label, f"{metric.heading} {metric.unit}".strip(), name=True) for label in labels),
    )
    note = f"In brackets the {LEVEL:.0%} interval, where there are enough sequences."
    return Table(f"By conditions on {board.name}", headings, tuple(lines), (note,) if lines else ())


def _bracketed(interval: Interval, column: Column) -> str:
    return f" [{interval_text(interval, column)}]" if interval.known else ""


def runs_table(board: Board) -> Table:
    """Median and spread over the runs of each method on each sequence, where some have several."""
    metric, drift, coverage = (find_column(key) for key in (board.metric, ERROR_OF_TRACK[board.track], "coverage"))
    cells = [cell for cell in board.cells() if cell.runs > 1]
    errors = {(cell.label, cell.sequence): cell for cell in board.cells(drift.key)}
    lines = []
    for cell in cells:
        error = errors[cell.label, cell.sequence]
        lines.append(
            Line(
                (
                    cell.sequence,
                    cell.label,
                    str(cell.runs),
                    str(cell.failures),
                    *_median_and_range(metric, cell),
                    coverage.texts([cell.coverage])[0],
                    *_median_and_range(drift, error),
                ),
                "failed" if cell.failures == cell.runs else "",
            )
        )
    headings = (
        Heading("sequence", number=False),
        Heading("method", number=False),
        Heading("runs"),
        Heading("failed"),
        Heading(metric.heading, "median", metric.key),
        Heading("from, to"),
        Heading(coverage.heading, f"median {coverage.unit}", coverage.key),
        Heading(drift.heading, f"median {drift.unit}", drift.key),
        Heading("from, to"),
    )
    note = "A failed run scores 0; errors are those of the runs that have one."
    return Table(f"Runs on {board.name}", headings, tuple(lines), (note,) if lines else ())


def _median_and_range(column: Column, cell: Cell) -> tuple[str, str]:
    middle, low, high = column.texts([cell.median, cell.low, cell.high])
    return middle, middle if middle == ABSENT else f"{low} to {high}"


def comparison_tables(records: Sequence[ResultRecord]) -> list[Table]:
    """Runs, standings, pairs and classes of every board, each where there is something of it to say."""
    found = boards(records)
    tables = []
    for board in found:
        if len(board.standings) > 1 or len(board.sequences) > 1:
            tables.append(standings_table(board))
        tables += [table for make in (pairs_table, strata_table, runs_table) if (table := make(board)).lines]
    if tables and (said := remarks(found)):
        first = tables[0]
        tables[0] = Table(first.title, first.headings, first.lines, (*said, *first.notes))
    return tables
