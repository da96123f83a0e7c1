"""Indexes of boards, and all that is on their pages."""

from __future__ import annotations

from oysterbench_leaderboard.boards.board import BoardPage, Query
from oysterbench_leaderboard.boards.index import BoardIndex, open_index
from oysterbench_leaderboard.storage.store import RecordStore

ALL = Query(states=("current", "superseded", "withdrawn"))


def opened(store: RecordStore, name: str = "index.sqlite") -> BoardIndex:
    return open_index(store, str(store.folder.parent / name))


def pages(index: BoardIndex, query: Query = ALL) -> list[BoardPage]:
    return [index.page(board.id, query) for board in index.boards()]
