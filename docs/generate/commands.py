"""The page of all commands and their options, from the click commands themselves."""

from __future__ import annotations

import inspect
import re
import textwrap
from collections.abc import Iterator

import click

from docs.generate.markdown import code, fence, table

WIDTH = 100  # characters, of text that is laid out as in a terminal

HEAD = """# Commands

Every command takes `--help`, which prints the same text as here. Data goes to stdout, progress and messages to stderr;
`--json` prints only JSON on stdout. An error is one line, with a non-zero exit status.

"""


def all_commands() -> list[click.Context]:
    """Contexts of all commands of the installation, including those from entry points, in order."""
    from oysterbench.cli.main import main

    # With the settings of the command itself: click caches the help option by the first context it is asked with.
    settings = {**main.context_settings, "max_content_width": WIDTH}
    return list(_below(click.Context(main, info_name="oysterbench", **settings)))


def _below(context: click.Context) -> Iterator[click.Context]:
    yield context
    if isinstance(context.command, click.Group):
        for name in context.command.list_commands(context):
            command = context.command.get_command(context, name)
            if command is not None and not command.hidden:
                yield from _below(click.Context(command, parent=context, info_name=name))


def commands_page() -> str:
    """The page of all commands."""
    return HEAD + "\n".join(_section(context) for context in all_commands())


def _section(context: click.Context) -> str:
    level = min(2 + max(context.command_path.count(" ") - 1, 0), 4)
    usage = context.command.get_usage(context).removeprefix("Usage: ")
    pieces = [f"{'#' * level} {context.command_path}\n", fence(" ".join(usage.split()))]
    pieces += map(_paragraph, inspect.cleandoc(context.command.help or "").split("\n\n"))
    if rows := [_row(context, item) for item in context.command.get_params(context) if _told(item)]:
        pieces.append(table(("Option", "What"), rows))
    if context.command.epilog:
        pieces.append(_plain(context.command.epilog) + "\n")
    elif formats := _epilog(context):
        pieces.append(fence(formats))
    return "\n".join(pieces)


def _told(item: click.Parameter) -> bool:
    return isinstance(item, click.Option) and not item.hidden and "--help" not in item.opts


def _row(context: click.Context, item: click.Parameter) -> tuple[str, str]:
    names, about = item.get_help_record(context) or ("", "")
    return code(names), _plain(about)


def _paragraph(text: str) -> str:
    """Convert a paragraph of a help text; one that click must not wrap is a heading followed by a block of code."""
    if not text.startswith("\b"):
        return _plain(" ".join(text.split())) + "\n"
    first, _, rest = text.removeprefix("\b").lstrip("\n").partition("\n")
    if not rest:
        return fence(first.strip())
    return f"{_plain(first.strip())}\n\n{fence(textwrap.dedent(rest))}"


def _plain(text: str) -> str:
    """Escape text so that only code is marked up."""
    return "".join(
        piece if piece.startswith("`") else re.sub(r"([\\*_\[\]<>#])", r"\\\1", piece)
        for piece in re.split(r"(`[^`]*`)", text)
    )


def _epilog(context: click.Context) -> str:
    """What a command prints below its options, such as the formats of `export`."""
    formatter = click.HelpFormatter(width=WIDTH)
    context.command.format_epilog(context, formatter)
    return formatter.getvalue().strip()
