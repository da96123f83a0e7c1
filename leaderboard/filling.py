"""Filling the tables of the index: board by board, all of them or those that something new has come to."""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import orjson
from sqlalchemy import Connection, delete, insert, select
from sqlalchemy.orm import aliased

from oysterbench.results.comparison import PRIMARY
from oysterbench.version import VERSION
from oysterbench_leaderboard.building import Before, board_rows, by_board, evaluator_order, read
from oysterbench_leaderboard.intake import COLUMNS, Kept
from oysterbench_leaderboard.ranking import Answers, Map
from oysterbench_leaderboard.schema import ANSWERS, BOARDS, META, PROBLEMS, ROWS, SCHEMA
from oysterbench_leaderboard.states import Claim, states, withdrawn
from oysterbench_leaderboard.store import RecordStore

MOST_ROWS = 2000  # inserted by one statement


def schema() -> str:
    """What an index must be of to be used by this version."""
    columns = hashlib.sha256(json.dumps(COLUMNS).encode()).hexdigest()[:8]
    return f"{SCHEMA} {VERSION} {columns}"


def meta(connection: Connection) -> dict[str, str]:
    """What an index says of itself."""
    return {row[0]: row[1] for row in connection.execute(select(META.c.key, META.c.value))}


def inputs_of(store: RecordStore) -> str:
    """Names all that an index is made of."""
    made_of = hashlib.sha256(schema().encode())
    for digest in (*store.digests(), "notices", *store.notice_digests()):
        made_of.update(digest.encode())
    return made_of.hexdigest()


def _claim(kept: Kept) -> Claim:
    return Claim(kept.digest, kept.board, kept.method, kept.team, kept.created, kept.supersedes)


def _insert(connection: Connection, table: Any, rows: Sequence[dict[str, Any]]) -> None:
    for i in range(0, len(rows), MOST_ROWS):
        connection.execute(insert(table), rows[i : i + MOST_ROWS])


def insert_board(
    connection: Connection,
    kept: Sequence[Kept],
    state: Mapping[str, Any],
    using: Map = map,
    before: Before | None = None,
) -> None:
    """A board and all its records; `finish` says which boards are the newest. before: the board as it was."""
    info, rows = board_rows(kept, state, using, before)
    missing = {f"m{i}": None for i in range(len(COLUMNS[info["track"]]), len(ROWS.c))}
    blank = {key: value for key, value in missing.items() if key in ROWS.c}
    _insert(connection, ROWS, [{**blank, **row} for row in rows])
    _insert(connection, ANSWERS, [{"digest": one.digest, "data": orjson.dumps(one).decode()} for one in kept])
    names = json.dumps(info["sequences"])
    connection.execute(insert(BOARDS), {**info, "sequences": names, "position": 0, "newest": False})


def finish(connection: Connection, problems: Mapping[str, str], inputs: str) -> None:
    """The order of boards, what was left out, and the name of what the index now is."""
    found = [dict(row) for row in connection.execute(select(BOARDS)).mappings()]
    tracks = list(PRIMARY)
    found.sort(key=lambda b: (-b["entries"], b["id"]))
    found.sort(key=lambda b: (evaluator_order(b["evaluator_version"]), b["entries"] > 0), reverse=True)
    found.sort(key=lambda b: (tracks.index(b["track"]), b["split"]))
    latest: dict[tuple[str, str, str], Any] = {}
    for board in found:
        key, order = (board["track"], board["split"], board["split_digest"]), board["evaluator_version"]
        latest[key] = max(latest.get(key, order), order, key=evaluator_order)
    for position, board in enumerate(found):
        newest = latest[board["track"], board["split"], board["split_digest"]] == board["evaluator_version"]
        changed = BOARDS.update().where(BOARDS.c.id == board["id"]).values(position=position, newest=newest)
        connection.execute(changed)
    connection.execute(delete(PROBLEMS))
    _insert(connection, PROBLEMS, [{"file": file, "reason": why} for file, why in sorted(problems.items())])
    connection.execute(delete(META))
    named = hashlib.sha256(f"{inputs} {sorted(problems)}".encode()).hexdigest()[:16]
    _insert(
        connection,
        META,
        [{"key": k, "value": v} for k, v in (("schema", schema()), ("revision", named), ("inputs", inputs))],
    )


def take_in(connection: Connection, store: RecordStore) -> None:
    """Take in what has come into the store, or left it, since; in the caller's transaction."""
    inputs, present = inputs_of(store), store.digests()
    notices, problems = store.read_notices()
    gone = withdrawn(notices)
    known: dict[str, str] = {row[0]: row[1] for row in connection.execute(select(ROWS.c.digest, ROWS.c.state))}
    new, wrong = read(store.folder / "records", [digest for digest in present if digest not in known])
    lost = known.keys() - set(present)
    changed = {digest for digest, state in known.items() if (state == "withdrawn") != (digest in gone)} | lost
    touched = {one.board for one in new} | _boards_of(connection, changed)
    touched |= _boards_of(connection, {one.supersedes for one in new if one.supersedes})
    touched |= _boards_of(connection, _superseded_by(connection, changed))

    kept = new + [one for board in sorted(touched) for one in _kept(connection, board) if one.digest not in lost]
    others = [] if not touched else _naming(connection, touched, lost)
    state = states(map(_claim, kept), gone, others)
    before = {board: _before(connection, board) for board in touched}
    for board in sorted(touched):
        here = select(ROWS.c.digest).where(ROWS.c.board == board).scalar_subquery()
        connection.execute(delete(ANSWERS).where(ANSWERS.c.digest.in_(here)))
        connection.execute(delete(ROWS).where(ROWS.c.board == board))
        connection.execute(delete(BOARDS).where(BOARDS.c.id == board))
    for board, of_board in by_board(kept).items():
        insert_board(connection, of_board, state, before=before[board])
    finish(connection, {**problems, **wrong}, inputs)


def _before(connection: Connection, board: str) -> Before | None:
    names = connection.scalar(select(BOARDS.c.sequences).where(BOARDS.c.id == board))
    if names is None:
        return None
    asked = select(ROWS.c.digest, ROWS.c.low, ROWS.c.high).where(ROWS.c.board == board)
    ends = {digest: (_nan(low), _nan(high)) for digest, low, high in connection.execute(asked)}
    return Before(json.loads(names), ends)


def _nan(value: float | None) -> float:
    """What is null in JSON and in the database."""
    return math.nan if value is None else value


def _boards_of(connection: Connection, digests: Iterable[str]) -> set[str]:
    wanted = sorted(digests)
    found: set[str] = set()
    for i in range(0, len(wanted), MOST_ROWS):
        asked = select(ROWS.c.board).where(ROWS.c.digest.in_(wanted[i : i + MOST_ROWS])).distinct()
        found |= set(connection.scalars(asked))
    return found


def _superseded_by(connection: Connection, digests: Iterable[str]) -> set[str]:
    """What some records name as superseded."""
    wanted = sorted(digests)
    found: set[str] = set()
    for i in range(0, len(wanted), MOST_ROWS):
        found |= set(connection.scalars(select(ROWS.c.supersedes).where(ROWS.c.digest.in_(wanted[i : i + MOST_ROWS]))))
    return found - {""}


def _kept(connection: Connection, board: str) -> list[Kept]:
    asked = select(ANSWERS.c.data).join(ROWS, ROWS.c.digest == ANSWERS.c.digest).where(ROWS.c.board == board)
    return [_kept_again(orjson.loads(data)) for data in connection.scalars(asked)]


def _kept_again(values: dict[str, Any]) -> Kept:
    lists = {key: tuple(values[key]) for key in ("about", "columns", "sequences")}
    found = values["answers"]
    of_sequences = {name: _nan(value) for name, value in found["values"].items()}  # JSON has no NaN
    return Kept(**{**values, **lists, "answers": Answers(**{**found, "values": of_sequences})})


def _naming(connection: Connection, boards: Iterable[str], lost: Iterable[str]) -> list[Claim]:
    """Records on any board that name one of these boards as superseded."""
    named = aliased(ROWS)
    asked = select(*(ROWS.c[key] for key in Claim.__slots__)).join(named, ROWS.c.supersedes == named.c.digest)
    found = [Claim(*row) for row in connection.execute(asked.where(named.c.board.in_(sorted(boards))))]
    left = set(lost)
    return [claim for claim in found if claim.digest not in left]


def fill(
    connection: Connection,
    kept: Sequence[Kept],
    store: RecordStore,
    wrong: Mapping[str, str],
    inputs: str,
    using: Map = map,
) -> None:
    """Put all records of a store, as they were read, into empty tables; wrong: those that cannot be used, and why."""
    notices, problems = store.read_notices()
    state = states(map(_claim, kept), withdrawn(notices))
    for board in by_board(kept).values():
        insert_board(connection, board, state, using)
    finish(connection, {**problems, **wrong}, inputs)
