"""Page of a record: everything published of a method on a split, at a permanent address."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

from oysterbench.evaluate.conditions import CONDITIONS, STRATA
from oysterbench.evaluate.metrics import TRACKS, find_metric
from oysterbench.evaluate.statistics import LEAST_SEQUENCES, Interval, Summary
from oysterbench.report.columns import OF_TRACK, STANDING_OF_TRACK, lost_note, metric_column
from oysterbench.report.table import ABSENT, Cell, Column, Table, TableRow, Value, interval_column
from oysterbench.report.tables import failures_and_notes
from oysterbench.results.comparison import MethodRuns
from oysterbench.results.records import ResultRecord, lost_of, plain
from oysterbench.results.standings import PRIMARY
from oysterbench_leaderboard.boards.board import BoardInfo, Query, Row
from oysterbench_leaderboard.boards.tables import DATA_SET, has_data_set
from oysterbench_leaderboard.publishing.hidden import is_hidden
from oysterbench_leaderboard.site import numbers, standing
from oysterbench_leaderboard.site.charts import drawings
from oysterbench_leaderboard.site.history import successor
from oysterbench_leaderboard.site.page import Page
from oysterbench_leaderboard.site.pages.compare import PAIRED
from oysterbench_leaderboard.site.pages.ranks import ABOUT_TIERS, rank_cells
from oysterbench_leaderboard.site.paths import board_path, method_path, record_path
from oysterbench_leaderboard.site.site import Site, curves_of
from oysterbench_leaderboard.site.works import code_cell, paper_address
from oysterbench_leaderboard.storage.record import Record

HIDDEN = "The split is hidden: most metrics are shown only as a mean, and values by sequence only in steps, if at all."

NO_PRECISION = (
    "Without precision, as the masks have less than a tenth of the true pixels: it would tell which are right."
)

NO_INTERVAL = Interval(math.nan, math.nan, "only a mean has an interval")
"""Interval of a median, which has none."""

LEADERS = 3
"""Number of first records of the board offered for comparison with every record, besides its neighbours."""


@dataclass(frozen=True)
class Notes:
    """Notes to show before the numbers. withdrawn: reason and date; by: the record that superseded it; reason: that of
    the superseding."""

    withdrawn: tuple[str, str] | None
    by: Row | None
    reason: str


def record_page(site: Site, digest: str) -> Page:
    """Page of a record, by its digest or the first digits of it. Raises PageError where there is none."""
    row = site.row(digest)
    record = site.record(row.digest)
    info = next(info for info in site.index.boards() if info.id == row.board)
    answered = {result.sequence for result in record.results}
    lacking, others = set(info.sequences) - answered, answered - set(info.sequences)
    known, lowest = site.results_on(info.id, lacking), site.lowest_scores(info)
    results = standing.filled(standing.named(record, record.method), info.sequences, known, lowest)
    rank, metric = rank_cells([row])[0], metric_column(info.metric)
    name = f"{row.method} on {info.split}"
    by_sequence = sequences_table(results, info.sequences, f"{name}, by sequence")
    if others:
        note = f"Not counted, as no ranked record of the board has them: {', '.join(sorted(others))}."
        by_sequence = replace(by_sequence, notes=(*by_sequence.notes, note))
    shown = metrics_table(results, f"{name}, over {numbers.count(len(info.sequences), 'sequence')}", record.data_set)
    if others and record.data_set:
        note = (
            f"Values that the record has over its data set are over all {len(answered)} sequences, also those that do "
        )
        shown = replace(shown, notes=(*shown.notes, f"{note}not count here: {', '.join(sorted(others))}."))
    tables = (
        by_sequence,
        shown,
        *([strata] if (strata := strata_table(results, f"{name}, by conditions")).rows else []),
    )
    notes = _notes(site, row)
    context = {
        "row": row,
        "record": record,
        "info": info,
        "paired": PAIRED,
        "track": numbers.track_name(info.track),
        "board": board_path(info),
        "method": method_path(record.method),
        "rank": rank,
        "tied": row.rank is not None and row.tied,
        "score": metric.text(row.score),
        "metric": metric,
        "interval": metric.text(numbers.interval(row.low, row.high)),
        "bar": numbers.bar(row.low, row.score, row.high),
        "data_set": metric.text(row.data_set) if has_data_set(info, [row]) else "",
        "coverage": numbers.text("coverage", row.coverage),
        "hidden": not record.curves and bool(is_hidden(record.results)),
        "lost_below": TRACKS[info.track].lost_below,
        "tier_about": ABOUT_TIERS.get(row.tier, ""),
        "notes": notes,
        "rivals": rivals(site, info, row),
        "drawings": drawings({record.method: curves_of(site, record)}),
        "code": code_cell(row.code),
        "paper": paper_address(row.paper),
        "remarks": failures_and_notes(results),
        "making": making(record),
        "settings": {key: numbers.setting_text(value) for key, value in info.settings.items()},
        "raw": f"{record_path(row.digest)}/record",
        "raw_curves": f"{record_path(row.digest)}/curves",
    }
    data = {
        "row": asdict(row),
        "board": asdict(info),
        "withdrawn": notes.withdrawn,
        "superseded_by": notes.by.digest if notes.by else None,
        "data_set": record.data_set,
        "per_sequence": _per_sequence(results, info.sequences),
        "status_changes": [asdict(change) for change in site.status_changes(row.digest)],
    }
    return Page(record_path(row.digest), name, "record.html", context, tables, plain(data))


def rivals(site: Site, info: BoardInfo, row: Row) -> list[Row]:
    """Records offered for comparison with this one: the first of its board, and its neighbours there."""
    found = list(site.index.page(info.id, Query(size=LEADERS)).rows)
    for place in (row.place - 1, row.place + 1) if row.place is not None else ():
        if place >= 1:
            found += site.index.page(info.id, Query(page=place, size=1)).rows
    return [other for other in {other.digest: other for other in found}.values() if other.digest != row.digest]


def _notes(site: Site, row: Row) -> Notes:
    latest = site.status_changes(row.digest)[-1:]
    withdrawn = next(((n.reason, n.created[:10]) for n in latest if n.action == "withdrawn"), None)
    by = successor(site, row)
    reason = site.record(by.digest).reason if by and by.supersedes == row.digest else ""
    return Notes(withdrawn, by, reason)


def _per_sequence(results: Sequence[ResultRecord], sequences: Sequence[str]) -> list[dict[str, Any]]:
    """Means over runs of all metrics on each sequence, for JSON."""
    keys = list(dict.fromkeys(key for result in results for key in result.metrics))
    means = {key: standing.means(results, key) for key in keys}
    found = []
    for sequence in sequences:
        runs = [result for result in results if result.sequence == sequence]
        found.append(
            {
                "sequence": sequence,
                "runs": sum(result.failure != standing.NOT_ANSWERED for result in runs),
                "failures": sum(result.failure is not None for result in runs),
                "conditions": dict(runs[0].conditions),
                "metrics": {key: means[key].get(sequence) for key in keys},
            }
        )
    return found


def sequences_table(results: Sequence[ResultRecord], sequences: Sequence[str], title: str) -> Table:
    """Table with the mean over runs of each metric in the track's tables, and the conditions, of every sequence."""
    track = results[0].track
    keys = list(dict.fromkeys(column.key for column in OF_TRACK[track]))
    known = [key for key in STRATA if any(key in result.conditions for result in results)]
    columns = (
        Column("sequence", "Sequence"),
        *(metric_column(key) for key in keys),
        Column("failures", "Failed", "runs", "number"),
        *(Column(key, CONDITIONS[key].name.capitalize()) for key in known),
    )
    means = {key: standing.means(results, key) for key in keys}
    lines = []
    for name in sequences:
        runs = [result for result in results if result.sequence == name]
        failed = sum(result.failure is not None for result in runs)
        answered = any(result.failure != standing.NOT_ANSWERED for result in runs)
        counted = f"{failed} of {len(runs)}" if answered else ABSENT
        cells = (
            Cell(name, mark="" if answered else "not answered"),
            *(means[key].get(name) for key in keys),
            Cell(failed, counted, kind="warn" if failed else ""),
            *(Cell(runs[0].conditions.get(key), kind="brief") for key in known),
        )
        lines.append(TableRow(cells, "failed" if failed == len(runs) else ""))
    notes = (f"Means over the runs of each sequence; a failed run {TRACKS[track].failed_as} and has no errors.",)
    return Table(title, columns, tuple(lines), notes, "sequences")


def metrics_table(results: Sequence[ResultRecord], title: str, data_set: Mapping[str, Any] | None = None) -> Table:
    """Table with mean, interval and spread of each metric in the track's tables, for errors the median and spread over
    sequences that are not lost; and the record's values over all sequences at once."""
    track = results[0].track
    keys = dict.fromkeys(column.key for column in (*OF_TRACK[track], *STANDING_OF_TRACK[track]))
    known = data_set or {}
    whole = known.get("metrics")
    columns = (
        Column("metric", "Metric"),
        Column("unit", "Unit", "arrow to better"),
        Column("mean", "Value", "median of errors, else mean" if TRACKS[track].errors else "mean", "number"),
        Column("interval", "Interval", numbers.LEVEL, "interval"),
        Column("spread", "Spread", "over sequences", "interval"),
        Column("sequences", "Sequences", "with a value", "number"),
        Column("data_set", "Data set", "all at once", "number", hidden=not whole),
        Column("data_set_interval", "Interval", numbers.LEVEL, "interval", hidden=not whole),
        Column("key", hidden=True),
    )
    of = MethodRuns(results[0].method, tuple(results))
    lost = lost_of(results) or ()
    lines = []
    for key in keys:
        by_sequence, mean = any(key in result.metrics for result in results), _number(known.get("means"), key)
        if not by_sequence and mean is None:
            continue
        names = [result.sequence for result in results]
        summary = of.summary(key, names)
        if error := key in TRACKS[track].errors:
            kept = of.summary(key, [name for name in names if name not in lost])
            summary = replace(kept, mean=kept.median, interval=NO_INTERVAL, of_sequences=summary.of_sequences)
        if mean is not None and not by_sequence:
            summary = replace(summary, mean=mean)
        at_once = _number(whole, key), _interval(known.get("intervals"), key)
        lines.append(TableRow(_summary_cells(key, summary, *at_once, small="median" if error else "")))
    notes = [DATA_SET.format("A record")] if whole and not _weighed(results) else []
    notes += [HIDDEN] if "means" in known else []
    means = known.get("means")
    notes += [NO_PRECISION] if isinstance(means, Mapping) and means.get("precision", "") is None else []
    notes += [note for note in (lost_note(track),) if note]
    return Table(title, columns, tuple(lines), tuple(notes), "metrics")


def _weighed(results: Sequence[ResultRecord]) -> bool:
    """Whether the mean of the ranking metric is its value over all sequences at once."""
    metric = find_metric(PRIMARY[results[0].track])
    return metric is not None and bool(metric.weight)


def _number(values: Any, key: str) -> float | None:
    """Number from the unchecked part of a record that comes besides its results; None where it is missing or not a
    number."""
    value = values.get(key) if isinstance(values, Mapping) else None
    return float(value) if isinstance(value, int | float) else None


def _interval(intervals: Any, key: str) -> tuple[float | None, float | None]:
    found = intervals.get(key) if isinstance(intervals, Mapping) else None
    return _number(found, "low"), _number(found, "high")


def _summary_cells(
    key: str,
    summary: Summary,
    data_set: float | None,
    of_data_set: tuple[float | None, float | None],
    small: str = "",
) -> tuple[Cell, ...]:
    metric = metric_column(key)

    def shown(value: Value, kind: str = "") -> Cell:
        return Cell(value, metric.text(value), kind)

    return (
        Cell(metric.heading, about=metric.about),
        Cell(metric.unit, numbers.unit(metric) or ABSENT),
        replace(shown(numbers.finite(summary.mean)), small=small),
        shown(summary.interval, "soft"),
        shown(numbers.interval(summary.low, summary.high), "soft"),
        Cell(summary.sequences, _of(summary)),
        shown(data_set),
        shown(numbers.interval(*of_data_set), "soft"),
        Cell(key),
    )


def _of(summary: Summary) -> str:
    """How many sequences have a value, and of how many."""
    return f"{summary.sequences} of {summary.of_sequences}"


def strata_table(results: Sequence[ResultRecord], title: str) -> Table:
    """Table of the ranking metric within each class of conditions, where there are several."""
    board = standing.board(results)
    metric = metric_column(board.metric)
    columns = (
        Column("condition", "Condition"),
        Column("class", "Class"),
        Column("sequences", "Sequences", kind="number"),
        metric,
        interval_column(metric, "interval", "Interval", numbers.LEVEL),
    )
    lines = []
    for condition in STRATA:
        for value, _, summary in board.strata(condition):
            known = summary.interval.known
            bar = numbers.bar(summary.interval.low, summary.mean, summary.interval.high) if known else None
            number = Cell(summary.sequences, _of(summary))
            cells = (CONDITIONS[condition].name, value, number, summary.mean)
            lines.append(TableRow((*cells, Cell(summary.interval, kind="soft", bar=bar))))
    rule = f"An interval needs {LEAST_SEQUENCES} sequences or more in a class; a dash marks classes with fewer."
    notes = (rule,) if lines else ()
    return Table(title, columns, tuple(lines), notes, "conditions")


def making(record: Record) -> dict[str, list[str]]:
    """How the results were made: label -> distinct values, each once."""
    found: dict[str, list[str]] = {}

    def add(label: str, value: str) -> None:
        if value and value not in found.setdefault(label, []):
            found[label].append(value)

    for result in record.results:
        add("Settings of the method", settings_text(result.method_settings))
        add("oysterbench", result.oysterbench_version)
        add("Machine", settings_text(result.hardware))
    seeds = [str(result.seed) for result in record.results if result.seed is not None]
    add("Seeds", ", ".join(dict.fromkeys(seeds)))
    dates = sorted(result.created[:10] for result in record.results)
    add("Run", dates[0] if dates[0] == dates[-1] else f"{dates[0]} to {dates[-1]}")
    return {label: values for label, values in found.items() if values}


def settings_text(values: Mapping[str, Any]) -> str:
    """Keys and values in one line; long values are cut, since the record has them in full."""
    texts = {k: v if isinstance(v, str) else json.dumps(plain(v), ensure_ascii=False) for k, v in values.items()}
    return ", ".join(f"{k} = {v if len(v) <= 300 else v[:297] + '...'}" for k, v in texts.items())
