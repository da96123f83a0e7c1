"""The first tables, which may exist already: before there were migrations, each start created what was missing."""

from __future__ import annotations

from typing import Any

import sqlalchemy as sa
from alembic import op

revision, down_revision = "0001", None


def upgrade() -> None:
    """Create the tables of teams and their tokens, sessions of the form, submissions, and the log of events."""

    def text(name: str, length: int, nullable: bool = False, **options: Any) -> sa.Column[str]:
        return sa.Column(name, sa.String(length), nullable=nullable, **options)

    def table(name: str, *items: sa.schema.SchemaItem) -> None:
        op.create_table(name, *items, if_not_exists=True)

    table("teams", text("name", 80, primary_key=True), text("created", 32, nullable=True))
    table(
        "tokens",
        text("id", 16, primary_key=True),
        text("team", 80),
        text("hash", 64),
        text("created", 32),
        text("revoked", 32),
    )
    table(
        "sessions",
        text("hash", 64, primary_key=True),
        text("token", 16),
        sa.Column("expires", sa.Float, nullable=False),
    )
    table(
        "events",
        sa.Column("number", sa.Integer, primary_key=True, autoincrement=True),
        text("at", 32),
        text("who", 120),
        text("what", 32),
        text("submission", 16),
        sa.Column("why", sa.Text, nullable=False),
    )
    table(
        "submissions",
        text("id", 16, primary_key=True),
        text("team", 80),
        text("track", 32),
        text("split", 80),
        text("method", 80),
        text("url", 300),
        text("summary", 500),
        text("kind", 16),
        text("digest", 64),
        sa.Column("size", sa.Integer, nullable=False),
        text("created", 32),
        sa.Column("created_s", sa.Float, nullable=False),
        text("updated", 32),
        text("state", 16),
        sa.Column("attempt", sa.Integer, nullable=False),
        sa.Column("lease", sa.Float, nullable=False),
        sa.Column("reason", sa.Text, nullable=False),
        text("record", 64),
        text("published", 64),
        text("notice", 32),
        sa.UniqueConstraint("team", "track", "split", "method", "digest"),
    )
    columns = {"submissions_waiting": ["state", "attempt", "created_s"], "submissions_of_team": ["team", "created_s"]}
    for name, names in columns.items():
        op.create_index(name, "submissions", names, if_not_exists=True)
