"""Writing the index: records that come into the store or leave it, which of them are current, and their ranks."""

from __future__ import annotations

import hashlib
import json
import math
import re
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, NamedTuple

import msgspec
from sqlalchemy import Connection, bindparam, delete, insert, select, update

from oysterbench.core.errors import ResultError
from oysterbench.evaluate.metrics import FAILED
from oysterbench.results.records import comparable_key
from oysterbench.results.standings import PRIMARY, ScoreTable, direction
from oysterbench.version import VERSION
from oysterbench_leaderboard.board import State
from oysterbench_leaderboard.database import BOARDS, META, MOST_COLUMNS, PROBLEMS, ROWS, SUMMARIES
from oysterbench_leaderboard.record import Record
from oysterbench_leaderboard.record_summary import COLUMNS, RecordSummary, read_record, summarise_record
from oysterbench_leaderboard.store import RecordStore, StatusChange

SCHEMA = "6"
"""Rises with every change of a table, or of what is put into it: an index of another is made anew."""

CHUNK = 1000
"""Records that are read, and rows that are written, at a time."""

Progress = Callable[[int, int], None]
"""Called with what is done, and of how much."""


class Claim(NamedTuple):
    """Of a record: what decides whether it is current."""

    digest: str
    board: str
    method: str
    team: str
    created: str
    supersedes: str


def schema() -> str:
    """What an index must be of to be used by this version."""
    columns = hashlib.sha256(json.dumps(COLUMNS).encode()).hexdigest()[:8]
    return f"{SCHEMA} {VERSION} {columns}"


def inputs_of(store: RecordStore) -> str:
    """Names all that an index is made of."""
    made_of = hashlib.sha256(schema().encode())
    for digest in (*store.names("records"), "changes", *store.names("changes")):
        made_of.update(digest.encode())
    return made_of.hexdigest()


def meta(connection: Connection) -> dict[str, str]:
    """What an index says of itself."""
    return {row[0]: row[1] for row in connection.execute(select(META.c.key, META.c.value))}


def write(connection: Connection, store: RecordStore, anew: bool, progress: Progress | None = None) -> None:
    """Bring the index up to what the store holds, in the caller's transaction: all of it `anew`, or else what has come
    or gone; only boards with a record whose state changed are ranked again."""
    for table in (ROWS, SUMMARIES, BOARDS) if anew else ():
        connection.execute(delete(table))
    inputs, present = inputs_of(store), store.names("records")
    changes, problems = store.read_status_changes()
    states = {row.digest: row.state for row in connection.execute(select(ROWS.c.digest, ROWS.c.state))}
    touched = _remove(connection, states.keys() - set(present))
    problems |= _add(connection, store, [digest for digest in present if digest not in states], progress)
    claims = [Claim(*row) for row in connection.execute(select(*(ROWS.c[key] for key in Claim._fields)))]
    now = states_of(claims, withdrawn(changes))
    changed = [claim for claim in claims if states.get(claim.digest) != now[claim.digest]]
    _update(connection, ROWS, [{"key": claim.digest, "state": now[claim.digest]} for claim in changed])
    for board in sorted(touched | {claim.board for claim in changed}):
        _rank(connection, board)
    _order_boards(connection)
    for table, rows in (
        (PROBLEMS, [{"file": file, "reason": why} for file, why in sorted(problems.items())]),
        (META, [{"key": key, "value": value} for key, value in _about(inputs, problems).items()]),
    ):
        connection.execute(delete(table))
        _insert(connection, table, rows)


def _about(inputs: str, problems: Mapping[str, str]) -> dict[str, str]:
    revision = hashlib.sha256(f"{inputs} {sorted(problems)}".encode()).hexdigest()[:16]
    return {"schema": schema(), "revision": revision, "inputs": inputs}


def withdrawn(changes: Iterable[StatusChange]) -> set[str]:
    """Digests of the records whose latest change withdraws them; changes in any order."""
    latest = {change.record: change.action for change in sorted(changes, key=StatusChange.order)}
    return {digest for digest, action in latest.items() if action == "withdrawn"}


def states_of(claims: Iterable[Claim], gone: set[str]) -> dict[str, State]:
    """Digest -> state.

    A record is superseded by any of the same team that names it, on its own board or another (a new evaluator has a
    board of its own), or by the latest created one of its method, team and board; of two of one second the greater
    digest is the later. A withdrawn record (one of `gone`) supersedes nothing: what it took the place of comes back.
    """
    known = list(claims)
    named = {(claim.supersedes, claim.team) for claim in known if claim.supersedes and claim.digest not in gone}
    states: dict[str, State] = {}
    latest: dict[tuple[str, str, str], Claim] = {}
    for claim in sorted(known, key=lambda claim: (claim.created, claim.digest)):
        states[claim.digest] = "withdrawn" if claim.digest in gone else "superseded"
        if claim.digest not in gone and (claim.digest, claim.team) not in named:
            latest[claim.board, claim.method, claim.team] = claim
    return states | {claim.digest: "current" for claim in latest.values()}


def _remove(connection: Connection, digests: Iterable[str]) -> set[str]:
    """Take records out; the boards that they were on."""
    boards = set()
    for digest in sorted(digests):
        boards.add(connection.scalar(select(ROWS.c.board).where(ROWS.c.digest == digest)) or "")
        for table in (ROWS, SUMMARIES):
            connection.execute(delete(table).where(table.c.digest == digest))
    return boards


def _add(
    connection: Connection, store: RecordStore, digests: Sequence[str], progress: Progress | None
) -> dict[str, str]:
    """Put records in, not yet ranked; those that cannot be used, and why."""
    problems: dict[str, str] = {}
    boards = set(connection.scalars(select(BOARDS.c.id)))
    for start in range(0, len(digests), CHUNK):
        rows, summaries = [], []
        for digest in digests[start : start + CHUNK]:
            try:
                record = read_record((store.folder / "records" / f"{digest}.json").read_bytes(), digest)
                summary = summarise_record(record)
            except (ResultError, OSError) as error:
                problems[digest] = str(error)
                continue
            if record.board not in boards:
                connection.execute(insert(BOARDS), _board_row(record))
                boards.add(record.board)
            rows.append(_row(record, digest, summary))
            summaries.append({"digest": digest, "data": msgspec.json.encode(summary).decode()})
        _insert(connection, ROWS, rows)
        _insert(connection, SUMMARIES, summaries)
        if progress is not None:
            progress(min(start + CHUNK, len(digests)), len(digests))
    return problems


def _board_row(record: Record) -> dict[str, Any]:
    track, split, recipe, evaluator, settings = comparable_key(record.results[0])
    about = {"track": track, "split": split, "split_digest": recipe, "evaluator_version": evaluator}
    return {"id": record.board, **about, "settings": settings, "metric": PRIMARY[track], "newest": False}


def _row(record: Record, digest: str, summary: RecordSummary) -> dict[str, Any]:
    texts = ("board", "method", "team", "tier", "url", "summary", "created", "supersedes")
    columns = dict.fromkeys(f"m{i}" for i in range(MOST_COLUMNS))
    columns |= {f"m{i}": summary.columns.get(key) for i, key in enumerate(COLUMNS[record.track])}
    return {
        "digest": digest,
        **{key: getattr(record, key) for key in texts},
        "words": f"{record.method}\n{record.team}".casefold(),
        "data_set": summary.data_set,
        "sequences": len(summary.sequences),
        "runs": summary.runs,
        **columns,
    }


def _rank(connection: Connection, board: str) -> None:
    """Sequences and entries of a board; score, interval, place and rank of its records; a board without records goes.

    Its sequences are those of the current records, or of all where none is current: what was withdrawn takes no part.
    Records that are not current have a score alone, and follow in the order of their scores.
    """
    track = connection.scalar(select(BOARDS.c.track).where(BOARDS.c.id == board)) or ""
    columns = [ROWS.c[key] for key in ("digest", "state", "created", "low", "high")]
    asked = select(*columns, SUMMARIES.c.data).join(SUMMARIES, SUMMARIES.c.digest == ROWS.c.digest)
    found = connection.execute(asked.where(ROWS.c.board == board).order_by(ROWS.c.digest)).all()
    if not found:
        connection.execute(delete(BOARDS).where(BOARDS.c.id == board))
        return
    summaries = [decode_summary(row.data) for row in found]
    current = [k for k, row in enumerate(found) if row.state == "current"]
    sequences = sorted({name for k in current or range(len(found)) for name in summaries[k].sequences})
    table = ScoreTable.of([summary.scores for summary in summaries], sequences, track)
    means = table.means()
    before = connection.scalar(select(BOARDS.c.sequences).where(BOARDS.c.id == board))
    # An interval costs half a millisecond; it stays while the board's sequences do, and the record has them all.
    stays = [
        row.low is not None and before == json.dumps(sequences) and set(sequences) <= summary.scores.values.keys()
        for row, summary in zip(found, summaries, strict=True)
    ]
    changed = [k for k in range(len(found)) if not stays[k]]
    intervals = dict(zip(changed, table.take(changed).intervals().tolist(), strict=True))
    better = direction(PRIMARY[track])
    standings = dict(zip(current, table.take(current).standings(better), strict=True)) if current else {}
    shared = Counter(standing.rank or standing.place or 0 for standing in standings.values())
    sign = 1 if better == "lower" else -1
    unplaced = [not ((standing := standings.get(k)) and standing.place) for k in range(len(found))]
    order = sorted(range(len(found)), key=lambda k: (unplaced[k], *_nan_last(sign * float(means[k])), found[k].digest))
    rows = []
    for position, k in enumerate(order):
        standing = standings.get(k)
        coverage = _coverage(summaries[k], sequences, track)
        values: dict[str, Any] = {"coverage": coverage, "score": _number(float(means[k]))}
        if "coverage" in COLUMNS[track]:
            values[f"m{COLUMNS[track].index('coverage')}"] = coverage
        of_rank = (standing.rank or standing.place or 0) if standing else 0
        low, high = intervals.get(k) or (found[k].low, found[k].high)
        values |= {"low": _number(low), "high": _number(high)}
        values |= {"place": standing and standing.place, "rank": standing and standing.rank}
        values |= {"tied": of_rank > 0 and shared[of_rank] > 1}
        failures = summaries[k].failed + len(set(sequences) - set(summaries[k].sequences))
        rows.append({"key": found[k].digest, "position": position, "failures": failures, **values})
    _update(connection, ROWS, rows)
    updated = max(found[k].created for k in current or range(len(found)))
    board_values = {"sequences": json.dumps(sequences), "entries": len(current), "updated": updated}
    connection.execute(update(BOARDS).where(BOARDS.c.id == board).values(**board_values))


def decode_summary(data: str) -> RecordSummary:
    """What `msgspec` wrote; a null among the scores is a value that does not exist."""
    values = msgspec.json.decode(data)
    scores = values["scores"]["values"]
    values["scores"]["values"] = {name: math.nan if value is None else value for name, value in scores.items()}
    return msgspec.convert(values, RecordSummary)


def _number(value: float | None) -> float | None:
    return None if value is None or math.isnan(value) else value


def _nan_last(value: float) -> tuple[bool, float]:
    return (True, 0.0) if math.isnan(value) else (False, value)


def _coverage(summary: RecordSummary, sequences: Iterable[str], track: str) -> float | None:
    lacking = FAILED[track].get("coverage")
    values = [summary.coverage.get(name, None if name in summary.sequences else lacking) for name in sequences]
    known = [value for value in values if value is not None]
    return math.fsum(known) / len(known) if known else None


def _order_boards(connection: Connection) -> None:
    """Tracks in order, of a split the newest evaluator first; and which boards are the newest of their recipe."""
    found = [dict(row) for row in connection.execute(select(BOARDS)).mappings()]
    tracks = list(PRIMARY)
    found.sort(key=lambda b: (-b["entries"], b["id"]))
    found.sort(key=lambda b: (evaluator_order(b["evaluator_version"]), b["entries"] > 0), reverse=True)
    found.sort(key=lambda b: (tracks.index(b["track"]), b["split"]))
    latest: dict[tuple[str, str, str], str] = {}
    for board in found:
        key = (board["track"], board["split"], board["split_digest"])
        latest[key] = max(latest.get(key, ""), board["evaluator_version"], key=evaluator_order)
    rows = []
    for position, board in enumerate(found):
        newest = latest[board["track"], board["split"], board["split_digest"]] == board["evaluator_version"]
        rows.append({"key": board["id"], "position": position, "newest": newest})
    _update(connection, BOARDS, rows)


def evaluator_order(version: str) -> tuple[tuple[int, int, str], ...]:
    """A key by which "slam 10" is later than "slam 9"."""
    parts = re.findall(r"\d+|\D+", version)
    return tuple((1, int(part), "") if part.isdigit() else (0, 0, part) for part in parts)


def _insert(connection: Connection, table: Any, rows: Sequence[Mapping[str, Any]]) -> None:
    for start in range(0, len(rows), CHUNK):
        connection.execute(insert(table), rows[start : start + CHUNK])


def _update(connection: Connection, table: Any, rows: Sequence[Mapping[str, Any]]) -> None:
    """Change rows of equal keys, each named by the value of `key` of its primary key."""
    primary = next(iter(table.primary_key))
    for start in range(0, len(rows), CHUNK):
        values: dict[str, Any] = {key: bindparam(key) for key in rows[start] if key != "key"}
        changed = update(table).where(primary == bindparam("key")).values(values)
        connection.execute(changed, rows[start : start + CHUNK])
