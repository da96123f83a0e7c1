"""The first page: all boards, with who leads them."""

from __future__ import annotations

from dataclasses import asdict, dataclass

from oysterbench.results.records import plain
from oysterbench_leaderboard.board import BoardInfo, Query, Row
from oysterbench_leaderboard.site import numbers
from oysterbench_leaderboard.site.page import Cell, Column, Line, Page, Table
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
        scores = numbers.texts(info.metric, [row.score for row in rows])
        metric = numbers.heading(info.metric)
        card = Card(
            info, path, metric.text, numbers.count(info.entries, "record"), tuple(zip(ranks, rows, scores, strict=True))
        )
        cards.setdefault(numbers.track_name(info.track), []).append(card)
        first = rows[0] if rows else None
        lines.append(
            Line(
                (
                    Cell(info.track),
                    Cell(info.split, path=path),
                    Cell(info.evaluator_version),
                    Cell(str(info.entries), info.entries),
                    Cell(first.method, path=record_path(first.digest)) if first else Cell(numbers.ABSENT, ""),
                    Cell(scores[0] if first else numbers.ABSENT, first.score if first else ""),
                    Cell(metric.text, info.metric),
                    Cell(info.updated[:10], info.updated),
                    Cell(info.id),
                )
            )
        )
        data.append({"board": asdict(info), "path": board_path(info), "leaders": [asdict(row) for row in rows]})
    columns = (
        Column("track", "Track"),
        Column("split", "Split"),
        Column("evaluator", "Evaluator"),
        Column("records", "Records", number=True),
        Column("leader", "Leader"),
        Column("value", "Value", number=True),
        Column("metric", "Metric"),
        Column("updated", "Updated", "UTC"),
        Column("board", "Board", hidden=True),
    )
    table = Table("All boards", columns, tuple(lines), name="boards")
    return Page("/", "Boards", "home.html", {"cards": cards}, (table,), {"boards": plain(data)})
