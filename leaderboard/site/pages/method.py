"""Page of a method: all its published records, on every board."""

from __future__ import annotations

from dataclasses import asdict, replace

from oysterbench.core.errors import ResultError
from oysterbench.report.columns import metric_column
from oysterbench.report.table import Cell, Column, Table, TableRow
from oysterbench.results.records import plain
from oysterbench_leaderboard.boards.board import BoardInfo, Row
from oysterbench_leaderboard.site import numbers
from oysterbench_leaderboard.site.page import Page, PageError
from oysterbench_leaderboard.site.pages.ranks import ABOUT_TIERS, rank_cells, state_mark
from oysterbench_leaderboard.site.paths import board_path, method_path, record_path
from oysterbench_leaderboard.site.site import Site


def find_method(site: Site, slug: str) -> tuple[str, list[Row]]:
    """Find a method's name and rows by its slug. Raises PageError."""
    name = site.methods().get(slug, slug)
    try:
        rows = site.index.method(name)
    except ResultError:
        rows = []
    if not rows:
        raise PageError(f"no record of a method {slug!r}", hints={"/": "all boards, with their methods"})
    return name, rows


def method_page(site: Site, slug: str) -> Page:
    """Page of a method: current records first, each with its rank on its board, then superseded and withdrawn ones. Of
    several teams that have published under its name, each one's description stands by its own name."""
    name, rows = find_method(site, slug)
    boards = {info.id: info for info in site.index.boards()}
    order = {board: i for i, board in enumerate(boards)}
    rows = [row for row in rows if row.board in boards]
    current = sorted((row for row in rows if row.state == "current"), key=lambda row: order[row.board])
    past = [row for row in rows if row.state != "current"]
    tables = [_table(boards, current, f"Current records of {name}", "current")]
    if past:
        tables.append(_table(boards, past, f"Superseded and withdrawn records of {name}", "past"))
    teams = list(dict.fromkeys(row.team for row in rows))
    described = current or past
    had = dict.fromkeys(row.team for row in sorted(described, key=lambda row: row.created))  # who had the name first
    newest = {team: next(row for row in described if row.team == team) for team in had}
    return Page(
        method_path(name),
        name,
        "method.html",
        {"name": name, "newest": newest},
        tuple(tables),
        plain({"method": name, "teams": teams, "records": [asdict(row) for row in (*current, *past)]}),
    )


def _table(boards: dict[str, BoardInfo], rows: list[Row], title: str, name: str) -> Table:
    columns = (
        Column("board", "Board"),
        Column("rank", "Rank", "of records", "number"),
        Column("metric", "Metric"),
        Column("value", "Value", kind="number"),
        Column("interval", "Interval", numbers.LEVEL, "interval"),
        metric_column("coverage"),
        Column("failures", "Failed", "runs", "number"),
        Column("evaluator", "Evaluator"),
        Column("team", "Team"),
        Column("tier", "Tier"),
        Column("created", "Record", "UTC"),
        Column("record", hidden=True),
        Column("state", hidden=True),
    )
    lines = []
    for row in rows:
        info = boards[row.board]
        rank = rank_cells([row])[0]
        metric = metric_column(info.metric)
        interval = numbers.interval(row.low, row.high)
        lines.append(
            TableRow(
                (
                    Cell(info.split, path=board_path(info), small=info.track),
                    rank if row.place is None else replace(rank, text=f"{rank.text} of {info.entries}"),
                    Cell(info.metric, metric.heading),
                    Cell(row.score, metric.text(row.score)),
                    Cell(
                        interval,
                        metric.text(interval),
                        bar=numbers.bar(row.low, row.score, row.high),
                        kind="soft",
                    ),
                    row.coverage,
                    Cell(row.failures, f"{row.failures} of {row.runs}", kind="warn" if row.failures else ""),
                    Cell(info.evaluator_version),
                    Cell(row.team),
                    Cell(row.tier, about=ABOUT_TIERS.get(row.tier, "")),
                    Cell(row.created, row.created[:10], path=record_path(row.digest), mark=state_mark(row)),
                    Cell(row.digest),
                    Cell(row.state),
                ),
                "" if row.state == "current" else row.state,
            )
        )
    return Table(title, columns, tuple(lines), name=name)
