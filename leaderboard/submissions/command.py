"""`oysterbench submit`: send results or estimates to a leaderboard."""

from __future__ import annotations

import click


@click.command("submit", short_help="Send results or estimates to a leaderboard.")
def command() -> None:
    """Send results or estimates to a leaderboard."""
