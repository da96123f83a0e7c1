"""Where an index lies: SQLite as one file that is replaced whole, or PostgreSQL, where a rebuild is one transaction."""

from __future__ import annotations

import contextlib
import os
import re
import tempfile
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from urllib.parse import quote

from sqlalchemy import Connection, Engine, create_engine, delete, event, func, select, text
from sqlalchemy.engine import make_url
from sqlalchemy.exc import ArgumentError, SQLAlchemyError

from oysterbench.core.errors import ResultError
from oysterbench.core.files import locked
from oysterbench_leaderboard.filling import meta, schema
from oysterbench_leaderboard.schema import METADATA

_LOCK = 0x6F79_7374_6572  # the advisory lock of PostgreSQL under which the index is written


class Database:
    """Connections to it. name: where it lies, without a password."""

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
        self._file: Path | None = None
        self._switch = threading.Lock()
        self._of_file: tuple[int, int] | None = None
        self._engine: Engine | None = None
        if url.get_backend_name() == "sqlite":
            if not url.database or url.database == ":memory:":
                raise ResultError("index: expected a file for SQLite, got none")
            self._file = Path(url.database)
            self.name = str(self._file)
        elif url.get_backend_name() == "postgresql":
            self._engine = create_engine(url, pool_size=16, max_overflow=64)
        else:
            raise ResultError(f"index: expected SQLite or PostgreSQL, got {url.get_backend_name()}")

    def engine(self) -> Engine:
        """The engine; a new one where the file was replaced since. Connections in use keep the old file."""
        if self._file is None:
            assert self._engine is not None
            return self._engine
        try:
            status = self._file.stat()
        except FileNotFoundError:
            raise ResultError(f"{self.name}: no index is there; make it: `oysterbench leaderboard rebuild`") from None
        with self._switch:
            # An inode is not used again while a connection of the pool holds it open.
            if self._engine is None or self._of_file != (status.st_dev, status.st_ino):
                if self._engine is not None:
                    self._engine.dispose()
                self._engine, self._of_file = _sqlite(self._file), (status.st_dev, status.st_ino)
            return self._engine

    def close(self) -> None:
        """Let go of all connections; the next question opens new ones."""
        with self._switch:
            if self._engine is not None:
                self._engine.dispose()

    @contextlib.contextmanager
    def reading(self) -> Iterator[Connection]:
        """A connection whose questions are all answered from one state of the index."""
        with self.told():
            engine = self.engine()
            with engine.connect() as connection:
                connection.execute(
                    text("SET TRANSACTION ISOLATION LEVEL REPEATABLE READ" if self._file is None else "BEGIN")
                )
                yield connection

    @contextlib.contextmanager
    def told(self) -> Iterator[None]:
        """What a database says, in one line that names the index and no password."""
        try:
            yield
        except SQLAlchemyError as error:
            said = " ".join(str(getattr(error, "orig", None) or error).split())
            raise ResultError(
                f"index {self.name}: {said:.200}; `oysterbench leaderboard rebuild` makes it anew"
            ) from None

    @contextlib.contextmanager
    def only_writer(self) -> Iterator[None]:
        """Nobody else, on any host, writes meanwhile; readers are not held up."""
        if self._file is not None:
            with locked(self._file.with_name(f".{self._file.name}.lock")):
                yield
            return
        with self.engine().connect() as connection:
            connection.execute(select(func.pg_advisory_lock(_LOCK)))
            try:
                yield
            finally:
                connection.execute(select(func.pg_advisory_unlock(_LOCK)))

    def usable(self) -> bool:
        """Whether there is an index, of this version and whole."""
        try:
            with self.engine().connect() as connection:
                return meta(connection).get("schema") == schema()
        except (ResultError, SQLAlchemyError):
            if self._file is None:
                with self.engine().connect():  # a server that is not there is no reason to build
                    pass
            return False

    @contextlib.contextmanager
    def new_tables(self) -> Iterator[Connection]:
        """Empty tables, which take the place of the old ones when the block is left without an error."""
        if self._file is None:
            with self.engine().begin() as connection:
                METADATA.create_all(connection)
                if meta(connection).get("schema") != schema():
                    METADATA.drop_all(connection)
                    METADATA.create_all(connection)
                for table in METADATA.tables.values():
                    connection.execute(delete(table))
                yield connection
            return
        self._file.parent.mkdir(parents=True, exist_ok=True)
        for left in self._file.parent.glob(f".{self._file.name}.*.new"):  # by a rebuild that was killed
            left.unlink(missing_ok=True)
        handle, temporary = tempfile.mkstemp(dir=self._file.parent, prefix=f".{self._file.name}.", suffix=".new")
        os.close(handle)
        try:
            engine = _sqlite(Path(temporary), durable=False)
            with engine.begin() as connection:
                METADATA.create_all(connection)
                yield connection
            engine.dispose()
            with open(temporary, "rb") as file:
                os.fsync(file.fileno())
            self._settle_journal()
            os.chmod(temporary, 0o644)
            os.replace(temporary, self._file)
        except BaseException:
            Path(temporary).unlink(missing_ok=True)
            raise

    def _settle_journal(self) -> None:
        """A journal that a killed writer left must not be taken for the new file's: the old file takes it back now."""
        assert self._file is not None
        journal = self._file.with_name(f"{self._file.name}-journal")
        if not journal.exists():
            return
        with contextlib.suppress(ResultError, SQLAlchemyError), self.engine().connect() as connection:
            meta(connection)
        journal.unlink(missing_ok=True)


def _sqlite(path: Path, durable: bool = True) -> Engine:
    engine = create_engine(
        f"sqlite:///file:{quote(str(path.resolve()))}?mode=rw&uri=true",
        pool_size=16,
        max_overflow=64,
        connect_args={"timeout": 60, "check_same_thread": False},
    )

    @event.listens_for(engine, "connect")
    def settings(connection: Any, _: Any) -> None:
        connection.execute("PRAGMA mmap_size = 268435456")
        if not durable:
            connection.execute("PRAGMA journal_mode = OFF")
            connection.execute("PRAGMA synchronous = OFF")

    return engine
