"""Ranks and tiers as tables show them."""

from __future__ import annotations

from collections.abc import Sequence

from oysterbench.report.table import ABSENT, Cell
from oysterbench_leaderboard.boards.board import Row
from oysterbench_leaderboard.boards.tables import rank_text

ABOUT_TIERS = {
    "baseline": "Run and scored by us: this project's methods, and published systems.",
    "scored": "Estimates by others, scored by a server: against ground truth that they cannot have where the split is "
    "hidden, and that anyone can make where it is public.",
    "reported": "Results computed by their authors: shown, but not ranked.",
}
"""Tier -> who vouches for the numbers."""

RANK = (
    "1 + the number of methods that are significantly better (95 %, paired bootstrap), and at least the rank of any "
    "that counts and is placed above; of another team's submissions, only the best counts."
)
TIED = "A shared rank: other methods have the same one."
UNRANKED = "a place by the mean only: with so few sequences, no difference is significant."


def rank_cells(rows: Sequence[Row]) -> list[Cell]:
    """Cells with the rank of each row as `rank_text` writes it, and the reason; without a value where there is no
    rank."""
    cells = []
    for row in rows:
        if row.place is None:
            cells.append(Cell("", ABSENT, about=row.tier if row.state == "current" else row.state))
        elif row.rank is None:
            cells.append(Cell("", rank_text(row), about=UNRANKED.capitalize(), kind="rank"))
        else:
            cells.append(Cell(row.rank, rank_text(row), about=TIED if row.tied else "", kind="rank"))
    return cells


def state_mark(row: Row) -> str:
    """State of a record that is not current; empty for a current one."""
    return "" if row.state == "current" else row.state
