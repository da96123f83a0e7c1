"""Records for `oysterbench compare`, found by digest or as a method on a board."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace

from oysterbench.core.errors import ResultError
from oysterbench.core.names import did_you_mean, listed, nearest
from oysterbench.results.records import ResultRecord
from oysterbench_leaderboard.boards.board import LEAST_DIGITS, BoardReader, Query, Row
from oysterbench_leaderboard.boards.tables import SHORT
from oysterbench_leaderboard.commands.options import Place

MOST_NAMED = 20
"""Number of first methods of a board that are listed to a user who names an unknown one."""

_DIGEST = re.compile(f"[0-9a-f]{{{LEAST_DIGITS},64}}")


def results_of(text: str, split: str | None, place: Place | None = None) -> list[ResultRecord] | None:
    """Results of a method on the board, or of a record by its digest; None where the text can only be a file name.

    split: only results on this split, if given. A record given by its digest has the digest added to its method's name,
    as it may be compared with another of the same method. Raises ResultError where no record matches, or several do.
    """
    index = (place or Place()).reader()
    rows = [row for row in index.method(text) if row.state == "current"]
    if rows:
        return [
            r for row in _one_of_each_board(text, rows, index, split) for r in index.store.record(row.digest).results
        ]
    if not _DIGEST.fullmatch(text):
        if "/" in text or text.endswith(".json"):
            return None
        meant = did_you_mean(nearest(text, [name for name, _, _ in index.methods()]))
        raise ResultError(f"{text}: is neither a file nor a method on the board; {meant}{_methods(index, split)}")
    record = index.store.record(index.row(text).digest)
    if split is not None and record.split != split:
        raise ResultError(f"{text}: is a record on {record.split}, not on {split}")
    return [replace(result, method=f"{record.method} {record.digest[:SHORT]}") for result in record.results]


def _methods(index: BoardReader, split: str | None) -> str:
    """Text for a message that lists the methods there are, on a split if given."""
    boards = [board for board in index.boards() if board.newest and split in (None, board.split)]
    there = sorted({row.method for board in boards for row in index.page(board.id, Query(size=MOST_NAMED)).rows})
    return f"the methods{f' on {split}' if split else ''} are: {listed(there, MOST_NAMED) if there else 'none yet'}"


def _one_of_each_board(text: str, rows: Sequence[Row], index: BoardReader, split: str | None) -> list[Row]:
    boards = {board.id: board for board in index.boards() if board.newest}
    chosen = [row for row in rows if row.board in boards and split in (None, boards[row.board].split)]
    if not chosen:
        there = ", ".join(dict.fromkeys(board.split for board in boards.values())) or "none"
        raise ResultError(f"{text} is on no board of {split or 'the present evaluators'}; the splits are: {there}")
    teams = {row.team for row in chosen}
    if len(teams) > 1:
        named = listed(f"{row.digest[:SHORT]} ({row.team})" for row in chosen)
        raise ResultError(f"several teams have a method named {text}: give the record, one of {named}")
    return chosen
