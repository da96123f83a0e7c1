"""Scorings no longer have a lease: a dispatcher that takes over finds what its predecessor had started by its state."""

from __future__ import annotations

from alembic import op

revision, down_revision = "0002", "0001"


def upgrade() -> None:
    """Drop the column `lease`."""
    op.drop_column("submissions", "lease")
