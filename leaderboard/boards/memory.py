"""Boards read directly from their records, for readers without a database library."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterable
from dataclasses import replace
from functools import partial
from operator import itemgetter
from typing import Any

from oysterbench.core.errors import ResultError
from oysterbench.core.text import composed, spellings
from oysterbench.evaluate.statistics import sequence_means
from oysterbench.results.records import samples
from oysterbench_leaderboard.boards.board import LEAST_DIGITS, BoardInfo, BoardPage, Query, Row
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
from oysterbench_leaderboard.storage.record_summary import RecordSummary
from oysterbench_leaderboard.storage.store import RecordStore


class MemoryIndex:
    """`BoardReader` with the same answers as `index.BoardIndex`; on creation it reads every record, some ms each."""

    def __init__(self, store: RecordStore) -> None:
        self.store = store
        self.name = str(store.folder)
        changes, self._problems = store.read_status_changes()
        columns: dict[str, dict[str, Any]] = {}
        summaries: dict[str, RecordSummary] = {}
        boards: dict[str, BoardInfo] = {}
        for digest in store.digests():
            try:
                record, columns[digest], summaries[digest] = read_columns(store, digest)
            except ResultError as error:
                self._problems[digest] = str(error)
                continue
            boards.setdefault(record.board, board_of(record))
        claims = [Claim(**{key: row[key] for key in Claim.__dataclass_fields__}) for row in columns.values()]
        for digest, state in states(claims, withdrawn(changes)).items():
            columns[digest]["state"] = state
        ranked, keys = [], ("digest", "state", "team", "tier", "created")
        for board in boards.values():
            on_it = [row for _, row in sorted(columns.items()) if row["board"] == board.id]
            found = [Ranked(**{key: row[key] for key in keys}, summary=summaries[row["digest"]]) for row in on_it]
            try:
                board, places = rank(board, found)
            except (ArithmeticError, ValueError) as error:  # the other boards must go on
                for row in on_it:
                    self._problems[row["digest"]] = f"its board could not be ranked: {error}"
                    del columns[row["digest"]]
                continue
            ranked.append(board)
            for place in places:
                columns[place.pop("key")] |= place
        self._columns = columns
        self._boards = {board.id: board for board in in_order(ranked)}

    @property
    def revision(self) -> str:
        """Revision, which changes whenever any answer does."""
        names = (*self.store.names("records"), "changes", *self.store.names("changes"), str(sorted(self._problems)))
        return hashlib.sha256(" ".join(names).encode()).hexdigest()[:16]

    def boards(self, track: str | None = None) -> list[BoardInfo]:
        """All boards: tracks in order, the newest evaluator of a split first."""
        return [board for board in self._boards.values() if track in (None, board.track)]

    def page(self, board: str, query: Query) -> BoardPage:
        """Return a page of a board's rows. Raises ResultError where there is no such board or sort key."""
        info = self._boards.get(board)
        if info is None:
            raise ResultError(f"no board {board!r:.40}; `oysterbench leaderboard` lists what there is")
        size, page = max(1, query.size), max(1, query.page)
        chosen = [row for row in self._columns.values() if row["board"] == board and _asked(row, query)]
        ordered = _sorted(chosen, info, query)
        rows = tuple(self._row(row) for row in ordered[(page - 1) * size : page * size])
        return BoardPage(info, replace(query, page=page, size=size), rows, len(ordered))

    def row(self, digest: str) -> Row:
        """Return a record's row by its digest, or the first 8 digits or more of it. Raises ResultError where no record
        matches, or several do."""
        if len(digest) < LEAST_DIGITS or not set(digest) <= set("0123456789abcdef"):
            raise ResultError(f"expected a digest of {LEAST_DIGITS} to 64 hex digits, got {digest!r:.80}")
        found = [row for name, row in self._columns.items() if name.startswith(digest)]
        if not found:
            why = self._problems.get(digest)
            told = f"it was left out: {why}" if why else "`oysterbench leaderboard --json` has the digests"
            raise ResultError(f"no such record: {digest[:12]}; {told}")
        if len(found) > 1:
            raise ResultError(f"several records begin with {digest}: give more digits")
        return self._row(found[0])

    def method(self, method: str, team: str | None = None) -> list[Row]:
        """All rows of a method, newest first, including superseded and withdrawn ones; names in any Unicode form."""
        teams = None if team is None else spellings(team)
        of_method = (row for row in self._columns.values() if row["method"] in spellings(method))
        found = [row for row in of_method if teams is None or row["team"] in teams]
        found.sort(key=lambda row: str(row["digest"]))
        found.sort(key=lambda row: str(row["created"]), reverse=True)
        return [self._row(row) for row in found]

    def methods(self) -> list[tuple[str, str, int]]:
        """Method, team, number of current records."""
        counts: dict[tuple[str, str], int] = {}
        for row in self._columns.values():
            key = row["method"], row["team"]
            counts[key] = counts.get(key, 0) + (row["state"] == "current")
        return [(method, team, count) for (method, team), count in sorted(counts.items())]

    def sequence_means(self, digest: str) -> dict[str, dict[str, float | None]]:
        """Sequence -> metric -> mean over runs, for a record."""
        results = self.store.record(self.row(digest).digest).results
        keys = dict.fromkeys(key for result in results for key in result.metrics)
        means = {key: sequence_means(samples(results, key)) for key in keys}
        names = dict.fromkeys(result.sequence for result in results)
        return {name: {key: means[key].get(name) for key in keys} for name in names}

    def problems(self) -> dict[str, str]:
        """Digests of files that were left out -> reason. The others are not affected."""
        return dict(sorted(self._problems.items()))

    def _row(self, row: dict[str, Any]) -> Row:
        board, metrics = self._boards[row["board"]], {**row["metrics"], "coverage": row["coverage"]}
        facts = {key: row[key] for key in Row.__dataclass_fields__}
        return Row(**{**facts, "metrics": {key: metrics[key] for key in board.columns}})


def _asked(row: dict[str, Any], query: Query) -> bool:
    return (
        row["state"] in query.states
        and (not query.tiers or row["tier"] in query.tiers)
        and composed(query.text).casefold() in row["words"]
    )


def _metric(key: str, row: dict[str, Any]) -> float | None:
    value: float | None = row["metrics"].get(key)
    return value


def _sorted(rows: Iterable[dict[str, Any]], board: BoardInfo, query: Query) -> list[dict[str, Any]]:
    """Sort rows as a query asks: records without the value come last in either order; equal ones by rank. Raises
    ResultError for an unknown key."""
    values: dict[str, Callable[[dict[str, Any]], Any]] = {
        "rank": itemgetter("position"),
        "method": itemgetter("words"),
        board.metric: itemgetter("score"),
        **{key: partial(_metric, key) for key in board.columns},
        **{key: itemgetter(key) for key in ("team", "created", "score", "data_set", "coverage", "lost")},
    }
    if query.sort not in values:
        raise ResultError(f"sort: expected one of {', '.join(values)}, got {query.sort!r:.40}")
    value = values[query.sort]
    absent = itemgetter("place") if query.sort == "rank" and query.descending else value
    found = sorted(rows, key=itemgetter("position"))
    known = sorted((row for row in found if absent(row) is not None), key=value, reverse=query.descending)
    rest = [row for row in found if absent(row) is None]
    return known + (rest[::-1] if query.sort == "rank" and query.descending else rest)
