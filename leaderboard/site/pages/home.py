"""The home page: the data sets with a frame of each and their leaders, followed by all boards."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass

from oysterbench.report.columns import metric_column
from oysterbench.report.table import ABSENT, Bar, Cell, Column, Table, TableRow
from oysterbench.results.records import plain
from oysterbench_leaderboard.boards.board import BoardInfo, Query, Row
from oysterbench_leaderboard.boards.tables import LEADING, role_of
from oysterbench_leaderboard.site import numbers
from oysterbench_leaderboard.site.datasets import known
from oysterbench_leaderboard.site.frames import file_name, pictures
from oysterbench_leaderboard.site.page import Page
from oysterbench_leaderboard.site.pages.ranks import rank_cells
from oysterbench_leaderboard.site.paths import board_path, record_path, split_path
from oysterbench_leaderboard.site.site import Site

LEADERS = 5
"""Number of records shown of each board."""


@dataclass(frozen=True)
class Leader:
    """A record on the home page. score: as shown."""

    rank: Cell
    row: Row
    score: str
    bar: Bar | None


@dataclass(frozen=True)
class Card:
    """A board on the home page. name: the split, with the settings of the evaluator where it is not the first board of
    that split; about: description of its data."""

    info: BoardInfo
    path: str
    name: str
    metric: str
    entries: str
    about: str
    leaders: tuple[Leader, ...]


def home_page(site: Site) -> Page:
    """Home page with the newest board of every split: for each track the first split as a card, the others in a
    line."""
    cards: dict[str, list[Card]] = {}
    lines, data = [], []
    seen: set[tuple[str, str]] = set()
    for info in site.index.boards():
        if not info.newest:
            continue
        rows = site.index.page(info.id, Query(size=LEADERS)).rows
        card = _card(info, rows, first=(info.track, info.split) not in seen)
        seen.add((info.track, info.split))
        cards.setdefault(numbers.track_name(info.track), []).append(card)
        lines.append(_line(card))
        data.append({"board": asdict(info), "path": board_path(info), "leaders": [asdict(row) for row in rows]})
    for several in cards.values():
        several.sort(key=lambda card: (LEADING.index(role_of(card.info.split)), -card.info.entries))
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
    samples = list(pictures())
    context = {"cards": cards, "samples": samples, "frame_of": file_name}
    return Page("/", "Boards", "home.html", context, (table,), {"boards": plain(data)})


def _card(info: BoardInfo, rows: Sequence[Row], first: bool) -> Card:
    """Card of a board. first: whether it is the board that the address of its split shows."""
    metric = metric_column(info.metric)
    axis = numbers.bars_axis([(row.low, row.high) for row in rows])
    name = "" if axis is None else f"{metric.text(axis[0])} to {metric.text(axis[1])}"
    leaders = zip(rank_cells(rows), rows, metric.texts([row.score for row in rows]), strict=True)
    return Card(
        info,
        split_path(info.track, info.split) if first else board_path(info),
        info.split if first else f"{info.split}, {info.scored_by.partition(', ')[2] or info.split_digest[:8]}",
        metric.heading,
        numbers.count(info.entries, "record"),
        known()[info.split].summary if info.split in known() else "",
        tuple(
            Leader(rank, row, score, axis and numbers.bar(row.low, row.score, row.high, axis, name))
            for rank, row, score in leaders
        ),
    )


def _line(card: Card) -> TableRow:
    """Row of a board in the table of all boards."""
    info, first = card.info, card.leaders[0] if card.leaders else None
    absent = Cell("", ABSENT)
    return TableRow(
        (
            Cell(info.track),
            Cell(info.split, path=card.path),
            Cell(info.evaluator_version),
            Cell(info.entries),
            Cell(first.row.method, path=record_path(first.row.digest)) if first else absent,
            Cell(first.row.score, first.score) if first else absent,
            Cell(info.metric, card.metric),
            Cell(info.updated, info.updated[:10]),
            Cell(info.id),
        )
    )
