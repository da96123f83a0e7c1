"""Page that compares two records head to head: whether one is better, where, and by how much."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace

from oysterbench.core.errors import ResultError
from oysterbench.evaluate.conditions import CONDITIONS, STRATA
from oysterbench.evaluate.metrics import TRACKS
from oysterbench.evaluate.statistics import Comparison
from oysterbench.report.columns import OF_TRACK, STANDING_OF_TRACK, lost_note, metric_column
from oysterbench.report.table import Cell, Column, Table, TableRow, Value
from oysterbench.results.comparison import Board, MethodPair, per_sequence
from oysterbench.results.comparison import boards as boards_of
from oysterbench.results.records import ResultRecord, lost_of, plain
from oysterbench.results.remarks import remarks
from oysterbench_leaderboard.boards.board import BoardInfo, Row
from oysterbench_leaderboard.boards.tables import failures_note, machines_note
from oysterbench_leaderboard.site import numbers, standing
from oysterbench_leaderboard.site.charts import drawings
from oysterbench_leaderboard.site.page import Page, PageError
from oysterbench_leaderboard.site.paths import board_path, record_path
from oysterbench_leaderboard.site.site import Site, curves_of
from oysterbench_leaderboard.storage.record import Record

PAIRED = 10
"""Number of first records of each newest board of which the exported site compares every two."""

DIGEST = re.compile("[0-9a-f]{8,64}")


@dataclass(frozen=True)
class Side:
    """One of the compared records. label: its method, with what distinguishes it where others have the same name."""

    label: str
    row: Row
    record: Record


def compare_page(site: Site, a: str, b: str) -> Page:
    """Compare two records by their digests, or two methods by their names: then on the first board that has both.

    Raises PageError where there are no two, or their numbers may not be compared.
    """
    rows = find_two(site, a, b)
    records = [site.record(row.digest) for row in rows]
    sides = [Side(label, row, record) for label, row, record in zip(labels_of(rows), rows, records, strict=True)]
    info = next(info for info in site.index.boards() if info.id == rows[0].board)
    if rows[0].board != rows[1].board:
        why = remarks(boards_of([result for side in sides for result in standing.named(side.record, side.label)]))
        hints = {record_path(row.digest): f"{row.method} of {row.created[:10]}" for row in rows}
        raise PageError(f"these two records may not be compared: {why[0]}", 409, hints)
    board = whole_board(site, info, sides)
    pairs = board.compare(sides[0].label, sides[1].label)
    of_a, of_b = (board.runs_of(side.label) for side in sides)
    metric = metric_column(info.metric)
    whole = next(pair.comparison for pair in pairs if not pair.condition)
    signed = numbers.difference_column(info.metric).resolving([whole.interval])
    tables = (
        _sequences(board, info, sides),
        _metrics(board, sides),
        *([strata] if (strata := _strata(board, sides, pairs)).rows else []),
    )
    context = {
        "sides": sides,
        "info": info,
        "board": board_path(info),
        "metric": metric,
        "verdict": verdict(sides, whole, info.metric),
        "whole": whole,
        "machines": machines_note(rows),
        "difference": signed.text(whole.difference),
        "interval": signed.text(whole.interval),
        "drawings": drawings({side.label: curves_of(site, side.record) for side in sides}),
        "means": [metric.text(entry.summary(info.metric, info.sequences).mean) for entry in (of_a, of_b)],
    }
    title = f"{sides[0].label} against {sides[1].label} on {info.split}"
    data = {
        "a": asdict(sides[0].row),
        "b": asdict(sides[1].row),
        "difference": asdict(whole),
        "pairs": [{"condition": pair.condition, "value": pair.value, **asdict(pair.comparison)} for pair in pairs],
        "records": [asdict(side.row) for side in sides],
        "means": means_of(board, sides),
        "per_sequence": per_sequence(board),
    }
    query = {"a": rows[0].digest, "b": rows[1].digest}
    return Page("/compare", title, "compare.html", context, tables, plain(data), query)


def find_two(site: Site, a: str, b: str) -> list[Row]:
    """Find the rows of the two records that were asked for, on one board if possible. Raises PageError, also where a
    name is that of several teams' methods there."""
    for name, value in (("a", a), ("b", b)):
        if not value.strip():
            raise PageError(f"{name}: expected a record's digest or a method, got nothing", 400, {"/": "all boards"})
    found = [records_of(site, a), records_of(site, b)]
    boards = {info.id: i for i, info in enumerate(site.index.boards())}
    pairs = [(x, y) for x in found[0] for y in found[1] if x.board == y.board and x.digest != y.digest]
    pairs.sort(key=lambda pair: (boards[pair[0].board], -_stamp(pair[0]), -_stamp(pair[1])))
    if pairs:
        for several, name in zip(found, (a, b), strict=True):
            check_one_team([row for row in several if row.board == pairs[0][0].board], name)
        return list(pairs[0])
    if found[0][0].digest == found[1][0].digest:
        raise PageError(
            "a and b: expected two records, got the same one twice", 400, {record_path(found[0][0].digest): "it"}
        )
    return [found[0][0], found[1][0]]


def _stamp(row: Row) -> int:
    return int(re.sub(r"\D", "", row.created)[:14] or 0)


def records_of(site: Site, name: str) -> list[Row]:
    """Rows of a record by its digest, or of a method's current records, or of all its records where none is current.
    Raises PageError."""
    if DIGEST.fullmatch(name):
        try:
            return [site.index.row(name)]
        except ResultError:
            pass  # it may be the name of a method
    name = site.methods().get(name, name)
    rows = site.index.method(name)
    current = [row for row in rows if row.state == "current"]
    if not rows:
        hints = {"/": "all boards, with their methods"}
        raise PageError(f"expected a record's digest or a method, got {name!r:.80}", 404, hints)
    return current or rows


def check_one_team(rows: Sequence[Row], name: str) -> None:
    """Refuse a name that several teams' methods have on a board: it does not say which of them is meant. Raises
    PageError.

    rows: of the name, on that board
    """
    if len({row.team for row in rows}) > 1:
        hints = {record_path(row.digest): f"{row.method} by {row.team}, of {row.created[:10]}" for row in rows}
        raise PageError(f"several teams have a method named {name}: give the digest of a record", 409, hints)


def labels_of(rows: Sequence[Row]) -> list[str]:
    """Methods, with what tells those of the same name apart: their teams, or else their records."""
    same = [[other for other in rows if other.method == row.method] for row in rows]
    teams = [len({other.team for other in several}) == len(several) for several in same]
    return [
        row.method if len(several) == 1 else f"{row.method} ({row.team if by_team else row.digest[:8]})"
        for row, several, by_team in zip(rows, same, teams, strict=True)
    ]


def means_of(board: Board, sides: Sequence[Side]) -> dict[str, dict[str, float]]:
    """Label -> metric -> its value over the sequences of the board (`MethodRuns.over`), for JSON."""
    runs = {side.label: board.runs_of(side.label) for side in sides}
    return {label: {key: of.over(key, board.sequences) for key in board.keys} for label, of in runs.items()}


def whole_board(site: Site, info: BoardInfo, sides: Sequence[Side]) -> Board:
    """Board of all sides on all its sequences: those that one was not run on, or failed on, count as in the ranking.
    Raises PageError (409) where they were not scored against one ground truth."""
    named = [standing.named(side.record, side.label) for side in sides]
    answered = {result.sequence for results in named for result in results}
    beyond, lowest = site.results_on(info.id, set(info.sequences) - answered), site.lowest_scores(info)
    everyone: list[ResultRecord] = []
    for k, own in enumerate(named):
        others = [result for i, other in enumerate(named) if i != k for result in other]
        everyone += standing.filled(own, info.sequences, [*others, *beyond], lowest)
    try:
        return standing.board(everyone)
    except ResultError as error:
        hints = {record_path(side.row.digest): side.label for side in sides}
        raise PageError(f"these records may not be compared: {error}", 409, hints) from None


def verdict(sides: Sequence[Side], whole: Comparison, metric: str) -> str:
    """State the outcome of a comparison in one sentence."""
    a, b = (side.label for side in sides)
    if not whole.interval.known:
        return f"It cannot be said which of the two is better: {whole.interval.reason}."
    if whole.verdict == "not significantly different":
        return f"{a} and {b} are not significantly different."
    name = metric_column(metric).heading
    return f"{a if whole.verdict == 'better' else b} is better by {name}."


def _compared_cells(key: str, comparison: Comparison) -> tuple[Cell, ...]:
    """Cells of a comparison: difference of the means, interval, won / tied / lost, verdict."""
    known = comparison.interval.known
    signed = numbers.difference_column(key).resolving([comparison.interval])
    kind = {"better": "best", "worse": "warn"}.get(comparison.verdict, "") if known else ""
    return (
        Cell(numbers.finite(comparison.difference), signed.text(comparison.difference)),
        Cell(comparison.interval, signed.text(comparison.interval), kind="soft"),
        Cell(comparison.wins, f"{comparison.wins} / {comparison.ties} / {comparison.losses}"),
        Cell(comparison.verdict if known else "too few to tell", kind=kind),
    )


def _compared_columns(sides: Sequence[Side]) -> tuple[Column, ...]:
    a, b = (side.label for side in sides)
    return (
        Column("difference", "Difference", "first less second", "number", about=f"{a} less {b}"),
        Column("interval", "Interval", numbers.LEVEL, "interval", about="Bootstrap of the paired differences."),
        Column("won", "Sequences", "won / tied / lost", "number"),
        Column("verdict", "The first is"),
    )


def _sequences(board: Board, info: BoardInfo, sides: Sequence[Side]) -> Table:
    """Table of the ranking metric of both on each sequence, with coverage beside it."""
    keys = (info.metric, *(["coverage"] if any("coverage" in result.metrics for result in board.given) else []))
    known = [key for key in STRATA if any(key in r.conditions for r in board.given)]
    means = {key: [standing.means(board.runs_of(side.label).records, key) for side in sides] for key in keys}
    difference = numbers.difference_column(info.metric)
    columns = [Column("sequence", "Sequence")]
    for key in keys:
        metric = metric_column(key)
        for letter, side in zip("ab", sides, strict=True):
            unit = f"{metric.heading} {metric.unit}".strip()
            columns.append(replace(metric, key=f"{key}_{letter}", heading=side.label, unit=unit))
    columns.append(replace(difference, heading="Difference", unit=difference.heading, better="", about=""))
    columns += [Column(key, CONDITIONS[key].name.capitalize()) for key in known]
    lines = []
    for name in info.sequences:
        a, b = (of.get(name) for of in means[info.metric])
        gain = None if a is None or b is None else a - b
        kind = "" if not gain else "best" if (gain > 0) == (difference.better == "higher") else "warn"
        values = (of.get(name) for key in keys for of in means[key])
        conditions = board.conditions(name)
        lines.append(TableRow((name, *values, Cell(gain, kind=kind), *(conditions.get(key) for key in known))))
    title = f"{sides[0].label} and {sides[1].label} by sequence"
    notes = (f"Means over the runs of each sequence. {failures_note(info.track)}",)
    return Table(title, tuple(columns), tuple(lines), notes, "sequences")


def _metrics(board: Board, sides: Sequence[Side]) -> Table:
    """Table of every metric in the track's tables that has a direction; for errors, the median of each over the
    sequences that it has not lost, and the difference over those that neither has."""
    track = TRACKS[board.track]
    a, b = (board.runs_of(side.label) for side in sides)
    lost = {name for of in (a, b) for name in lost_of(of.records) or ()}
    mean = "median of errors, else mean" if track.errors else "mean"
    keys = dict.fromkeys(column.key for column in (*OF_TRACK[board.track], *STANDING_OF_TRACK[board.track]))
    columns = (
        Column("metric", "Metric"),
        Column("unit", "Unit", "arrow to better"),
        Column("a", sides[0].label, mean, "number"),
        Column("b", sides[1].label, mean, "number"),
        *_compared_columns(sides),
        Column("shared", "On", "sequences", "number", about="Sequences where both have a value."),
        Column("key", hidden=True),
    )
    lines = []
    for key in keys:
        metric = metric_column(key)
        if not metric.better or key not in board.keys:
            continue
        error = key in track.errors
        comparison = a.compare(b, key, [name for name in board.sequences if not error or name not in lost])
        means = [numbers.finite(entry.over(key, board.sequences)) for entry in (a, b)]
        cells: tuple[Value | Cell, ...] = (
            Cell(metric.heading, about=metric.about),
            Cell(metric.unit, numbers.unit(metric)),
            *map(Cell, means, metric.texts(means)),
            *_compared_cells(key, comparison),
            comparison.sequences,
            key,
        )
        lines.append(TableRow(cells))
    notes = "Errors are compared on the sequences where both have a value: read them together with coverage."
    if track.errors:
        notes = (
            f"{lost_note(board.track)} Their differences are means over the sequences that neither has lost, and so "
            "need not be the differences of these medians."
        )
    return Table(f"{sides[0].label} against {sides[1].label}", columns, tuple(lines), (notes,), "metrics")


def _strata(board: Board, sides: Sequence[Side], pairs: Sequence[MethodPair]) -> Table:
    """Table of the ranking metric within each class of conditions."""
    columns: tuple[Column, ...] = (
        Column("condition", "Condition"),
        Column("class", "Class"),
        Column("sequences", "Sequences", kind="number"),
        *_compared_columns(sides),
    )
    lines = []
    for pair in pairs:
        if pair.condition:
            lead = (CONDITIONS[pair.condition].name, pair.value, pair.comparison.sequences)
            lines.append(TableRow((*lead, *_compared_cells(board.metric, pair.comparison))))
    metric = metric_column(board.metric).heading
    return Table(f"{metric} by class of conditions", columns, tuple(lines), name="conditions")
