"""The only way to print to the terminal: any text may contain untrusted input, so it is made printable."""

from __future__ import annotations

import click

from oysterbench.core.text import printable


def echo(text: object, nl: bool = True) -> None:
    """Print a result, on stdout."""
    click.echo(printable(str(text)), nl=nl)  # noqa: TID251


def message(text: object, nl: bool = True) -> None:
    """Print a message to the user, on stderr."""
    click.echo(printable(str(text)), nl=nl, err=True)  # noqa: TID251
