"""Writing the index: records added to or removed from the store, which of them are current, and their ranks."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Sequence
from typing import Any

import msgspec
from sqlalchemy import Connection, bindparam, delete, insert, select, update

from oysterbench.core.errors import ResultError
from oysterbench.version import VERSION
from oysterbench_leaderboard.boards.board import BoardInfo
from oysterbench_leaderboard.boards.database import CONTENTS, METADATA, ROWS
from oysterbench_leaderboard.boards.ranking import (
    Claim,
    Ranked,
    board_of,
    in_order,
    rank,
    read_columns,
    states,
    withdrawn,
)
from oysterbench_leaderboard.storage.record_summary import COLUMNS, RecordSummary
from oysterbench_leaderboard.storage.store import RecordStore

SCHEMA = f"17 {VERSION} {hashlib.sha256(json.dumps(COLUMNS).encode()).hexdigest()[:8]}"
"""Changes with every change of a table or of its contents: an index with another value is rebuilt."""

CHUNK = 1000
"""Number of records read at a time."""

Progress = Callable[[int, int], None]
"""Called with the number of records done, and of all."""


class Contents(msgspec.Struct, frozen=True):
    """What an index holds besides its rows.

    inputs: digest that identifies everything it is made from; revision: changes whenever any answer does
    boards: by id, in order; problems: digests of files that were left out -> reason
    """

    schema: str = ""
    inputs: str = ""
    revision: str = ""
    boards: dict[str, BoardInfo] = {}
    problems: dict[str, str] = {}


def inputs_of(store: RecordStore) -> str:
    """Digest that identifies everything an index is made from."""
    names = (SCHEMA, *store.names("records"), "changes", *store.names("changes"))
    return hashlib.sha256("".join(names).encode()).hexdigest()


def write(connection: Connection, store: RecordStore, anew: bool, progress: Progress | None = None) -> None:
    """Bring the index up to date with the store, in the caller's transaction: all of it if `anew`, else only what was
    added or removed. Only boards with a record whose state changed are ranked again. This is done here and not when a
    page is requested, as it takes seconds for tens of thousands of records."""
    before = msgspec.json.decode(connection.scalar(select(CONTENTS.c.data)) or "{}", type=Contents)
    if before.schema != SCHEMA:
        METADATA.drop_all(connection)
        METADATA.create_all(connection)
    if anew or before.schema != SCHEMA:
        connection.execute(delete(ROWS))
        before = Contents()
    inputs, present = inputs_of(store), store.names("records")
    changes, problems = store.read_status_changes()
    old = {row.digest: row for row in connection.execute(select(ROWS.c.digest, ROWS.c.board, ROWS.c.state))}
    gone = old.keys() - set(present)
    touched = {old[digest].board for digest in gone}
    _for_each(connection, delete(ROWS), [{"key": digest} for digest in sorted(gone)])
    boards = dict(before.boards)
    problems |= _add(connection, store, [digest for digest in present if digest not in old], boards, progress)
    touched |= _set_states(connection, withdrawn(changes))
    for board in sorted(touched):
        try:
            ranked = _rank(connection, boards.pop(board))
        except (ArithmeticError, ValueError) as error:  # the other boards must go on
            problems |= _leave_out(connection, board, f"its board could not be ranked: {error}")
            continue
        boards |= {board: ranked} if ranked else {}
    revision = hashlib.sha256(f"{inputs} {sorted(problems)}".encode()).hexdigest()[:16]
    now = Contents(SCHEMA, inputs, revision, {board.id: board for board in in_order(boards.values())}, problems)
    connection.execute(delete(CONTENTS))
    connection.execute(insert(CONTENTS), {"data": msgspec.json.encode(now).decode()})


def _add(
    connection: Connection,
    store: RecordStore,
    digests: Sequence[str],
    boards: dict[str, BoardInfo],
    progress: Progress | None,
) -> dict[str, str]:
    """Insert records, without state and rank, and add the boards that are new with them; return the digests of records
    that cannot be used -> reason."""
    problems: dict[str, str] = {}
    for start in range(0, len(digests), CHUNK):
        rows = []
        for digest in digests[start : start + CHUNK]:
            try:
                record, columns, summary = read_columns(store, digest)
            except ResultError as error:
                problems[digest] = str(error)
                continue
            rows.append({**columns, "summary_data": msgspec.json.encode(summary).decode()})
            if record.board not in boards:
                boards[record.board] = board_of(record)
        if rows:
            connection.execute(insert(ROWS), rows)
        if progress is not None:
            progress(min(start + CHUNK, len(digests)), len(digests))
    return problems


def _set_states(connection: Connection, gone: set[str]) -> set[str]:
    """Update the states of all records; return the ids of boards on which one changed."""
    keys = list(Claim.__dataclass_fields__)
    found = connection.execute(select(*(ROWS.c[key] for key in keys), ROWS.c.state)).all()
    now = states((Claim(*row[: len(keys)]) for row in found), gone)
    changed = [row for row in found if row.state != now[row.digest]]
    _for_each(connection, update(ROWS), [{"key": row.digest, "state": now[row.digest]} for row in changed])
    return {row.board for row in changed}


def _rank(connection: Connection, board: BoardInfo) -> BoardInfo | None:
    """Rank a board's records; return the updated board, or None where it has no records."""
    keys = ("digest", "state", "team", "tier", "created", "low", "high")
    columns = (ROWS.c[key] for key in (*keys, "summary_data"))
    asked = select(*columns).where(ROWS.c.board == board.id).order_by(ROWS.c.digest)
    found = [
        Ranked(**{key: row[key] for key in keys}, summary=RecordSummary.decode(row["summary_data"]))
        for row in connection.execute(asked).mappings()
    ]
    if not found:
        return None
    board, rows = rank(board, found)
    _for_each(connection, update(ROWS), rows)
    return board


def _leave_out(connection: Connection, board: str, reason: str) -> dict[str, str]:
    """Remove all records of a board; return their digests -> reason."""
    digests = connection.scalars(select(ROWS.c.digest).where(ROWS.c.board == board)).all()
    connection.execute(delete(ROWS).where(ROWS.c.board == board))
    return dict.fromkeys(digests, reason)


def _for_each(connection: Connection, statement: Any, rows: Sequence[dict[str, Any]]) -> None:
    """Execute an update or deletion for the row whose digest is the `key` of each; all dictionaries have the same
    keys."""
    if rows:
        values: dict[str, Any] = {key: bindparam(key) for key in rows[0] if key != "key"}
        changed = statement.where(ROWS.c.digest == bindparam("key"))
        connection.execute(changed.values(values) if values else changed, list(rows))
