"""How the database of submissions came to its tables, step by step: alembic's, one file of `versions/` for each.

Whatever opens the database takes it to the newest step first, all steps in one transaction: after an upgrade of
oysterbench, the next start is enough, and a copy from `oysterbench leaderboard submissions backup` is the way back.
A change of `database.metadata` needs a step more, which names the last one as `down_revision`; a test compares the two.
The board's index needs none, as it is made anew from the records (`oysterbench leaderboard rebuild`).
"""

from __future__ import annotations

from pathlib import Path

from alembic import command
from alembic.config import Config
from sqlalchemy import Connection, text

LOCK = 0x7375_626D_6974
"""The advisory lock of PostgreSQL under which one process upgrades, and the others wait."""


def upgrade(connection: Connection, revision: str = "head") -> None:
    """Take a database to a revision, in the transaction of the connection. Raises alembic's CommandError where it is of
    a later version than this one knows."""
    if connection.dialect.name == "postgresql":
        connection.execute(text(f"SELECT pg_advisory_xact_lock({LOCK})"))
    config = Config(attributes={"connection": connection})
    config.set_main_option("script_location", str(Path(__file__).parent).replace("%", "%%"))
    config.set_main_option("path_separator", "os")
    command.upgrade(config, revision)
