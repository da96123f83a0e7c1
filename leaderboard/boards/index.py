"""The index of a board: answers queries of pages and tables from a database that can be rebuilt from the records."""

from __future__ import annotations

import contextlib
import hashlib
import os
import re
from array import array
from collections.abc import Hashable, Iterable
from dataclasses import replace
from functools import lru_cache
from typing import Any

import msgspec
from sqlalchemy import Connection, RowMapping, false, func, select

from oysterbench.core.errors import ResultError
from oysterbench.core.places import home
from oysterbench.core.text import composed, spellings
from oysterbench.evaluate.statistics import sequence_means
from oysterbench.results.records import samples
from oysterbench_leaderboard.boards.board import LEAST_DIGITS, BoardInfo, BoardPage, Query, Row
from oysterbench_leaderboard.boards.database import CONTENTS, ROWS, Database
from oysterbench_leaderboard.boards.index_writer import Contents, Progress, inputs_of, write
from oysterbench_leaderboard.storage.record_summary import RecordSummary
from oysterbench_leaderboard.storage.store import RecordStore

MOST_ORDERS = 128
"""Maximum number of sort orders that are cached, at 8 bytes per row."""

NUL = "\0"
"""Character that no record holds, and that PostgreSQL does not take in a text."""

MOST_WANTED = 500
"""Maximum number of rows that one statement fetches by position."""

_PREFIX = re.compile(f"[0-9a-f]{{{LEAST_DIGITS},64}}")
_COLUMNS = [ROWS.c[key] for key in Row.__dataclass_fields__]


def open_index(store: RecordStore, url: str | None = None) -> BoardIndex:
    """Open the index of a store and bring it up to date; it is created where there is none, and rebuilt where it is of
    another version.

    url: a file (SQLite), or postgresql+psycopg://...; by default a file in the home folder, one for each store.
    """
    index = BoardIndex(url or default_url(store), store)
    index.refresh()
    return index


def default_url(store: RecordStore) -> str:
    """Path of a store's own file in the home folder."""
    name = hashlib.sha256(str(store.folder.resolve()).encode()).hexdigest()[:12]
    return str(home() / "leaderboard" / f"index-{name}.sqlite")


class BoardIndex:
    """`BoardReader` on SQLite or PostgreSQL. Each answer is of one revision; sequences are in the board's order."""

    def __init__(self, url_or_path: str | os.PathLike[str], store: RecordStore) -> None:
        self.store, self.database = store, Database(url_or_path)
        self._orders: dict[Hashable, array[int]] = {}

    @property
    def name(self) -> str:
        """File or URL of the index, without a password."""
        return self.database.name

    @property
    def revision(self) -> str:
        """Revision, which changes whenever any answer does; key for caches of pages."""
        return self._contents().revision

    def rebuild(self, progress: Progress | None = None) -> None:
        """Rebuild everything from the store's files; readers see the old index until the new one is complete."""
        with self.database.writing() as connection:
            write(connection, self.store, True, progress)

    def refresh(self) -> None:
        """Take over what has changed in the store since; only the boards affected are ranked again."""
        # Where there is no index yet, or none can be created, the writer finds out.
        with contextlib.suppress(ResultError):
            if self._contents().inputs == inputs_of(self.store):
                return
        with self.database.writing() as connection:
            write(connection, self.store, False)

    def boards(self, track: str | None = None) -> list[BoardInfo]:
        """All boards: tracks in order, the newest evaluator of a split first."""
        return [board for board in self._contents().boards.values() if track in (None, board.track)]

    def page(self, board: str, query: Query) -> BoardPage:
        """Return a page of a board's rows. Raises ResultError where there is no such board or sort key."""
        with self.database.reading() as connection:
            info = _contents(connection).boards.get(board)
            if info is None:
                raise ResultError(f"no board {board!r:.40}; `oysterbench leaderboard` lists what there is")
            size, page = max(1, query.size), max(1, query.page)
            order = self._order(connection, info, query)
            wanted = order[(page - 1) * size : page * size]
            rows: dict[int, Row] = {}
            for i in range(0, len(wanted), MOST_WANTED):
                here = ROWS.c.board == board, ROWS.c.position.in_(wanted[i : i + MOST_WANTED])
                found = connection.execute(select(*_COLUMNS, ROWS.c.position).where(*here)).mappings()
                rows |= {row["position"]: _row(info, row) for row in found}
            in_order = tuple(rows[position] for position in wanted)
            return BoardPage(info, replace(query, page=page, size=size), in_order, len(order))

    def row(self, digest: str) -> Row:
        """Return a record's row. The digest may be abbreviated to 8 digits or more. Raises ResultError where no record
        matches, or several do."""
        if not _PREFIX.fullmatch(digest):
            raise ResultError(f"expected a digest of {LEAST_DIGITS} to 64 hex digits, got {digest!r:.80}")
        found = self._rows(ROWS.c.digest >= digest, ROWS.c.digest < digest + "g")
        if not found:
            why = self.problems().get(digest)
            told = f"it was left out: {why}" if why else "`oysterbench leaderboard --json` has the digests"
            raise ResultError(f"no such record: {digest[:12]}; {told}")
        if len(found) > 1:
            raise ResultError(f"several records begin with {digest}: give more digits")
        return found[0]

    def method(self, method: str, team: str | None = None) -> list[Row]:
        """All rows of a method, newest first, including superseded and withdrawn ones; names in any Unicode form."""
        if NUL in method:
            return []
        of_team = [] if team is None else [ROWS.c.team.in_(spellings(team))]
        return self._rows(ROWS.c.method.in_(spellings(method)), *of_team)

    def methods(self) -> list[tuple[str, str, int]]:
        """Method, team, number of current records."""
        key = ROWS.c.method, ROWS.c.team
        current = func.count().filter(ROWS.c.state == "current")
        with self.database.reading() as connection:
            found = connection.execute(select(*key, current).group_by(*key).order_by(*key)).all()
        return [(method, team, count) for method, team, count in found]

    def scores(self, digests: Iterable[str]) -> dict[str, dict[str, float]]:
        """Record -> sequence -> value of the ranking metric, for the sequences that it was run on; NaN where there is
        no value."""
        with self.database.reading() as connection:
            asked = select(ROWS.c.digest, ROWS.c.summary_data).where(ROWS.c.digest.in_(list(digests)))
            summaries = {row.digest: RecordSummary.decode(row.summary_data) for row in connection.execute(asked)}
        return {digest: dict(summary.scores.values) for digest, summary in summaries.items()}

    def sequence_means(self, digest: str) -> dict[str, dict[str, float | None]]:
        """Sequence -> metric -> mean over runs, for a record."""
        results = self.store.record(digest if len(digest) == 64 else self.row(digest).digest).results
        keys = dict.fromkeys(key for result in results for key in result.metrics)
        means = {key: sequence_means(samples(results, key)) for key in keys}
        names = dict.fromkeys(result.sequence for result in results)
        return {name: {key: means[key].get(name) for key in keys} for name in names}

    def problems(self) -> dict[str, str]:
        """Digests of files that were left out -> reason. The others are not affected."""
        return dict(sorted(self._contents().problems.items()))

    def close(self) -> None:
        """Close all connections; the next query opens new ones."""
        self.database.close()

    def _contents(self) -> Contents:
        with self.database.reading() as connection:
            return _contents(connection)

    def _order(self, connection: Connection, board: BoardInfo, query: Query) -> array[int]:
        """Positions of all rows that a query selects, in its order; cached until the records change, as sorting a large
        board takes longer than everything else on a page, and most pages need the same order."""
        key = (_contents(connection).revision, board.id, replace(query, page=1, size=1))
        order = self._orders.get(key)
        if order is None:
            chosen = [ROWS.c.board == board.id, ROWS.c.state.in_(query.states)]
            if query.tiers:
                chosen.append(ROWS.c.tier.in_(query.tiers))
            if NUL in query.text:
                chosen.append(false())
            elif query.text:
                chosen.append(ROWS.c.words.contains(composed(query.text).casefold(), autoescape=True))
            asked = select(ROWS.c.position).where(*chosen).order_by(*_sorting(board, query))
            order = array("l", connection.scalars(asked))
            if len(self._orders) >= MOST_ORDERS:
                self._orders.clear()
            self._orders[key] = order
        return order

    def _rows(self, *chosen: Any) -> list[Row]:
        """Rows that meet all conditions, newest first."""
        asked = select(*_COLUMNS).where(*chosen).order_by(ROWS.c.created.desc(), ROWS.c.digest)
        with self.database.reading() as connection:
            boards = _contents(connection).boards
            return [_row(boards[row["board"]], row) for row in connection.execute(asked).mappings()]


def _contents(connection: Connection) -> Contents:
    return _decoded(connection.scalar(select(CONTENTS.c.data)) or "{}")


@lru_cache(8)
def _decoded(data: str) -> Contents:
    return msgspec.json.decode(data, type=Contents)


def _row(board: BoardInfo, row: RowMapping) -> Row:
    """Make a `Row` of a database row, with coverage taken over the sequences of the board."""
    metrics = {**row["metrics"], "coverage": row["coverage"]}
    facts = {key: row[key] for key in Row.__dataclass_fields__}
    return Row(**{**facts, "metrics": {key: metrics[key] for key in board.columns}})


def _sorting(board: BoardInfo, query: Query) -> Iterable[Any]:
    """Expressions to sort a page by: records without the value come last in either order; equal ones by rank. Raises
    ResultError for an unknown key."""
    columns: dict[str, Any] = {"rank": ROWS.c.position, "method": ROWS.c.words, board.metric: ROWS.c.score}
    columns |= {key: ROWS.c.metrics[key].as_float() for key in board.columns}
    columns |= {key: ROWS.c[key] for key in ("team", "created", "score", "data_set", "coverage", "lost")}
    column = columns.get(query.sort)
    if column is None:
        raise ResultError(f"sort: expected one of {', '.join(columns)}, got {query.sort!r:.40}")
    if query.sort == "rank" and not query.descending:  # a database index has this order
        return (ROWS.c.position,)
    absent = ROWS.c.place if query.sort == "rank" else column
    return absent.is_(None), column.desc() if query.descending else column, ROWS.c.position
