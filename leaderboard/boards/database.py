"""The database of the index: its tables, the same in SQLite and PostgreSQL, and connections to it."""

from __future__ import annotations

import contextlib
import os
import re
import sqlite3
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any
from urllib.parse import quote

from sqlalchemy import (
    JSON,
    Boolean,
    Column,
    Connection,
    Engine,
    Float,
    Index,
    Integer,
    MetaData,
    NullPool,
    Table,
    Text,
    create_engine,
    event,
    text,
)
from sqlalchemy.engine import URL, make_url
from sqlalchemy.exc import ArgumentError, OperationalError, SQLAlchemyError

from oysterbench.core.errors import ResultError
from oysterbench.core.locks import locked
from oysterbench_leaderboard.boards.board import Row

METADATA = MetaData()
TEXT = Text().with_variant(Text(collation="C"), "postgresql")  # sorted as in SQLite: by bytes, whatever the locale
_LOCK = 0x6F79_7374_6572  # PostgreSQL advisory lock under which the index is written

UNWRITABLE = (sqlite3.SQLITE_READONLY, sqlite3.SQLITE_IOERR, sqlite3.SQLITE_FULL, sqlite3.SQLITE_CANTOPEN)
"""Primary SQLite error codes of files to which, or beside which, nothing can be written."""

CONTENTS = Table("oysterbench_contents", METADATA, Column("data", TEXT))
"""`index_writer.Contents` as JSON, in one row: everything that is small."""

_KINDS: dict[str, Any] = {"position": Integer, "place": Integer, "rank": Integer, "sequences": Integer, "runs": Integer}
_KINDS |= {"failures": Integer, "lost": Integer, "tied": Boolean, "metrics": JSON}
_KINDS |= dict.fromkeys(("score", "low", "high", "data_set", "coverage"), Float(53))

ROWS = Table(
    "oysterbench_rows",
    METADATA,
    *(
        Column(key, _KINDS.get(key, TEXT), primary_key=key == "digest")
        for key in (*Row.__dataclass_fields__, "words", "position", "summary_data")
    ),
    Index("oysterbench_rows_in_order", "board", "position", "state", "tier", "words"),
    Index("oysterbench_rows_of_method", "method", "team"),
)
"""Rows of boards (`board.Row`). words: method and team, for searching; position: on its board, in order of rank, with
those without a place last; summary_data: `RecordSummary` as JSON, by which a board is ranked."""


class Database:
    """Connections to an index. name: its file or URL, without a password. Raises ResultError for an invalid place."""

    def __init__(self, url_or_path: str | os.PathLike[str]) -> None:
        place = os.fspath(url_or_path)
        if "://" not in place:
            place = f"sqlite:///{place}"
        try:
            url = make_url(re.sub(r"^postgres(ql)?://", "postgresql+psycopg://", place))
        except ArgumentError:
            raise ResultError(
                f"index: expected a file or postgresql+psycopg://user@host/name, got {place!r:.80}"
            ) from None
        self.name = url.render_as_string(hide_password=True)
        self.file: Path | None = None
        if url.get_backend_name() == "sqlite":
            if not url.database or url.database == ":memory:":
                raise ResultError("index: expected a file for SQLite, got none")
            self.file = Path(url.database)
            self.name = str(self.file)
            # Opened for each query, as the file may be replaced by another at any time.
            place = f"sqlite:///file:{quote(str(self.file.resolve()))}?uri=true"
            self.engine = open_engine(f"{place}&mode=rw", poolclass=NullPool)
            self._unchanging = open_engine(f"{place}&mode=ro&immutable=1", poolclass=NullPool)
        elif url.get_backend_name() == "postgresql":
            self.engine = open_engine(url, pool_size=16, max_overflow=64)
        else:
            raise ResultError(f"index: expected SQLite or PostgreSQL, got {url.get_backend_name()}")

    def close(self) -> None:
        """Close all connections; the next query opens new ones."""
        self.engine.dispose()

    @contextlib.contextmanager
    def reading(self) -> Iterator[Connection]:
        """Connection whose queries are all answered from one state of the index. Raises ResultError in one line."""
        try:
            with contextlib.ExitStack() as stack:
                yield stack.enter_context(self._beginning())
        except SQLAlchemyError as error:
            raise self._in_one_line(error) from None

    @contextlib.contextmanager
    def _beginning(self) -> Iterator[Connection]:
        """Connection in a transaction for reading. To read an SQLite file in WAL mode is to write beside it: where
        that is impossible, as on a full disk, it is read as a file that nobody changes, if nothing waits to go into
        it."""
        with contextlib.ExitStack() as stack:
            try:
                connection = stack.enter_context(self.engine.begin())
                one_state = "SET TRANSACTION ISOLATION LEVEL REPEATABLE READ"
                connection.execute(text(one_state if self.file is None else "PRAGMA user_version"))
            except OperationalError as error:
                if not self._is_unwritable(error) or self._has_log():
                    raise
                stack.close()
                connection = stack.enter_context(self._unchanging.begin())
            yield connection

    def _has_log(self) -> bool:
        """Whether the write-ahead log of an SQLite file has changes that are not in the file yet."""
        assert self.file is not None
        log = self.file.with_name(f"{self.file.name}-wal")
        return log.exists() and log.stat().st_size > 0

    def _is_unwritable(self, error: Exception) -> bool:
        """Whether an error says of an SQLite file which is there that nothing can be written to it, or beside it."""
        code = getattr(getattr(error, "orig", None) or error, "sqlite_errorcode", 0) & 0xFF
        return self.file is not None and self.file.is_file() and code in UNWRITABLE

    @contextlib.contextmanager
    def writing(self) -> Iterator[Connection]:
        """Connection in a transaction of the only writer on any host; readers see the old state until it ends. Missing
        tables are created; a file that is not a database is replaced. Raises ResultError in one line."""
        try:
            with contextlib.ExitStack() as stack:
                if self.file is not None:
                    stack.enter_context(locked(self.file.with_name(f".{self.file.name}.lock")))
                    _make_file(self.file)
                connection = stack.enter_context(self.engine.execution_options(writes=True).begin())
                if self.file is None:
                    connection.execute(text(f"SELECT pg_advisory_xact_lock({_LOCK})"))
                METADATA.create_all(connection)
                yield connection
        except (SQLAlchemyError, sqlite3.Error) as error:
            raise self._in_one_line(error) from None

    def _in_one_line(self, error: Exception) -> ResultError:
        message = " ".join(str(getattr(error, "orig", None) or error).split())
        advice = "`oysterbench leaderboard rebuild` rebuilds it"
        if self._is_unwritable(error):
            advice = "make room on its disk, or let this user write to its folder"
        return ResultError(f"index {self.name}: {message:.200}; {advice}")


def _make_file(file: Path) -> None:
    """Create an SQLite file in WAL mode, in which readers and the writer do not wait for each other; a file that is not
    a database is replaced."""
    for attempt in range(2):
        try:
            with contextlib.closing(sqlite3.connect(file, timeout=60)) as connection:
                connection.execute("PRAGMA journal_mode = WAL")
            return
        except sqlite3.DatabaseError as error:
            if attempt or isinstance(error, sqlite3.OperationalError):  # a full disk, say: the file is as good as ever
                raise
            for suffix in ("", "-wal", "-shm", "-journal"):
                file.with_name(file.name + suffix).unlink(missing_ok=True)


def open_engine(url: str | URL, pragmas: Iterable[str] = (), **options: Any) -> Engine:
    """Engine for SQLite or PostgreSQL; a transaction with the execution option `writes` waits for other writers.

    pragmas: for SQLite, set on every connection; options: for `create_engine`
    """
    if not str(url).startswith("sqlite"):
        # Explicit, as a database created without an encoding would answer in bytes.
        return create_engine(url, connect_args={"client_encoding": "utf8"}, **options)
    engine = create_engine(url, connect_args={"timeout": 60.0, "check_same_thread": False}, **options)

    @event.listens_for(engine, "connect")
    def connected(connection: Any, record: Any) -> None:
        connection.isolation_level = None  # the driver starts transactions too late, and never for reading
        for pragma in pragmas:
            connection.execute(f"PRAGMA {pragma}")

    @event.listens_for(engine, "begin")
    def begin(connection: Connection) -> None:
        # A transaction that upgrades from reading to writing fails if another writes in between; IMMEDIATE waits.
        writes = connection.get_execution_options().get("writes")
        connection.exec_driver_sql("BEGIN IMMEDIATE" if writes else "BEGIN")

    return engine
