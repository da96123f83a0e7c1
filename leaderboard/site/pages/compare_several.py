"""Page that compares three or more records: scores, where they differ, and which of every two is better."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict

from oysterbench.core.page import STYLES
from oysterbench.evaluate.metrics import TRACKS
from oysterbench.report.columns import (
    OF_TRACK,
    STANDING_OF_TRACK,
    lost_column,
    lost_note,
    metric_column,
    standing_column,
)
from oysterbench.report.table import ABSENT, Cell, Column, Table, TableRow
from oysterbench.results.comparison import Board, per_sequence
from oysterbench.results.records import plain
from oysterbench_leaderboard.boards.board import BoardInfo, Row
from oysterbench_leaderboard.boards.tables import LEADING, machines_note, role_of
from oysterbench_leaderboard.site import numbers
from oysterbench_leaderboard.site.charts import drawings
from oysterbench_leaderboard.site.page import Page, PageError
from oysterbench_leaderboard.site.pages.compare import (
    Side,
    check_one_team,
    find_two,
    labels_of,
    means_of,
    records_of,
    whole_board,
)
from oysterbench_leaderboard.site.pages.heat import classes_heat, scores_of, sequences_heat
from oysterbench_leaderboard.site.pages.ranks import rank_cells
from oysterbench_leaderboard.site.paths import board_path, record_path
from oysterbench_leaderboard.site.site import Site, curves_of

MOST = 50
"""Maximum number of records that one page compares, every two of them."""

OF_TWO = ("a", "b", "difference", "pairs")
"""Keys of the JSON that only a comparison of two has."""

KINDS = {"better": "best", "worse": "warn"}
"""Verdict of a comparison -> kind of its cell."""


def several_page(site: Site, names: Sequence[str]) -> Page:
    """Compare records by their digests, or methods by their names: then their records on the first board that has all.

    Raises PageError where there are too many, one is unknown, or no board has all of them.
    """
    info, rows = _common(site, names)
    sides = [Side(label, row, site.record(row.digest)) for label, row in zip(labels_of(rows), rows, strict=True)]
    board = whole_board(site, info, sides)
    scores = scores_of(site, info, rows)
    heats = [] if scores is None else [sequences_heat(scores), classes_heat(scores)]
    tables = [_metrics(board, sides), _pairs(board, info, sides), *filter(None, heats)]
    drawn = sides[:STYLES]
    context = {
        "info": info,
        "board": board_path(info),
        "metric": metric_column(info.metric),
        "has_ranks": any(row.rank is not None for row in rows),
        "count": len(sides),
        "machines": machines_note(rows),
        "unshown": len(sides) - len(drawn),
        "drawings": drawings({side.label: curves_of(site, side.record) for side in drawn}),
    }
    data = {
        **dict.fromkeys(OF_TWO),
        "records": [asdict(row) for row in rows],
        "means": means_of(board, sides),
        "per_sequence": per_sequence(board),
    }
    title = f"{len(sides)} records on {info.split}"
    return Page("/compare", title, "compare_several.html", context, tuple(tables), plain(data), {"r": list(names)})


def records_compared(site: Site, names: Sequence[str]) -> tuple[str, ...]:
    """Digests of the records that a comparison of these names is about: of two in the order given, of more sorted, so
    that the same records have one page, however they were named. Raises PageError."""
    rows = find_two(site, *names) if len(names) == 2 else _common(site, names)[1]
    digests = [row.digest for row in rows]
    return tuple(digests if len(digests) == 2 else sorted(digests))


def _common(site: Site, names: Sequence[str]) -> tuple[BoardInfo, list[Row]]:
    """Find the first board that has all of them, and the newest record of each there, best first. Raises PageError,
    also where a name is that of several teams' methods there."""
    if len(names) > MOST:
        raise PageError(f"r: expected {MOST} records at most, got {len(names)}", 400, {"/": "all boards"})
    found = [records_of(site, name) for name in names]
    for info in sorted(site.index.boards(), key=lambda info: LEADING.index(role_of(info.split))):
        here = [[row for row in several if row.board == info.id] for several in found]
        rows = list({several[0].digest: several[0] for several in here if several}.values())
        if all(here) and len(rows) > 1:
            for several, name in zip(here, names, strict=True):
                check_one_team(several, name)
            return info, sorted(rows, key=lambda row: (row.place is None, row.place or 0, row.digest))
    hints = {record_path(several[0].digest): several[0].method for several in found}
    raise PageError("these records share no board: expected records of one board", 409, hints)


def _metrics(board: Board, sides: Sequence[Side]) -> Table:
    """Table with a row per record: rank, and every metric in the track's tables that has a direction, over all
    sequences."""
    keys = dict.fromkeys(
        column.key
        for column in (metric_column(board.metric), *STANDING_OF_TRACK[board.track], *OF_TRACK[board.track])
        if column.better and column.key in board.keys
    )
    loses = TRACKS[board.track].lost_below is not None
    columns = (
        Column("rank", "Rank", kind="number"),
        Column("method", "Method"),
        *(standing_column(key, board.track) for key in keys),
        *([lost_column(board.track, len(board.sequences))] if loses else []),
    )
    lines = []
    for side, rank in zip(sides, rank_cells([side.row for side in sides]), strict=True):
        of = board.runs_of(side.label)
        means = (numbers.finite(of.over(key, board.sequences)) for key in keys)
        name = Cell(side.label, path=record_path(side.row.digest), small=side.row.team)
        lost = [Cell(side.row.lost, kind="warn" if side.row.lost else "")] if loses else []
        lines.append(TableRow((rank, name, *means, *lost)))
    notes = ("Errors cover only what was estimated: read them together with coverage.",) if "coverage" in keys else ()
    if loses:
        notes = (lost_note(board.track),)
    return Table(f"Over {numbers.count(len(board.sequences), 'sequence')}", columns, tuple(lines), notes)


def _pairs(board: Board, info: BoardInfo, sides: Sequence[Side]) -> Table:
    """Table of whether the record of a row is better than that of a column, and by how much."""
    difference = numbers.difference_column(info.metric)
    columns = [Column("method", "Is this one better?"), *(Column(side.row.digest, side.label) for side in sides)]
    lines = []
    for a in sides:
        cells = [Cell(a.label)]
        for b in sides:
            if a is b:
                cells.append(Cell(None, ABSENT))
                continue
            found = board.runs_of(a.label).compare(board.runs_of(b.label), board.metric, board.sequences)
            verdict = found.verdict if found.interval.known else "too few to tell"
            signed = difference.resolving([found.interval])
            text = signed.text(numbers.finite(found.difference))
            about = f"{a.label} minus {b.label}; 95 %: {signed.text(found.interval)}"
            small = verdict if verdict in KINDS or not found.interval.known else "no difference shown"
            cells.append(Cell(found.difference, text, KINDS.get(verdict, "soft"), about, small))
        lines.append(TableRow(tuple(cells)))
    notes = (
        f"{metric_column(info.metric).heading} of the row minus that of the column, and whether the interval of the "
        "paired differences on the same sequences excludes zero (95 %, bootstrap; no correction for their number).",
    )
    return Table("Every two", tuple(columns), tuple(lines), notes, "pairs")
