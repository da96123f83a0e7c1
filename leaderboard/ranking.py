"""Which records of a board are current, and their places: pure functions of what the records say."""

from __future__ import annotations

import json
import math
import re
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from string import digits
from typing import Any

from oysterbench.evaluate.metrics import FAILED, TRACKS
from oysterbench.results.records import comparable_key
from oysterbench.results.standings import PRIMARY, ScoreTable, direction
from oysterbench_leaderboard.board import BoardInfo, State
from oysterbench_leaderboard.record import RANKED, Record
from oysterbench_leaderboard.record_summary import (
    COLUMNS,
    RecordSummary,
    column_means,
    data_set_value,
    said_of_method,
    summarise_record,
)
from oysterbench_leaderboard.store import StatusChange


@dataclass(frozen=True)
class Claim:
    """What decides whether a record is current."""

    digest: str
    board: str
    method: str
    team: str
    created: str
    supersedes: str


@dataclass(frozen=True)
class Ranked:
    """What a record's place is made of. low, high: its interval, where it is known already."""

    digest: str
    state: str
    tier: str
    created: str
    summary: RecordSummary
    low: float | None = None
    high: float | None = None


def withdrawn(changes: Iterable[StatusChange]) -> set[str]:
    """Digests of the records whose latest change withdraws them; changes in any order."""
    latest = {change.record: change.action for change in sorted(changes, key=StatusChange.order)}
    return {digest for digest, action in latest.items() if action == "withdrawn"}


def states(claims: Iterable[Claim], gone: set[str]) -> dict[str, State]:
    """Digest -> whether a record is current, superseded, or withdrawn (one of `gone`).

    A record is superseded by any of the same team that names it, on its own board or another (a new evaluator has a
    board of its own), or by the latest created one of its method, team and board; of two of one second the greater
    digest is the later. A withdrawn record supersedes nothing: what it took the place of comes back.
    """
    every = list(claims)
    there = [one for one in every if one.digest not in gone]
    named = {(one.supersedes, one.team) for one in there if one.supersedes}
    latest: dict[tuple[str, str, str], Claim] = {}
    for one in there:
        if (one.digest, one.team) not in named:
            key = (one.board, one.method, one.team)
            latest[key] = max(latest.get(key, one), one, key=lambda claim: (claim.created, claim.digest))
    current = {one.digest for one in latest.values()}
    return {
        one.digest: "withdrawn" if one.digest in gone else "current" if one.digest in current else "superseded"
        for one in every
    }


def board_of(record: Record) -> BoardInfo:
    """The board of a record, as its first one finds it."""
    track, split, recipe, evaluator, settings = comparable_key(record.results[0])
    about = (record.board, track, split, recipe, evaluator, json.loads(settings), PRIMARY[track], COLUMNS[track])
    return BoardInfo(*about, sequences=(), entries=0, updated="", newest=False)


def columns_of(record: Record, digest: str) -> tuple[dict[str, Any], RecordSummary]:
    """What a record says by itself, in the columns of `board.Row`, and `words` for searching; what ranks it."""
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
    }, summary


def rank(board: BoardInfo, found: Sequence[Ranked]) -> tuple[BoardInfo, list[dict[str, Any]]]:
    """The board as it is now, and its records in order, the `key` of each its digest: score, interval, place and rank.

    Its sequences are those of the ranked records, or of the current ones, or of all where there are no others: what was
    withdrawn takes no part. What is self-reported is not ranked: anybody can write a number down. It has a score alone,
    as have records that are not current, and follows in the order of the scores.
    """
    summaries = [one.summary for one in found]
    current = [k for k, one in enumerate(found) if one.state == "current"]
    ranked = [k for k in current if found[k].tier in RANKED]
    sequences = sorted({name for k in ranked or current or range(len(found)) for name in summaries[k].sequences})
    table = ScoreTable.of([summary.scores for summary in summaries], sequences, board.track)
    means = table.means().tolist()
    # An interval costs half a millisecond; it stays while the board's sequences do, and the record has them all.
    intervals = {
        k: (one.low, one.high)
        for k, one in enumerate(found)
        if one.low is not None
        and board.sequences == tuple(sequences)
        and one.summary.scores.values.keys() >= set(sequences)
    }
    new = [k for k in range(len(found)) if k not in intervals]
    intervals |= dict(zip(new, table.take(new).intervals().tolist(), strict=True))
    better = direction(board.metric)
    least = TRACKS[board.track].lost_below
    lost = None if least is None else (table.values < least).sum(axis=1).tolist()
    standings = dict(zip(ranked, table.take(ranked).standings(better), strict=True)) if ranked else {}
    shared = Counter(standing.rank or standing.place for standing in standings.values())
    rows: list[dict[str, Any]] = []
    for k, one in enumerate(found):
        standing = standings.get(k)
        place, given = (standing.place, standing.rank) if standing else (None, None)
        low, high = map(_number, intervals[k])
        coverage = _coverage(one.summary, sequences, board.track)
        failures = one.summary.failed + len(set(sequences) - set(one.summary.sequences))
        values = {"score": _number(means[k]), "low": low, "high": high, "coverage": coverage, "failures": failures}
        values["lost"] = None if lost is None else lost[k]
        tied = place is not None and shared[given or place] > 1
        rows.append({"key": one.digest, "place": place, "rank": given, "tied": tied, **values})
    sign = 1 if better == "lower" else -1
    rows.sort(key=lambda r: (r["place"] is None, r["score"] is None, sign * (r["score"] or 0), r["key"]))
    updated = max(found[k].created for k in current or range(len(found)))
    board = replace(board, sequences=tuple(sequences), entries=len(current), updated=updated)
    return board, [{**row, "position": position} for position, row in enumerate(rows)]


def _number(value: float | None) -> float | None:
    return None if value is None or math.isnan(value) else value


def _coverage(summary: RecordSummary, sequences: Iterable[str], track: str) -> float | None:
    lacking = FAILED[track].get("coverage")
    values = [summary.coverage.get(name, None if name in summary.sequences else lacking) for name in sequences]
    known = [value for value in values if value is not None]
    return math.fsum(known) / len(known) if known else None


def in_order(boards: Iterable[BoardInfo]) -> list[BoardInfo]:
    """Tracks in order, of a split the newest evaluator first; each with whether it is the newest of its split: by the
    recipe of the split's last record, on whichever track, and by the newest evaluator of that."""
    found, tracks = list(boards), list(PRIMARY)
    recipes = {board.split: board.split_digest for board in sorted(found, key=lambda b: (b.updated, b.split_digest))}
    latest: dict[tuple[str, ...], str] = {}
    for board in found:
        recipe = (board.track, board.split, board.split_digest)
        latest[recipe] = max(latest.get(recipe, ""), board.evaluator_version, key=evaluator_order)
    found.sort(key=lambda b: (-b.entries, b.id))
    found.sort(key=lambda b: (evaluator_order(b.evaluator_version), b.entries > 0), reverse=True)
    found.sort(key=lambda b: (tracks.index(b.track), b.split))
    found.sort(key=lambda b: (tracks.index(b.track), b.split, b.split_digest != recipes[b.split]))
    return [
        replace(
            board,
            former=board.split_digest != recipes[board.split],
            newest=board.split_digest == recipes[board.split]
            and latest[board.track, board.split, board.split_digest] == board.evaluator_version,
        )
        for board in found
    ]


def evaluator_order(version: str) -> tuple[tuple[int, int, str], ...]:
    """A key by which "slam 10" is later than "slam 9"."""
    parts = re.findall(r"[0-9]{1,18}|[^0-9]+", version)
    return tuple((1, int(part), "") if part[0] in digits else (0, 0, part) for part in parts)
