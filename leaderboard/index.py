"""The index of a board: what pages and tables ask, answered from a database that can be made anew from the records."""

from __future__ import annotations

import hashlib
import json
import os
import re
import threading
from array import array
from collections import OrderedDict
from collections.abc import Callable, Hashable, Sequence
from dataclasses import replace
from typing import Any, Protocol

from sqlalchemy import Connection, Select, func, select

from oysterbench.core.errors import ResultError
from oysterbench.core.files import home
from oysterbench_leaderboard.board import BoardInfo, BoardPage, Query, Row
from oysterbench_leaderboard.building import Progress, processes, read
from oysterbench_leaderboard.database import Database
from oysterbench_leaderboard.filling import fill, inputs_of, meta, take_in
from oysterbench_leaderboard.intake import COLUMNS, by_sequence, run_means
from oysterbench_leaderboard.schema import BOARDS, PROBLEMS, ROWS
from oysterbench_leaderboard.store import RecordStore

MOST_REMEMBERED = 128
"""Orders of a board, at 8 bytes a row."""

MOST_WANTED = 500
"""Rows that one statement fetches by their positions."""

LEAST_DIGITS = 8
"""Of a digest that is given short."""

_PREFIX = re.compile(f"[0-9a-f]{{{LEAST_DIGITS},64}}")


class Index(Protocol):
    """What every reader may ask. All answers are of one revision at a time; sequences are in the board's order."""

    store: RecordStore

    @property
    def revision(self) -> str:
        """Changes whenever any answer does: what a cache of pages is keyed by."""

    def rebuild(self, progress: Callable[[int, int], None] | None = None) -> None:
        """Make all anew from the store's records and notices; readers see the old index until the new one is whole."""

    def refresh(self) -> None:
        """Take in records and notices that have come into the store since; ranks only the boards they are on."""

    def boards(self, track: str | None = None) -> list[BoardInfo]:
        """All boards: tracks in order, the newest evaluator of a split first."""

    def find_board(self, track: str, split: str, board: str | None = None) -> BoardInfo:
        """The newest board of a split, or the one with that id. Raises ResultError naming what there is."""

    def page(self, board: str, query: Query) -> BoardPage:
        """Rows of a board."""

    def row(self, digest: str) -> Row:
        """A record's row. Raises ResultError where there is none. A digest may be shortened to 8 digits or more where
        that is unique."""

    def method(self, method: str, team: str | None = None) -> list[Row]:
        """All rows of a method, the newest first, superseded and withdrawn ones too."""

    def methods(self) -> list[tuple[str, str, int]]:
        """Method, team, number of current records."""

    def sequence_means(self, digest: str) -> dict[str, dict[str, float | None]]:
        """Sequence -> metric -> mean over runs, for a record."""

    def problems(self) -> dict[str, str]:
        """Records and notices that were left out, by their digest: why. The others are not touched by it."""


def open_index(store: RecordStore, url: str | None = None) -> SqlIndex:
    """The index of a store, up to date: made where there is none, and anew where it is of another version.

    url: a file (SQLite), or postgresql+psycopg://...; by default a file under the home, one for each store.
    """
    index = SqlIndex(url or default_url(store), store)
    index.refresh()
    return index


def default_url(store: RecordStore) -> str:
    """A file under the home, one for each store."""
    name = hashlib.sha256(str(store.folder.resolve()).encode()).hexdigest()[:12]
    return str(home() / "leaderboard" / f"index-{name}.sqlite")


class SqlIndex:
    """`Index` in SQLite, as one file that is replaced whole, or in PostgreSQL, in one transaction."""

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
        with self.database.reading() as connection:
            return meta(connection).get("revision", "")

    def rebuild(self, progress: Progress | None = None) -> None:
        with self.database.told(), self.database.only_writer():
            self._rebuild(progress)

    def refresh(self) -> None:
        with self.database.told():
            if self._up_to_date():
                return
            with self.database.only_writer():
                if not self.database.usable():
                    self._rebuild(None)
                    return
                with self.database.engine().begin() as connection:
                    take_in(connection, self.store)

    def boards(self, track: str | None = None) -> list[BoardInfo]:
        with self.database.reading() as connection:
            return [each for each in self._boards(connection) if track in (None, each.track)]

    def find_board(self, track: str, split: str, board: str | None = None) -> BoardInfo:
        known = self.boards()
        if board is not None:
            found = [each for each in known if each.id == board and each.track == track and each.split == split]
        else:
            found = [each for each in known if each.track == track and each.split == split]
        if not found:
            there = ", ".join(dict.fromkeys(f"{each.track} {each.split}" for each in known)) or "none yet"
            raise ResultError(f"no board {board or ''} of {track} on {split}; there are: {there}".replace("  ", " "))
        return found[0]

    def page(self, board: str, query: Query) -> BoardPage:
        with self.database.reading() as connection:
            info = next((each for each in self._boards(connection) if each.id == board), None)
            if info is None:
                raise ResultError(f"no board {board!r:.40}; `oysterbench leaderboard` lists what there is")
            size, page = max(1, query.size), max(1, query.page)
            order = self._order(connection, info, query)
            wanted = order[(page - 1) * size : page * size]
            found: dict[int, Row] = {}
            for i in range(0, len(wanted), MOST_WANTED):
                asked = select(ROWS).where(ROWS.c.board == board, ROWS.c.position.in_(wanted[i : i + MOST_WANTED]))
                found |= {row["position"]: _row(row, info.columns) for row in connection.execute(asked).mappings()}
            rows = tuple(found[position] for position in wanted)
            return BoardPage(info, replace(query, page=page, size=size), rows, len(order))

    def row(self, digest: str) -> Row:
        if not _PREFIX.fullmatch(digest):
            raise ResultError(f"expected a digest of {LEAST_DIGITS} to 64 hex digits, got {digest!r:.80}")
        with self.database.reading() as connection:
            asked = _with_track().where(ROWS.c.digest >= digest, ROWS.c.digest < digest + "g").limit(2)
            found = connection.execute(asked).mappings().all()
            if not found:
                why = connection.scalar(select(PROBLEMS.c.reason).where(PROBLEMS.c.file == digest))
                raise ResultError(f"no such record: {digest[:12]}" + (f"; it was left out: {why}" if why else ""))
            if len(found) > 1:
                raise ResultError(f"several records begin with {digest}: give more digits")
            return _row(found[0], COLUMNS[found[0]["track"]])

    def method(self, method: str, team: str | None = None) -> list[Row]:
        asked = _with_track().where(ROWS.c.method == method).order_by(ROWS.c.created.desc(), ROWS.c.digest)
        if team is not None:
            asked = asked.where(ROWS.c.team == team)
        with self.database.reading() as connection:
            return [_row(found, COLUMNS[found["track"]]) for found in connection.execute(asked).mappings()]

    def methods(self) -> list[tuple[str, str, int]]:
        current = func.sum((ROWS.c.state == "current").cast(ROWS.c.runs.type))
        asked = select(ROWS.c.method, ROWS.c.team, current).group_by(ROWS.c.method, ROWS.c.team)
        with self.database.reading() as connection:
            found = connection.execute(asked.order_by(ROWS.c.method, ROWS.c.team)).all()
        return [(method, team, int(count)) for method, team, count in found]

    def sequence_means(self, digest: str) -> dict[str, dict[str, float | None]]:
        full = digest if len(digest) == 64 else self.row(digest).digest
        results = json.loads(self.store.data(full))["results"]
        runs = by_sequence(results)
        keys = dict.fromkeys(key for result in results for key in result["metrics"])
        means = {key: run_means(runs, key)[0] for key in keys}
        return {name: {key: means[key].get(name) for key in keys} for name in runs}

    def problems(self) -> dict[str, str]:
        with self.database.reading() as connection:
            asked = select(PROBLEMS.c.file, PROBLEMS.c.reason).order_by(PROBLEMS.c.file)
            return {row[0]: row[1] for row in connection.execute(asked)}

    def close(self) -> None:
        """Let go of all connections; the next question opens new ones."""
        self.database.close()

    def _boards(self, connection: Connection) -> list[BoardInfo]:
        key = (meta(connection).get("revision"), "boards")
        return self._remembered(key, lambda: _boards(connection))

    def _order(self, connection: Connection, board: BoardInfo, query: Query) -> array[int]:
        """Positions of all rows that a query asks for, in its order: sorting a large board takes longer than all else
        of a page, and most pages ask for the same."""
        chosen = replace(query, page=1, size=1)
        key = (meta(connection).get("revision"), board.id, chosen)
        return self._remembered(key, lambda: array("l", connection.scalars(_positions(board, chosen))))

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

    def _up_to_date(self) -> bool:
        if not self.database.usable():
            return False
        with self.database.engine().connect() as connection:
            return meta(connection).get("inputs") == inputs_of(self.store)

    def _rebuild(self, progress: Progress | None) -> None:
        """Make all anew; the caller is the only writer."""
        inputs, digests = inputs_of(self.store), self.store.digests()
        with processes(len(digests)) as using:
            kept, wrong = read(self.store.folder / "records", digests, using, progress)
            with self.database.new_tables() as connection:
                fill(connection, kept, self.store, wrong, inputs, using)


def _boards(connection: Connection) -> list[BoardInfo]:
    asked = select(BOARDS).order_by(BOARDS.c.position)
    found = []
    for row in connection.execute(asked).mappings():
        values = {key: row[key] for key in row if key != "position"}
        values["settings"], values["sequences"] = json.loads(row["settings"]), tuple(json.loads(row["sequences"]))
        found.append(BoardInfo(**values, columns=COLUMNS[row["track"]]))
    return found


def _positions(board: BoardInfo, query: Query) -> Select[Any]:
    """Positions of the rows that a query asks for, in its order."""
    chosen = [ROWS.c.board == board.id, ROWS.c.state.in_(query.states)]
    if query.tiers:
        chosen.append(ROWS.c.tier.in_(query.tiers))
    if query.text:
        chosen.append(ROWS.c.words.contains(query.text.casefold(), autoescape=True))
    return select(ROWS.c.position).where(*chosen).order_by(*_order(board, query))


def _order(board: BoardInfo, query: Query) -> list[Any]:
    """What a page is ordered by: records without the value come last, whichever way round; equal ones by rank."""
    columns = {"rank": ROWS.c.position, "method": ROWS.c.words, "team": ROWS.c.team, "created": ROWS.c.created}
    columns |= {key: ROWS.c[key] for key in ("score", "coverage", "data_set")} | {board.metric: ROWS.c.score}
    columns |= {key: ROWS.c[f"m{i}"] for i, key in enumerate(board.columns)}
    column = columns.get(query.sort)
    if column is None:
        raise ResultError(f"sort: expected one of {', '.join(columns)}, got {query.sort!r:.40}")
    absent = ROWS.c.place if query.sort == "rank" else column
    return [absent.is_(None), column.desc() if query.descending else column, ROWS.c.position]


def _with_track() -> Select[Any]:
    return select(ROWS, BOARDS.c.track).join(BOARDS, BOARDS.c.id == ROWS.c.board)


def _row(found: Any, columns: Sequence[str]) -> Row:
    metrics = {key: found[f"m{i}"] for i, key in enumerate(columns)}
    keys = (key for key in Row.__dataclass_fields__ if key != "metrics")
    return Row(**{key: found[key] for key in keys}, metrics=metrics)
