"""Options whose value is missing, so that click would take the next option for it."""

from __future__ import annotations

from collections.abc import Iterable

import click


def check_values(context: click.Context, command: click.Command | None, words: Iterable[str]) -> None:
    """Refuse an option whose value is missing, of a command and of the commands within it. Raises UsageError.

    A value may begin with one dash, as negative numbers do, but not be an option of the command or begin with two
    dashes: `--option=--value` passes one that does.
    """
    if command is None:
        return
    options = [one for one in command.get_params(context) if isinstance(one, click.Option)]
    names = {name for one in options for name in (*one.opts, *one.secondary_opts)} | set(context.help_option_names)
    valued = {name for one in options if not one.is_flag and not one.count for name in one.opts}
    words = iter(words)
    for word in words:
        if word == "--":
            return
        if word in valued:
            value = next(words, "")
            if value.startswith("--") or value in names:
                raise click.UsageError(f"{word}: expected a value, got {value}; if it is the value: {word}={value}")
        elif isinstance(command, click.Group) and not word.startswith("-"):
            try:
                within = command.get_command(context, word)
            except ModuleNotFoundError:  # the group itself says what to install
                return
            check_values(context, within, words)
            return
