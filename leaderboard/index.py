"""The index of a board: what pages and tables ask, answered from a database that can be made anew from the records."""

from __future__ import annotations

import hashlib
import json
import os
import re
import threading
from array import array
from collections import OrderedDict
from collections.abc import Callable, Hashable, Iterable, Sequence
from dataclasses import replace
from typing import Any

from sqlalchemy import Connection, RowMapping, Select, func, select

from oysterbench.core.errors import ResultError
from oysterbench.core.files import home
from oysterbench.evaluate.statistics import sequence_means
from oysterbench.results.records import samples
from oysterbench_leaderboard.board import BoardInfo, BoardPage, Query, Row
from oysterbench_leaderboard.database import BOARDS, METADATA, PROBLEMS, ROWS, Database
from oysterbench_leaderboard.index_writer import Progress, inputs_of, meta, schema, write
from oysterbench_leaderboard.record_summary import COLUMNS
from oysterbench_leaderboard.store import RecordStore

MOST_REMEMBERED = 128
"""Orders of a board, at 8 bytes a row."""

MOST_WANTED = 500
"""Rows that one statement fetches by their positions or digests."""

LEAST_DIGITS = 8
"""Of a digest that is given short."""

_PREFIX = re.compile(f"[0-9a-f]{{{LEAST_DIGITS},64}}")
_STORED = [key for key in Row.__dataclass_fields__ if key != "metrics"]


def open_index(store: RecordStore, url: str | None = None) -> BoardIndex:
    """The index of a store, up to date: made where there is none, and anew where it is of another version.

    url: a file (SQLite), or postgresql+psycopg://...; by default a file under the home, one for each store.
    """
    index = BoardIndex(url or default_url(store), store)
    index.refresh()
    return index


def default_url(store: RecordStore) -> str:
    """A file under the home, one for each store."""
    name = hashlib.sha256(str(store.folder.resolve()).encode()).hexdigest()[:12]
    return str(home() / "leaderboard" / f"index-{name}.sqlite")


class BoardIndex:
    """What every reader may ask, in SQLite or PostgreSQL. All answers are of one revision at a time; sequences are in
    the board's order."""

    def __init__(self, url_or_path: str | os.PathLike[str], store: RecordStore) -> None:
        self.store, self.database = store, Database(url_or_path)
        self._switch = threading.Lock()
        self._memory: OrderedDict[Hashable, Any] = OrderedDict()

    @property
    def name(self) -> str:
        """Where it lies, without a password."""
        return self.database.name

    @property
    def revision(self) -> str:
        """Changes whenever any answer does: what a cache of pages is keyed by."""
        with self.database.reading() as connection:
            return meta(connection).get("revision", "")

    def rebuild(self, progress: Progress | None = None) -> None:
        """Make all anew from the store's files; readers see the old index until the new one is whole."""
        self._write(True, progress)

    def refresh(self) -> None:
        """Take in what has come into the store since; ranks only the boards that it is on."""
        try:
            with self.database.reading() as connection:
                if meta(connection).get("inputs") == inputs_of(self.store):
                    return
        except ResultError:
            if self.database.file is None:  # a server that is not there is no reason to build
                raise
        self._write(False)

    def _write(self, anew: bool, progress: Progress | None = None) -> None:
        with self.database.writing() as connection:
            if meta(connection).get("schema") not in (schema(), None):
                METADATA.drop_all(connection)
                METADATA.create_all(connection)
            write(connection, self.store, anew, progress)

    def boards(self, track: str | None = None) -> list[BoardInfo]:
        """All boards: tracks in order, the newest evaluator of a split first."""
        with self.database.reading() as connection:
            return [each for each in self._boards(connection).values() if track in (None, each.track)]

    def page(self, board: str, query: Query) -> BoardPage:
        """Rows of a board."""
        with self.database.reading() as connection:
            info = self._boards(connection).get(board)
            if info is None:
                raise ResultError(f"no board {board!r:.40}; `oysterbench leaderboard` lists what there is")
            size, page = max(1, query.size), max(1, query.page)
            order = self._order(connection, info, query)
            wanted = order[(page - 1) * size : page * size]
            found: dict[int, RowMapping] = {}
            for i in range(0, len(wanted), MOST_WANTED):
                asked = select(ROWS).where(ROWS.c.board == board, ROWS.c.position.in_(wanted[i : i + MOST_WANTED]))
                found |= {row["position"]: row for row in connection.execute(asked).mappings()}
            rows = self._rows(connection, [found[position] for position in wanted])
            return BoardPage(info, replace(query, page=page, size=size), tuple(rows), len(order))

    def row(self, digest: str) -> Row:
        """A record's row. Raises ResultError where there is none. A digest may be shortened to 8 digits or more where
        that is unique."""
        if not _PREFIX.fullmatch(digest):
            raise ResultError(f"expected a digest of {LEAST_DIGITS} to 64 hex digits, got {digest!r:.80}")
        with self.database.reading() as connection:
            asked = select(ROWS).where(ROWS.c.digest >= digest, ROWS.c.digest < digest + "g").limit(2)
            found = connection.execute(asked).mappings().all()
            if not found:
                why = connection.scalar(select(PROBLEMS.c.reason).where(PROBLEMS.c.file == digest))
                raise ResultError(f"no such record: {digest[:12]}" + (f"; it was left out: {why}" if why else ""))
            if len(found) > 1:
                raise ResultError(f"several records begin with {digest}: give more digits")
            return self._rows(connection, found)[0]

    def method(self, method: str, team: str | None = None) -> list[Row]:
        """All rows of a method, the newest first, superseded and withdrawn ones too."""
        asked = select(ROWS).where(ROWS.c.method == method).order_by(ROWS.c.created.desc(), ROWS.c.digest)
        if team is not None:
            asked = asked.where(ROWS.c.team == team)
        with self.database.reading() as connection:
            return self._rows(connection, connection.execute(asked).mappings().all())

    def methods(self) -> list[tuple[str, str, int]]:
        """Method, team, number of current records."""
        current = func.sum((ROWS.c.state == "current").cast(ROWS.c.runs.type))
        asked = select(ROWS.c.method, ROWS.c.team, current).group_by(ROWS.c.method, ROWS.c.team)
        with self.database.reading() as connection:
            found = connection.execute(asked.order_by(ROWS.c.method, ROWS.c.team)).all()
        return [(method, team, int(count)) for method, team, count in found]

    def sequence_means(self, digest: str) -> dict[str, dict[str, float | None]]:
        """Sequence -> metric -> mean over runs, for a record."""
        results = self.store.record(digest if len(digest) == 64 else self.row(digest).digest).results
        keys = dict.fromkeys(key for result in results for key in result.metrics)
        means = {key: sequence_means(samples(results, key)) for key in keys}
        names = dict.fromkeys(result.sequence for result in results)
        return {name: {key: means[key].get(name) for key in keys} for name in names}

    def problems(self) -> dict[str, str]:
        """Files that were left out, by their digest: why. The others are not touched by it."""
        with self.database.reading() as connection:
            asked = select(PROBLEMS.c.file, PROBLEMS.c.reason).order_by(PROBLEMS.c.file)
            return {row[0]: row[1] for row in connection.execute(asked)}

    def close(self) -> None:
        """Let go of all connections; the next question opens new ones."""
        self.database.close()

    def _boards(self, connection: Connection) -> dict[str, BoardInfo]:
        """By their ids, in order."""

        def make() -> dict[str, BoardInfo]:
            found = {}
            for row in connection.execute(select(BOARDS).order_by(BOARDS.c.position)).mappings():
                values = {key: row[key] for key in row if key != "position"}
                values |= {"settings": json.loads(row["settings"]), "sequences": tuple(json.loads(row["sequences"]))}
                found[row["id"]] = BoardInfo(**values, columns=COLUMNS[row["track"]])
            return found

        boards: dict[str, BoardInfo] = self._remembered((meta(connection).get("revision"), "boards"), make)
        return boards

    def _order(self, connection: Connection, board: BoardInfo, query: Query) -> array[int]:
        """Positions of all rows that a query asks for, in its order: sorting a large board takes longer than all else
        of a page, and most pages ask for the same."""
        chosen = replace(query, page=1, size=1)
        key = (meta(connection).get("revision"), board.id, chosen)
        order: array[int] = self._remembered(key, lambda: array("l", connection.scalars(_positions(board, chosen))))
        return order

    def _remembered(self, key: Hashable, make: Callable[[], Any]) -> Any:
        """What was made before, of this revision; the least used of MOST_REMEMBERED things is forgotten."""
        with self._switch:
            if key in self._memory:
                self._memory.move_to_end(key)
                return self._memory[key]
        made = make()
        with self._switch:
            self._memory[key] = made
            while len(self._memory) > MOST_REMEMBERED:
                self._memory.popitem(last=False)
        return made

    def _rows(self, connection: Connection, found: Sequence[RowMapping]) -> list[Row]:
        """Rows as they are asked for."""
        boards = self._boards(connection)
        rows = []
        for row in found:
            metrics = {key: row[f"m{i}"] for i, key in enumerate(boards[row["board"]].columns)}
            rows.append(Row(**{key: row[key] for key in _STORED}, metrics=metrics))
        return rows


def _positions(board: BoardInfo, query: Query) -> Select[tuple[int]]:
    """Positions of the rows that a query asks for, in its order."""
    chosen = [ROWS.c.board == board.id, ROWS.c.state.in_(query.states)]
    if query.tiers:
        chosen.append(ROWS.c.tier.in_(query.tiers))
    if query.text:
        chosen.append(ROWS.c.words.contains(query.text.casefold(), autoescape=True))
    return select(ROWS.c.position).where(*chosen).order_by(*_sorting(board, query))


def _sorting(board: BoardInfo, query: Query) -> Iterable[Any]:
    """What a page is ordered by: records without the value come last, whichever way round; equal ones by rank."""
    columns = {"rank": ROWS.c.position, "method": ROWS.c.words, "team": ROWS.c.team, "created": ROWS.c.created}
    columns |= {key: ROWS.c[key] for key in ("score", "coverage", "data_set")} | {board.metric: ROWS.c.score}
    columns |= {key: ROWS.c[f"m{i}"] for i, key in enumerate(board.columns)}
    column = columns.get(query.sort)
    if column is None:
        raise ResultError(f"sort: expected one of {', '.join(columns)}, got {query.sort!r:.40}")
    absent = ROWS.c.place if query.sort == "rank" else column
    return absent.is_(None), column.desc() if query.descending else column, ROWS.c.position
