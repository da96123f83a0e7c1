"""The durable state: teams, tokens, submissions and the log of events, in SQLite or PostgreSQL.

Whatever is answered to a client has been committed before. Every change of a submission and the event that tells of it
are one transaction; no event is ever changed.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, fields
from datetime import UTC, datetime
from typing import Any, Literal

from sqlalchemy import (
    Column,
    Connection,
    Engine,
    Float,
    Index,
    Integer,
    MetaData,
    String,
    Table,
    Text,
    UniqueConstraint,
    create_engine,
    event,
    insert,
    select,
    update,
)
from sqlalchemy.exc import SQLAlchemyError

from oysterbench.core.errors import ResultError
from oysterbench_leaderboard.submissions.settings import Settings

Stage = Literal["queued", "running", "done", "failed", "withdrawn"]

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

submissions = Table(
    "submissions",
    metadata,
    Column("id", String(16), primary_key=True),
    Column("team", String(80), nullable=False),
    Column("track", String(32), nullable=False),
    Column("split", String(80), nullable=False),
    Column("method", String(80), nullable=False),
    Column("url", String(300), nullable=False),
    Column("summary", String(500), nullable=False),
    Column("kind", String(16), nullable=False),
    Column("digest", String(64), nullable=False),
    Column("size", Integer, nullable=False),
    Column("state", String(16), nullable=False),
    Column("attempt", Integer, nullable=False, default=0),
    Column("lease", Float, nullable=False, default=0.0),
    Column("reason", Text, nullable=False, default=""),
    Column("record", String(64), nullable=False, default=""),
    Column("published", String(64), nullable=False, default=""),
    Column("notice", String(32), nullable=False, default=""),
    Column("created", String(32), nullable=False),
    Column("created_s", Float, nullable=False),
    Column("updated", String(32), nullable=False),
    UniqueConstraint("team", "track", "split", "method", "digest"),
    Index("submissions_waiting", "state", "attempt", "created_s"),
    Index("submissions_of_team", "team", "created_s"),
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
    """One submission.

    kind:      poses, answers or results
    digest:    SHA-256 of what was sent: the name of its file
    attempt:   how often it was begun to be scored; lease: until when the one that does may be thought alive, in Unix
               seconds
    reason:    why it failed, or was withdrawn
    record:    digest of what was scored, kept privately; published: of what the board shows; empty for none
    notice:    when it was withdrawn from the board; empty where it was not
    created, updated: UTC, ISO 8601
    """

    id: str
    team: str
    track: str
    split: str
    method: str
    url: str
    summary: str
    kind: str
    digest: str
    size: int
    state: Stage
    attempt: int
    lease: float
    reason: str
    record: str
    published: str
    notice: str
    created: str
    created_s: float
    updated: str


COLUMNS = [submissions.c[f.name] for f in fields(Submission)]


def utc(seconds: float) -> str:
    """Unix seconds as UTC in ISO 8601, to the second."""
    return datetime.fromtimestamp(seconds, UTC).strftime("%Y-%m-%dT%H:%M:%SZ")


class State:
    """The database. `writing` and `reading` give a connection in a transaction."""

    def __init__(self, settings: Settings) -> None:
        settings.folder.mkdir(parents=True, exist_ok=True)
        os.chmod(settings.folder, 0o700)
        try:
            self.engine = _engine(settings.url)
            self._writing = self.engine.execution_options(writes=True)
            metadata.create_all(self._writing)
        except (SQLAlchemyError, ImportError) as error:
            line = " ".join(str(error).split())[:300]
            raise ResultError(f"the database of submissions cannot be opened: {line}") from None

    @contextmanager
    def writing(self) -> Iterator[Connection]:
        """All of the block, or nothing of it, is there when it has ended."""
        with self._writing.begin() as connection:
            yield connection

    @contextmanager
    def reading(self) -> Iterator[Connection]:
        """One moment of the database."""
        with self.engine.begin() as connection:
            yield connection

    def close(self) -> None:
        """No more connections."""
        self.engine.dispose()


def _engine(url: str) -> Engine:
    if not url.startswith("sqlite"):
        return create_engine(url, pool_pre_ping=True)
    engine = create_engine(url, connect_args={"timeout": 60.0})

    @event.listens_for(engine, "connect")
    def connected(connection: Any, record: Any) -> None:
        connection.isolation_level = None  # the driver begins transactions too late, and never for reading
        for pragma in ("journal_mode=WAL", "synchronous=FULL", "foreign_keys=ON"):
            connection.execute(f"PRAGMA {pragma}")

    @event.listens_for(engine, "begin")
    def begin(connection: Connection) -> None:
        # A writer that begins as a reader fails where another one writes between; one that says so at once waits.
        writes = connection.get_execution_options().get("writes")
        connection.exec_driver_sql("BEGIN IMMEDIATE" if writes else "BEGIN")

    return engine


def tell(connection: Connection, at: str, who: str, what: str, submission: str = "", why: str = "") -> None:
    """Append an event."""
    values = {"at": at, "who": who[:120], "what": what, "submission": submission, "why": why[:2000]}
    connection.execute(insert(events).values(values))


def find(connection: Connection, *conditions: Any, newest: bool = True, limit: int | None = None) -> list[Submission]:
    """Submissions for which all conditions hold."""
    time = submissions.c.created_s.desc() if newest else submissions.c.created_s
    query = select(*COLUMNS).where(*conditions).order_by(time, submissions.c.id).limit(limit)
    return [Submission(**row) for row in connection.execute(query).mappings()]


def change(connection: Connection, id: str, at: str, *conditions: Any, **values: Any) -> bool:
    """Change a submission where the conditions hold; whether they did."""
    statement = update(submissions).where(submissions.c.id == id, *conditions).values(**values, updated=at)
    return connection.execute(statement).rowcount == 1


def log(connection: Connection, submission: str = "", limit: int = 200) -> list[dict[str, Any]]:
    """The newest events, the oldest of them first; of one submission, where it is named."""
    query = select(events).order_by(events.c.number.desc()).limit(limit)
    if submission:
        query = query.where(events.c.submission == submission)
    return [dict(row) for row in connection.execute(query).mappings()][::-1]
