"""The first page: all boards, with who leads them."""

from __future__ import annotations

from dataclasses import asdict, dataclass

from oysterbench.report.columns import metric_column
from oysterbench.report.table import ABSENT, Cell, Column, Table, TableRow
from oysterbench.results.records import plain
from oysterbench_leaderboard.board import BoardInfo, Query, Row
from oysterbench_leaderboard.site import numbers
from oysterbench_leaderboard.site.page import Page
from oysterbench_leaderboard.site.pages.ranks import rank_cells
from oysterbench_leaderboard.site.paths import board_path, record_path, split_path
from oysterbench_leaderboard.site.site import Site

LEADERS = 3
"""Records of each board that are shown."""


@dataclass(frozen=True)
class Card:
    """A board on the first page. leaders: rank, row and score as shown."""

    info: BoardInfo
    path: str
    metric: str
    entries: str
    leaders: tuple[tuple[Cell, Row, str], ...]


def home_page(site: Site) -> Page:
    """The newest board of every split."""
    cards: dict[str, list[Card]] = {}
    lines, data = [], []
    for info in site.index.boards():
        if not info.newest:
            continue
        rows = site.index.page(info.id, Query(size=LEADERS)).rows
        path = split_path(info.track, info.split)
        ranks = rank_cells(rows)
        metric = metric_column(info.metric)
        scores = metric.texts([row.score for row in rows])
        card = Card(
            info,
            path,
            metric.heading,
            numbers.count(info.entries, "record"),
            tuple(zip(ranks, rows, scores, strict=True)),
        )
        cards.setdefault(numbers.track_name(info.track), []).append(card)
        first = rows[0] if rows else None
        lines.append(
            TableRow(
                (
                    Cell(info.track),
                    Cell(info.split, path=path),
                    Cell(info.evaluator_version),
                    Cell(info.entries),
                    Cell(first.method, path=record_path(first.digest)) if first else Cell("", ABSENT),
                    Cell(first.score, scores[0]) if first else Cell("", ABSENT),
                    Cell(info.metric, metric.heading),
                    Cell(info.updated, info.updated[:10]),
                    Cell(info.id),
                )
            )
        )
        data.append({"board": asdict(info), "path": board_path(info), "leaders": [asdict(row) for row in rows]})
    columns = (
        Column("track", "Track"),
        Column("split", "Split"),
        Column("evaluator", "Evaluator"),
        Column("records", "Records", kind="number"),
        Column("leader", "Leader"),
        Column("value", "Value", kind="number"),
        Column("metric", "Metric"),
        Column("updated", "Updated", "UTC"),
        Column("board", "Board", hidden=True),
    )
    table = Table("All boards", columns, tuple(lines), name="boards")
    return Page("/", "Boards", "home.html", {"cards": cards}, (table,), {"boards": plain(data)})
