"""Withdrawn records that others were scored again from, or made of: what is not to come back on another evaluator's
board."""

from __future__ import annotations

from collections.abc import Mapping

from oysterbench.core.errors import OysterbenchError, ResultError
from oysterbench_leaderboard.boards.board import Query, Row
from oysterbench_leaderboard.boards.index import BoardIndex
from oysterbench_leaderboard.storage.store import RecordStore


def withdrawn_successors(index: BoardIndex) -> dict[str, list[str]]:
    """Digest of a record -> those of withdrawn ones that had superseded it."""
    found: dict[str, list[str]] = {}
    for board in index.boards():
        for row in index.page(board.id, Query(states=("withdrawn",), size=1_000_000)).rows:
            if row.supersedes:
                found.setdefault(row.supersedes, []).append(row.digest)
    return found


def withdrawn_with(
    row: Row, estimates: Mapping[str, str], withdrawn: Mapping[str, list[str]], store: RecordStore
) -> str:
    """Why a record is not to come back by being scored again; empty where it may: withdrawn are the estimates, not one
    evaluator's score of them.

    withdrawn: as of `withdrawn_successors`. Raises ResultError where one of these cannot be read: it may have been
    scored from the same estimates.
    """
    if row.state == "withdrawn":
        return f"it is withdrawn; `oysterbench leaderboard restore {row.digest[:8]}` comes first"
    for digest in withdrawn.get(row.digest, ()):
        try:
            same = dict(store.record(digest).estimates) == dict(estimates)
        except OysterbenchError as error:
            raise ResultError(
                f"{digest[:8]}, which superseded it, is withdrawn and cannot be read ({error}): it may have been "
                "scored from the same estimates; put its file back from a backup, or withdraw this one, too"
            ) from None
        if same:
            return (
                f"{digest[:8]}, scored from the same estimates, is withdrawn; restore that one, or withdraw this one, "
                "too"
            )
    return ""
