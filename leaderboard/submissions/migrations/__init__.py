"""Migrations of the submission database with alembic, one file in `versions/` per step.

Opening the database first upgrades it to the newest step, all steps in one transaction: after an upgrade of
oysterbench, a restart is enough. The way back is a copy from `oysterbench leaderboard submissions backup`. A change of
`database.metadata` needs a further step, which names the last one as `down_revision`; a test compares the two. The
board's index needs no migrations, as it is rebuilt from the records (`oysterbench leaderboard rebuild`).
"""

from __future__ import annotations

from pathlib import Path

from alembic import command
from alembic.config import Config
from sqlalchemy import Connection, text

LOCK = 0x7375_626D_6974
"""Key of the PostgreSQL advisory lock under which one process upgrades while the others wait."""


def upgrade(connection: Connection, revision: str = "head") -> None:
    """Upgrade a database to a revision, in the transaction of the connection. Raises alembic's CommandError where it
    was made by a later version than this one."""
    if connection.dialect.name == "postgresql":
        connection.execute(text(f"SELECT pg_advisory_xact_lock({LOCK})"))
    config = Config(attributes={"connection": connection})
    config.set_main_option("script_location", str(Path(__file__).parent).replace("%", "%%"))
    config.set_main_option("path_separator", "os")
    command.upgrade(config, revision)
