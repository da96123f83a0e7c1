"""The board that comes with oysterbench: what its baselines are compared on."""

from __future__ import annotations

from oysterbench_leaderboard.boards.board import Query
from oysterbench_leaderboard.boards.memory import MemoryIndex
from oysterbench_leaderboard.commands.options import Place


def test_baselines_of_a_board_have_the_same_sequences() -> None:
    """A sequence that is lacking counts as failed, which no baseline of ours should."""
    index = MemoryIndex(Place().store())
    boards = index.boards()
    assert boards
    lacking = []
    for board in boards:
        rows = index.page(board.id, Query(tiers=("baseline",), size=1000)).rows
        most = max((row.sequences for row in rows), default=0)
        lacking += [f"{row.method} on {board.split}: {row.sequences} of {most}" for row in rows if row.sequences < most]
    assert lacking == []
