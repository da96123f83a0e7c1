"""Ranks and tiers as tables show them."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

from oysterbench_leaderboard.board import BoardInfo, Query, Row
from oysterbench_leaderboard.site import numbers
from oysterbench_leaderboard.site.page import Cell
from oysterbench_leaderboard.site.site import Site

TIERS = {
    "baseline": "Run and scored by us, from this project's own tree.",
    "scored": "Estimates of others, scored by a server against truth that they need not have seen.",
    "reported": "Results that their authors computed themselves.",
}
"""Tier -> who vouches for the numbers."""

TIED = "Shares its rank: not told from the first of the group by a paired bootstrap over sequences (95 %)."
UNTOLD = "A place by the mean alone: on so few sequences nothing can be told apart."


def rank_cells(site: Site, info: BoardInfo, rows: Sequence[Row]) -> list[Cell]:
    """The rank of each row, an equals sign before those that are shared; a place in brackets where nothing can be told
    apart."""
    known = Counter(row.rank for row in rows)
    cells = []
    for i, row in enumerate(rows):
        if row.place is None:
            cells.append(Cell(numbers.ABSENT, "", about=row.state))
        elif row.rank is None:
            cells.append(Cell(f"({row.place})", row.place, about=UNTOLD, kind="rank"))
        else:
            tied = known[row.rank] > 1 or row.rank < row.place
            if not tied and i == len(rows) - 1:
                tied = _next_shares(site, info, row)
            cells.append(
                Cell(f"={row.rank}" if tied else str(row.rank), row.rank, about=TIED if tied else "", kind="rank")
            )
    return cells


def state_mark(row: Row) -> str:
    """What must be said of a record that is not current."""
    return "" if row.state == "current" else row.state


def _next_shares(site: Site, info: BoardInfo, row: Row) -> bool:
    """Whether the row that follows on the whole board, and is not shown, is of the same group."""
    if row.place is None or row.place >= info.entries:
        return False
    following = site.index.page(info.id, Query(page=row.place + 1, size=1)).rows
    return any(other.rank == row.rank for other in following)
