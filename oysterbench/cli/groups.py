"""A command group that names the command which was meant."""

from __future__ import annotations

import click

from oysterbench.core.names import did_you_mean, nearest


class Group(click.Group):
    """Command group whose commands may be found rather than added: click suggests only those that were added, and in
    its older versions none."""

    def resolve_command(
        self, context: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        name = args[0]
        if not name.startswith("-") and name not in self.list_commands(context):
            meant = did_you_mean(nearest(name, self.list_commands(context))).strip()
            context.fail(f"No such command {name!r}.{' ' * bool(meant)}{meant.capitalize()}")
        return super().resolve_command(context, args)
