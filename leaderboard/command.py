"""`oysterbench leaderboard`: parse, call, print."""

from __future__ import annotations

import click


@click.group("leaderboard", short_help="Published results: ranks, pages, submissions.", invoke_without_command=True)
@click.pass_context
def command(context: click.Context) -> None:
    """Show published results."""
