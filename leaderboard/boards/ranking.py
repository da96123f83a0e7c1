"""Which records of a board are current, and their places: pure functions of the records."""

from __future__ import annotations

import json
import math
import re
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, fields, replace
from string import digits
from typing import Any

from oysterbench.core.errors import ResultError
from oysterbench.core.text import composed
from oysterbench.evaluate.metrics import FAILED, TRACKS
from oysterbench.results.records import comparable_key
from oysterbench.results.standings import PRIMARY, ScoreTable, direction
from oysterbench_leaderboard.boards.board import BoardInfo, State
from oysterbench_leaderboard.boards.teams import standings_by_team
from oysterbench_leaderboard.storage.record import RANKED, Record
from oysterbench_leaderboard.storage.record_summary import (
    COLUMNS,
    RecordSummary,
    check_shown,
    column_means,
    data_set_value,
    read_record,
    said_of_method,
    summarise_record,
)
from oysterbench_leaderboard.storage.store import RecordStore, StatusChange


@dataclass(frozen=True)
class Claim:
    """The fields of a record that decide whether it is current."""

    digest: str
    board: str
    method: str
    team: str
    tier: str
    created: str
    supersedes: str

    @classmethod
    def of(cls, digest: str, record: Record) -> Claim:
        """The claim of a record."""
        return cls(digest, *(getattr(record, each.name) for each in fields(cls)[1:]))


@dataclass(frozen=True)
class Ranked:
    """What a record's place is computed from. low, high: its interval, if it is known already."""

    digest: str
    state: str
    team: str
    tier: str
    created: str
    summary: RecordSummary
    low: float | None = None
    high: float | None = None


def withdrawn(changes: Iterable[StatusChange]) -> set[str]:
    """Digests of the records whose latest status change withdraws them; changes may be in any order."""
    latest = {change.record: change.action for change in sorted(changes, key=StatusChange.order)}
    return {digest for digest, action in latest.items() if action == "withdrawn"}


def states(claims: Iterable[Claim], gone: set[str]) -> dict[str, State]:
    """Digest -> state of a record: current, superseded, or withdrawn (those in `gone`).

    A record is superseded by any of the same team that names it, on its own board or another (a new evaluator has its
    own board), or by the latest one of its method, team and board; of two created in the same second, the one with the
    greater digest is later. A name is one in whatever Unicode form it is written. A reported record supersedes no
    ranked one: anybody can write numbers down. A withdrawn record supersedes nothing: the one that it had replaced
    comes back.
    """
    every = [replace(one, method=composed(one.method), team=composed(one.team)) for one in claims]
    there = [one for one in every if one.digest not in gone]
    ranked = {one.digest for one in there if one.tier in RANKED}
    named = {
        (one.supersedes, one.team)
        for one in there
        if one.supersedes and (one.digest in ranked or one.supersedes not in ranked)
    }
    latest: dict[tuple[str, str, str], Claim] = {}
    for one in sorted(there, key=lambda claim: (claim.digest in ranked, claim.created, claim.digest)):
        if (one.digest, one.team) not in named:
            latest[one.board, one.method, one.team] = one
    current = {one.digest for one in latest.values()}
    return {
        one.digest: "withdrawn" if one.digest in gone else "current" if one.digest in current else "superseded"
        for one in every
    }


def board_of(record: Record) -> BoardInfo:
    """Board of a record, still without entries, ranks and sequences."""
    track, split, recipe, evaluator, settings = comparable_key(record.results[0])
    about = (record.board, track, split, recipe, evaluator, json.loads(settings), PRIMARY[track], COLUMNS[track])
    return BoardInfo(*about, sequences=(), entries=0, updated="", newest=False)


def columns_of(record: Record, digest: str) -> tuple[dict[str, Any], RecordSummary]:
    """Columns of `board.Row` that follow from a record by itself, with `words` for searching; and its summary, by which
    it is ranked. Raises ResultError where a board would show impossible values."""
    summary = summarise_record(record)
    metrics, whole = column_means(record), data_set_value(record)
    check_shown(record, metrics, whole)
    same = ("board", "method", "team", "tier", "url", "summary", "created", "supersedes")
    return {
        "digest": digest,
        **{key: getattr(record, key) for key in same},
        "words": composed(f"{record.method}\n{record.team}").casefold(),
        "data_set": whole,
        "metrics": metrics,
        **said_of_method(record),
        "sequences": len(summary.sequences),
        "runs": len(record.results),
    }, summary


def read_columns(store: RecordStore, digest: str) -> tuple[Record, dict[str, Any], RecordSummary]:
    """Read a record of a store, with `columns_of` it. Raises ResultError where it cannot be used."""
    try:
        record = read_record((store.folder / "records" / f"{digest}.json").read_bytes(), digest)
        return record, *columns_of(record, digest)
    except OSError as error:
        raise ResultError(str(error)) from None
    except (ArithmeticError, ValueError, RecursionError) as error:  # numbers or nesting beyond what is computed with
        raise ResultError(f"its values cannot be used: {error}") from None


def rank(board: BoardInfo, found: Sequence[Ranked]) -> tuple[BoardInfo, list[dict[str, Any]]]:
    """Rank a board's records; return the updated board, and its records in order with score, interval, place and rank,
    where `key` is the digest.

    The board's sequences are those of the ranked records; without any, those of the current ones; without any, those of
    all: withdrawn records take no part there. A lacking score that has no floor, as on the track steering, is filled in
    with the lowest of the ranked records; without any, of all, withdrawn ones too. Self-reported records are not
    ranked: anybody can write a number down. Like records that are not current, they have only a score, and follow in
    order of score.

    Of a team that sends estimates (tier "scored"), only the best method counts in the ranks of others: one result under
    many names must lower nobody's. Places count all. Every baseline counts: they are methods of many authors, and
    nobody but us adds one.
    """
    summaries = [one.summary for one in found]
    current = [k for k, one in enumerate(found) if one.state == "current"]
    ranked = [k for k in current if found[k].tier in RANKED]
    sequences = sorted({name for k in ranked or current or range(len(found)) for name in summaries[k].sequences})
    trusted = [summaries[k].scores for k in ranked] or None  # what is not ranked must not change what is
    table = ScoreTable.of([summary.scores for summary in summaries], sequences, board.track, trusted)
    means = table.means().tolist()
    # An interval takes half a millisecond to compute; it is reused while the board's sequences are the same, if the
    # record has all of them.
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
    teams = [composed(found[k].team) if found[k].tier == "scored" else k for k in ranked]
    standings = dict(zip(ranked, standings_by_team(table.take(ranked), teams, better), strict=True)) if ranked else {}
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
    public = any(summaries[k].hidden is False for k in ranked)
    board = replace(board, sequences=tuple(sequences), entries=len(current), updated=updated, public=public)
    return board, [{**row, "position": position} for position, row in enumerate(rows)]


def _number(value: float | None) -> float | None:
    return None if value is None or math.isnan(value) else value


def _coverage(summary: RecordSummary, sequences: Iterable[str], track: str) -> float | None:
    lacking = FAILED[track].get("coverage")
    values = [summary.coverage.get(name, None if name in summary.sequences else lacking) for name in sequences]
    known = [value for value in values if value is not None]
    return math.fsum(known) / len(known) if known else None


def in_order(boards: Iterable[BoardInfo]) -> list[BoardInfo]:
    """Sort boards by track, and within a split with the newest evaluator first; set `newest` and `former` of each. The
    newest board has the recipe of the split's last record, on any track, and the newest evaluator for that recipe."""
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
    """Sort key of evaluator versions, by which "slam 10" is later than "slam 9"."""
    parts = re.findall(r"[0-9]{1,18}|[^0-9]+", version)
    return tuple((1, int(part), "") if part[0] in digits else (0, 0, part) for part in parts)
