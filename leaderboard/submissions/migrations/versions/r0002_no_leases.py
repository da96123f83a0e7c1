"""Scorings have no lease any more: what a dispatcher that is gone had begun is known by that."""

from __future__ import annotations

from alembic import op

revision, down_revision = "0002", "0001"


def upgrade() -> None:
    """Drop the column."""
    op.drop_column("submissions", "lease")
