"""Page of the log: which records were withdrawn, restored, superseded or rescored, and why."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict

from oysterbench.report.columns import metric_column
from oysterbench.report.table import ABSENT, Cell, Column, Table, TableRow
from oysterbench.results.records import plain
from oysterbench_leaderboard.boards.board import Row
from oysterbench_leaderboard.site.history import MOST, Event, events
from oysterbench_leaderboard.site.page import Page
from oysterbench_leaderboard.site.paths import board_path, record_path
from oysterbench_leaderboard.site.site import Site


def log_page(site: Site) -> Page:
    """Page of all changes to records, latest first, and of the files that are on no board."""
    boards = {info.id: info for info in site.index.boards()}
    columns = (
        Column("created", "Date", "UTC"),
        Column("action", "What"),
        Column("method", "Method"),
        Column("split", "Split"),
        Column("score_before", "Score", "before", "number"),
        Column("score_after", "Score", "after", "number"),
        Column("by", "Record", "that superseded it"),
        Column("reason", "Why"),
        Column("record", hidden=True),
    )
    found = [event for event in events(site) if event.record.board in boards]
    lines = []
    for event in found:
        info = boards[event.record.board]
        scores = [row.score if row else None for row in (event.record, event.by)]
        shown = metric_column(info.metric).texts(scores)
        lines.append(
            TableRow(
                (
                    Cell(event.created, event.created[:10]),
                    Cell(event.action, kind="warn" if event.action == "withdrawn" else ""),
                    Cell(event.record.method, path=record_path(event.record.digest), small=event.record.team),
                    Cell(info.split, path=board_path(info), small=info.evaluator_version),
                    *map(Cell, scores, shown),
                    _link(event.by),
                    Cell(event.reason, event.reason or ABSENT, kind="wrap"),
                    Cell(event.record.digest),
                )
            )
        )
    notes = (
        f"Only the {MOST} latest superseded records of each board are listed; every record's page notes its status.",
    )
    table = Table("Changes to records", columns, tuple(lines), notes, "log")
    left_out = site.index.problems()
    data = {"events": [_plain(event) for event in found], "left_out": left_out}
    tables = (table, *([_left_out(left_out)] if left_out else []))
    return Page("/log", "Log", "log.html", {}, tables, plain(data))


def _left_out(problems: Mapping[str, str]) -> Table:
    columns = (Column("file", "File"), Column("why", "Why"))
    lines = tuple(TableRow((Cell(name), Cell(why, kind="wrap"))) for name, why in problems.items())
    return Table("Files that are on no board", columns, lines, name="left-out")


def _link(row: Row | None) -> Cell:
    return Cell("") if row is None else Cell(row.digest, row.digest[:8], path=record_path(row.digest))


def _plain(event: Event) -> dict[str, object]:
    return {
        "created": event.created,
        "action": event.action,
        "reason": event.reason,
        "record": asdict(event.record),
        "by": asdict(event.by) if event.by else None,
    }
