"""Writing the index: records that come into the store or leave it, which of them are current, and their ranks."""

from __future__ import annotations

import hashlib
import json
import math
import re
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from string import digits
from typing import Any

import msgspec
from sqlalchemy import Connection, bindparam, delete, func, insert, select, tuple_, update

from oysterbench.core.errors import ResultError
from oysterbench.evaluate.metrics import FAILED
from oysterbench.results.records import comparable_key
from oysterbench.results.standings import PRIMARY, ScoreTable, direction
from oysterbench.version import VERSION
from oysterbench_leaderboard.board import BoardInfo
from oysterbench_leaderboard.database import CONTENTS, METADATA, ROWS
from oysterbench_leaderboard.record import RANKED, Record
from oysterbench_leaderboard.record_summary import (
    COLUMNS,
    RecordSummary,
    column_means,
    data_set_value,
    read_record,
    said_of_method,
    summarise_record,
)
from oysterbench_leaderboard.store import RecordStore, StatusChange

SCHEMA = f"10 {VERSION} {hashlib.sha256(json.dumps(COLUMNS).encode()).hexdigest()[:8]}"
"""Changes with every change of a table, or of what is put into it: an index of another is made anew."""

CHUNK = 1000
"""Records that are read at a time."""

Progress = Callable[[int, int], None]
"""Called with what is done, and of how much."""


class Contents(msgspec.Struct, frozen=True):
    """What an index holds beside its rows.

    inputs: names all that it is made of; revision: changes whenever any answer does
    boards: by their ids, in order; problems: files that were left out, by their digest: why
    """

    schema: str = ""
    inputs: str = ""
    revision: str = ""
    boards: dict[str, BoardInfo] = {}
    problems: dict[str, str] = {}


def inputs_of(store: RecordStore) -> str:
    """Names all that an index is made of."""
    names = (SCHEMA, *store.names("records"), "changes", *store.names("changes"))
    return hashlib.sha256("".join(names).encode()).hexdigest()


def write(connection: Connection, store: RecordStore, anew: bool, progress: Progress | None = None) -> None:
    """Bring the index up to what the store holds, in the caller's transaction: all of it `anew`, or else what has come
    or gone. Only boards with a record whose state changed are ranked again, here and not when a page is asked for:
    that takes seconds for tens of thousands of records."""
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
        ranked = _rank(connection, boards.pop(board))
        boards |= {board: ranked} if ranked else {}
    revision = hashlib.sha256(f"{inputs} {sorted(problems)}".encode()).hexdigest()[:16]
    now = Contents(SCHEMA, inputs, revision, {board.id: board for board in _in_order(boards.values())}, problems)
    connection.execute(delete(CONTENTS))
    connection.execute(insert(CONTENTS), {"data": msgspec.json.encode(now).decode()})


def withdrawn(changes: Iterable[StatusChange]) -> set[str]:
    """Digests of the records whose latest change withdraws them; changes in any order."""
    latest = {change.record: change.action for change in sorted(changes, key=StatusChange.order)}
    return {digest for digest, action in latest.items() if action == "withdrawn"}


def _add(
    connection: Connection,
    store: RecordStore,
    digests: Sequence[str],
    boards: dict[str, BoardInfo],
    progress: Progress | None,
) -> dict[str, str]:
    """Put records in, without state and rank, and boards that they are the first of; those that cannot be used, and
    why."""
    problems: dict[str, str] = {}
    for start in range(0, len(digests), CHUNK):
        rows = []
        for digest in digests[start : start + CHUNK]:
            try:
                record = read_record((store.folder / "records" / f"{digest}.json").read_bytes(), digest)
                rows.append(_row(record, digest))
            except (ResultError, OSError) as error:
                problems[digest] = str(error)
                continue
            if record.board not in boards:
                boards[record.board] = _board(record)
        if rows:
            connection.execute(insert(ROWS), rows)
        if progress is not None:
            progress(min(start + CHUNK, len(digests)), len(digests))
    return problems


def _board(record: Record) -> BoardInfo:
    track, split, recipe, evaluator, settings = comparable_key(record.results[0])
    about = (record.board, track, split, recipe, evaluator, json.loads(settings), PRIMARY[track], COLUMNS[track])
    return BoardInfo(*about, sequences=(), entries=0, updated="", newest=False)


def _row(record: Record, digest: str) -> dict[str, Any]:
    summary = summarise_record(record)
    same = ("board", "method", "team", "tier", "url", "summary", "created", "supersedes")
    return {
        "digest": digest,
        **{key: getattr(record, key) for key in same},
        "words": f"{record.method}\n{record.team}".casefold(),
        "data_set": data_set_value(record),
        "metrics": column_means(record),
        **said_of_method(record),
        "sequences": len(summary.sequences),
        "runs": len(record.results),
        "summary_data": msgspec.json.encode(summary).decode(),
    }


def _set_states(connection: Connection, gone: set[str]) -> set[str]:
    """Say which records are current; the boards on which one's state changed.

    A record is superseded by any of the same team that names it, on its own board or another (a new evaluator has a
    board of its own), or by the latest created one of its method, team and board; of two of one second the greater
    digest is the later. A withdrawn record (one of `gone`) supersedes nothing: what it took the place of comes back.
    """
    there = ROWS.c.digest.not_in(gone)
    named = select(ROWS.c.supersedes, ROWS.c.team).where(there, ROWS.c.supersedes != "")
    latest = func.row_number().over(
        partition_by=(ROWS.c.board, ROWS.c.method, ROWS.c.team), order_by=(ROWS.c.created.desc(), ROWS.c.digest.desc())
    )
    claims = select(ROWS.c.digest, latest.label("age"))
    claims = claims.where(there, tuple_(ROWS.c.digest, ROWS.c.team).not_in(named))
    found = claims.subquery()
    current = set(connection.scalars(select(found.c.digest).where(found.c.age == 1)))
    touched, changed = set(), []
    for digest, board, state in connection.execute(select(ROWS.c.digest, ROWS.c.board, ROWS.c.state)):
        now = "withdrawn" if digest in gone else "current" if digest in current else "superseded"
        if now != state:
            touched.add(board)
            changed.append({"key": digest, "state": now})
    _for_each(connection, update(ROWS), changed)
    return touched


def _rank(connection: Connection, board: BoardInfo) -> BoardInfo | None:
    """Score, interval, place and rank of a board's records; the board as it is now, None where it has none.

    Its sequences are those of the ranked records, or of the current ones, or of all where there are no others: what was
    withdrawn takes no part. What is self-reported is not ranked: anybody can write a number down. It has a score alone,
    as have records that are not current, and follows in the order of the scores.
    """
    keys = ("digest", "state", "tier", "created", "low", "high", "summary_data")
    asked = select(*(ROWS.c[key] for key in keys)).where(ROWS.c.board == board.id).order_by(ROWS.c.digest)
    found = connection.execute(asked).all()
    if not found:
        return None
    summaries = [RecordSummary.decode(row.summary_data) for row in found]
    current = [k for k, row in enumerate(found) if row.state == "current"]
    ranked = [k for k in current if found[k].tier in RANKED]
    sequences = sorted({name for k in ranked or current or range(len(found)) for name in summaries[k].sequences})
    table = ScoreTable.of([summary.scores for summary in summaries], sequences, board.track)
    means = table.means().tolist()
    # An interval costs half a millisecond; it stays while the board's sequences do, and the record has them all.
    intervals = {
        k: (row.low, row.high)
        for k, row in enumerate(found)
        if row.low is not None
        and board.sequences == tuple(sequences)
        and summaries[k].scores.values.keys() >= set(sequences)
    }
    new = [k for k in range(len(found)) if k not in intervals]
    intervals |= dict(zip(new, table.take(new).intervals().tolist(), strict=True))
    better = direction(board.metric)
    standings = dict(zip(ranked, table.take(ranked).standings(better), strict=True)) if ranked else {}
    shared = Counter(standing.rank or standing.place for standing in standings.values())
    rows: list[dict[str, Any]] = []
    for k, (row, summary) in enumerate(zip(found, summaries, strict=True)):
        standing = standings.get(k)
        place, rank = (standing.place, standing.rank) if standing else (None, None)
        low, high = map(_number, intervals[k])
        coverage = _coverage(summary, sequences, board.track)
        failures = summary.failed + len(set(sequences) - set(summary.sequences))
        values = {"score": _number(means[k]), "low": low, "high": high, "coverage": coverage, "failures": failures}
        tied = place is not None and shared[rank or place] > 1
        rows.append({"key": row.digest, "place": place, "rank": rank, "tied": tied, **values})
    sign = 1 if better == "lower" else -1
    rows.sort(key=lambda r: (r["place"] is None, r["score"] is None, sign * (r["score"] or 0), r["key"]))
    _for_each(connection, update(ROWS), [{**row, "position": position} for position, row in enumerate(rows)])
    updated = max(found[k].created for k in current or range(len(found)))
    return replace(board, sequences=tuple(sequences), entries=len(current), updated=updated)


def _number(value: float | None) -> float | None:
    return None if value is None or math.isnan(value) else value


def _coverage(summary: RecordSummary, sequences: Iterable[str], track: str) -> float | None:
    lacking = FAILED[track].get("coverage")
    values = [summary.coverage.get(name, None if name in summary.sequences else lacking) for name in sequences]
    known = [value for value in values if value is not None]
    return math.fsum(known) / len(known) if known else None


def _in_order(boards: Iterable[BoardInfo]) -> list[BoardInfo]:
    """Tracks in order, of a split the newest evaluator first; each with whether it is the newest of its recipe."""
    found, tracks = list(boards), list(PRIMARY)
    latest: dict[tuple[str, ...], str] = {}
    for board in found:
        recipe = (board.track, board.split, board.split_digest)
        latest[recipe] = max(latest.get(recipe, ""), board.evaluator_version, key=evaluator_order)
    found.sort(key=lambda b: (-b.entries, b.id))
    found.sort(key=lambda b: (evaluator_order(b.evaluator_version), b.entries > 0), reverse=True)
    found.sort(key=lambda b: (tracks.index(b.track), b.split))
    newest = [latest[b.track, b.split, b.split_digest] == b.evaluator_version for b in found]
    return [replace(board, newest=new) for board, new in zip(found, newest, strict=True)]


def evaluator_order(version: str) -> tuple[tuple[int, int, str], ...]:
    """A key by which "slam 10" is later than "slam 9"."""
    parts = re.findall(r"[0-9]{1,18}|[^0-9]+", version)
    return tuple((1, int(part), "") if part[0] in digits else (0, 0, part) for part in parts)


def _for_each(connection: Connection, statement: Any, rows: Sequence[dict[str, Any]]) -> None:
    """Change or delete the row whose digest is the `key` of each; rows have equal keys."""
    if rows:
        values: dict[str, Any] = {key: bindparam(key) for key in rows[0] if key != "key"}
        changed = statement.where(ROWS.c.digest == bindparam("key"))
        connection.execute(changed.values(values) if values else changed, list(rows))
