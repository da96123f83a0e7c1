"""Durable state of a server: teams, tokens, submissions and the log of events, in SQLite or PostgreSQL.

Everything is committed before a client is told of it. Every change of a submission and the event that records it are
one transaction; events are never changed. `migrations` creates the tables, and upgrades earlier ones to those defined
here.
"""

from __future__ import annotations

import contextlib
import errno
import os
import sqlite3
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Annotated, Any, Literal, get_type_hints

from alembic.util.exc import CommandError
from sqlalchemy import (
    Column,
    Connection,
    Float,
    Index,
    Integer,
    MetaData,
    String,
    Table,
    Text,
    UniqueConstraint,
    func,
    insert,
    select,
    text,
    update,
)
from sqlalchemy.exc import SQLAlchemyError

from oysterbench.core.errors import ResultError
from oysterbench.core.locks import locked
from oysterbench.core.text import in_one_line, printable
from oysterbench.version import VERSION
from oysterbench_leaderboard.boards.database import open_engine
from oysterbench_leaderboard.submissions.migrations import upgrade
from oysterbench_leaderboard.submissions.settings import SubmissionSettings, check_own

LOCK = 0x6469_7370_6174
"""Key of the PostgreSQL advisory lock that the one dispatcher holds."""

KEEPALIVES = {"idle": 10, "interval": 5, "count": 4}
"""TCP keepalive: seconds, and the number of probes. After half a minute of silence a host counts as gone, and its lock
is free."""

NO_ROOM = (sqlite3.SQLITE_FULL, sqlite3.SQLITE_IOERR_SHMSIZE)
"""SQLite error codes of a full disk."""

State = Literal["queued", "running", "done", "failed", "withdrawn"]

metadata = MetaData()

teams = Table("teams", metadata, Column("name", String(80), primary_key=True), Column("created", String(32)))

tokens = Table(
    "tokens",
    metadata,
    Column("id", String(16), primary_key=True),
    Column("team", String(80), nullable=False),
    Column("hash", String(64), nullable=False),
    Column("created", String(32), nullable=False),
    Column("revoked", String(32), nullable=False, default=""),
)

sessions = Table(
    "sessions",
    metadata,
    Column("hash", String(64), primary_key=True),
    Column("token", String(16), nullable=False),
    Column("expires", Float, nullable=False),
)

events = Table(
    "events",
    metadata,
    Column("number", Integer, primary_key=True, autoincrement=True),
    Column("at", String(32), nullable=False),
    Column("who", String(120), nullable=False),
    Column("what", String(32), nullable=False),
    Column("submission", String(16), nullable=False, default=""),
    Column("why", Text, nullable=False, default=""),
)


@dataclass(frozen=True)
class Submission:
    """One submission: its fields are the columns of the table.

    kind:      poses, predictions, commands or results
    digest:    SHA-256 of the upload, which is also the name of its file
    attempt:   number of times that its scoring was started
    reason:    why it failed, or was withdrawn
    record:    digest of the scored record, kept privately; published: of the record on the board; empty for none
    notice:    when its team withdrew it from the board, which may be told later; empty where it did not
    created, updated: UTC, ISO 8601
    """

    id: Annotated[str, String(16)]
    team: Annotated[str, String(80)]
    track: Annotated[str, String(32)]
    split: Annotated[str, String(80)]
    method: Annotated[str, String(80)]
    url: Annotated[str, String(300)]
    summary: Annotated[str, String(500)]
    kind: Annotated[str, String(16)]
    digest: Annotated[str, String(64)]
    size: Annotated[int, Integer]
    created: Annotated[str, String(32)]
    created_s: Annotated[float, Float]
    updated: Annotated[str, String(32)]
    state: Annotated[State, String(16)] = "queued"
    attempt: Annotated[int, Integer] = 0
    reason: Annotated[str, Text] = ""
    record: Annotated[str, String(64)] = ""
    published: Annotated[str, String(64)] = ""
    notice: Annotated[str, String(32)] = ""


submissions = Table(
    "submissions",
    metadata,
    *(
        Column(name, hint.__metadata__[0], primary_key=name == "id", nullable=False)
        for name, hint in get_type_hints(Submission, include_extras=True).items()
    ),
    UniqueConstraint("team", "track", "split", "method", "digest"),
    Index("submissions_waiting", "state", "attempt", "created_s"),
    Index("submissions_of_team", "team", "created_s"),
)


def utc(seconds: float) -> str:
    """Format Unix seconds as UTC in ISO 8601, to the second."""
    return datetime.fromtimestamp(seconds, UTC).strftime("%Y-%m-%dT%H:%M:%SZ")


class SubmissionDatabase:
    """The database, upgraded when it is opened. `writing` and `reading` give a connection in a transaction."""

    def __init__(self, settings: SubmissionSettings) -> None:
        check_own(settings)
        settings.folder.mkdir(parents=True, exist_ok=True)
        os.chmod(settings.folder, 0o700)
        pragmas = ("journal_mode=WAL", "synchronous=FULL", "foreign_keys=ON")
        try:
            self.engine = open_engine(settings.url, pragmas, pool_pre_ping=True)
        except (SQLAlchemyError, ImportError) as error:
            raise _not_opened(error) from None
        self._writing = self.engine.execution_options(writes=True)
        try:
            with self.writing() as connection:
                upgrade(connection)
        except (SQLAlchemyError, CommandError) as error:
            self.close()
            raise _not_opened(error) from None

    @contextmanager
    def writing(self) -> Iterator[Connection]:
        """Connection in a transaction that is committed as a whole when the block ends, or rolled back on an error."""
        with self._writing.begin() as connection:
            yield connection

    @contextmanager
    def reading(self) -> Iterator[Connection]:
        """Connection in a transaction for reading."""
        with self.engine.begin() as connection:
            yield connection

    @contextmanager
    def alone(self) -> Iterator[Connection | None]:
        """Connection that holds the dispatcher's lock as long as it lives, without a transaction; None where another
        process holds the lock. The lock is released with the connection or, for SQLite, with the process."""
        with contextlib.ExitStack() as stack:
            if self.engine.dialect.name == "sqlite":
                held = stack.enter_context(locked(f"{self.engine.url.database}.dispatcher", wait=False))
                connection = stack.enter_context(self._writing.connect())
            else:
                connection = stack.enter_context(self._writing.connect())
                # The only way for the server to notice a host that vanished silently.
                for key, seconds in KEEPALIVES.items():
                    connection.execute(text(f"SET tcp_keepalives_{key} = {seconds}"))
                held = connection.execute(select(func.pg_try_advisory_lock(LOCK))).scalar_one()
                connection.commit()
                stack.callback(connection.invalidate)  # back in the pool, it would keep the lock
            yield connection if held else None

    def close(self) -> None:
        """Close all connections."""
        self.engine.dispose()


def is_disk_full(error: BaseException) -> bool:
    """Whether an error of a file, or of an SQLite database, says that there is no room left on its disk."""
    code = getattr(getattr(error, "orig", None), "sqlite_errorcode", None)
    full = (errno.ENOSPC, errno.EDQUOT)
    return code in NO_ROOM or (isinstance(error, OSError) and error.errno in full)


def _not_opened(error: Exception) -> ResultError:
    why = in_one_line(error, 300)
    if isinstance(error, CommandError):
        why = f"it was made by a later version of oysterbench than {VERSION} ({why})"
    if isinstance(error, ImportError):
        why += "; pip install 'oysterbench[postgres]'"
    return ResultError(f"the database of submissions cannot be opened: {why}")


def log_event(connection: Connection, at: str, who: str, what: str, submission: str = "", why: str = "") -> None:
    """Append an event to the log. Whatever a client sent stands in it escaped: PostgreSQL takes no NUL."""
    who, why = printable(who), printable(why)
    values = {"at": at, "who": who[:120], "what": what, "submission": submission, "why": why[:2000]}
    connection.execute(insert(events).values(values))


def find(
    connection: Connection, *conditions: Any, newest: bool = True, limit: int | None = None, lock: bool = False
) -> list[Submission]:
    """Return the submissions that meet all conditions, in order of creation; newest: the newest first; lock: let no
    other transaction change them before this one ends."""
    time = submissions.c.created_s.desc() if newest else submissions.c.created_s
    query = select(submissions).where(*conditions).order_by(time, submissions.c.id).limit(limit)
    if lock:
        query = query.with_for_update()
    return [Submission(**row) for row in connection.execute(query).mappings()]


def change(connection: Connection, id: str, at: str, *conditions: Any, **values: Any) -> bool:
    """Update a submission if it meets the conditions; return whether it did."""
    statement = update(submissions).where(submissions.c.id == id, *conditions).values(**values, updated=at)
    return connection.execute(statement).rowcount == 1


def unpublish(database: SubmissionDatabase, one: Submission, at: str) -> None:
    """Take back a publication that could not be written to the board, unless its team has withdrawn it meanwhile."""
    with database.writing() as connection:
        if change(connection, one.id, at, submissions.c.state == "done", published=""):
            log_event(connection, at, one.team, "unpublished", one.id, "it could not be written to the board")


def log(connection: Connection, submission: str = "", limit: int = 200) -> list[dict[str, Any]]:
    """Return the newest `limit` events in chronological order; only those of one submission, if it is given."""
    query = select(events).order_by(events.c.number.desc()).limit(limit)
    if submission:
        query = query.where(events.c.submission == submission)
    return [dict(row) for row in connection.execute(query).mappings()][::-1]


def lock_team(connection: Connection, team: str) -> None:
    """Lock a team, so that its quota, duplicates and published names are checked without interference."""
    connection.execute(select(teams.c.name).where(teams.c.name == team).with_for_update()).first()
