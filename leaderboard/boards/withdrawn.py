"""Withdrawn records that others were scored again from, or made of: what is not to come back on another evaluator's
board."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress

from oysterbench.core.errors import OysterbenchError
from oysterbench_leaderboard.boards.board import Query, Row
from oysterbench_leaderboard.boards.index import BoardIndex
from oysterbench_leaderboard.storage.record import Record


def withdrawn_successors(index: BoardIndex) -> dict[str, list[Record]]:
    """Digest of a record -> withdrawn ones that had superseded it."""
    found: dict[str, list[Record]] = {}
    for board in index.boards():
        for row in index.page(board.id, Query(states=("withdrawn",), size=1_000_000)).rows:
            if row.supersedes:
                with suppress(OysterbenchError):  # a damaged one is named where it is read for its own sake
                    found.setdefault(row.supersedes, []).append(index.store.record(row.digest))
    return found


def withdrawn_with(row: Row, estimates: Mapping[str, str], withdrawn: Mapping[str, list[Record]]) -> str:
    """Why a record is not to come back by being scored again; empty where it may: withdrawn are the estimates, not one
    evaluator's score of them."""
    if row.state == "withdrawn":
        return f"it is withdrawn; `oysterbench leaderboard restore {row.digest[:8]}` comes first"
    same = next((one for one in withdrawn.get(row.digest, ()) if dict(one.estimates) == dict(estimates)), None)
    if same is None:
        return ""
    return (
        f"{same.digest[:8]}, scored from the same estimates, is withdrawn; restore that one, or withdraw this one, too"
    )
