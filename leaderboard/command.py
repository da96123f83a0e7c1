"""`oysterbench leaderboard`: the group, whose commands are imported only when they are called."""

from __future__ import annotations

import importlib
from pathlib import Path
from typing import Any

import click

from oysterbench.cli.groups import Group
from oysterbench.cli.outputs import TEXTS
from oysterbench.core.errors import ResultError

TERMINAL, ADMIN = "oysterbench_leaderboard.commands.terminal", "oysterbench_leaderboard.commands.admin"
SERVER, TEAMS = "oysterbench_leaderboard.site.command", "oysterbench_leaderboard.submissions.command_admin"

COMMANDS: dict[str, tuple[str, str, str]] = {
    "show": (TERMINAL, "show_command", "Show a record: its place, and its numbers by sequence."),
    "history": (TERMINAL, "history_command", "Show all records of a method, newest first."),
    "literature": (TERMINAL, "literature_command", "Show results reported by others on other data."),
    "add": (ADMIN, "add_command", "Put results on the board."),
    "withdraw": (ADMIN, "withdraw_command", "Take a record off the board, with a reason."),
    "restore": (ADMIN, "restore_command", "Put a withdrawn record back, with a reason."),
    "rebuild": (ADMIN, "rebuild_command", "Rebuild the index from the records."),
    "verify": (ADMIN, "verify_command", "Check every record, status change and curve."),
    "rescore": (ADMIN, "rescore_command", "Score kept estimates with this version's evaluator."),
    "serve": (SERVER, "serve_command", "Serve the site, and accept submissions."),
    "build": (SERVER, "build_command", "Write the whole site as files, for any web host."),
    "frames": (SERVER, "frames_command", "Render the preview image of each data set."),
    "team": (TEAMS, "team", "Manage teams and their tokens."),
    "submissions": (TEAMS, "submissions", "Manage submissions."),
}
"""Name -> module, attribute and a line of help, so that the group's help needs no import."""


class Lazy(Group):
    """A group whose commands are imported when they are called."""

    def list_commands(self, context: click.Context) -> list[str]:
        return list(COMMANDS)

    def get_command(self, context: click.Context, name: str) -> click.Command | None:
        if name not in COMMANDS:
            return None
        module, attribute, _ = COMMANDS[name]
        return getattr(importlib.import_module(module), attribute, None)

    def format_commands(self, context: click.Context, formatter: click.HelpFormatter) -> None:
        with formatter.section("Commands"):
            formatter.write_dl([(name, line) for name, (_, _, line) in COMMANDS.items()])

    def invoke(self, context: click.Context) -> Any:
        try:
            return super().invoke(context)
        except ModuleNotFoundError as error:
            raise ResultError(
                f"leaderboard: {error}; install what it needs: pip install 'oysterbench[board]'"
            ) from None


@click.group(
    "leaderboard",
    cls=Lazy,
    short_help="Show published results: ranks, pages, submissions.",
    invoke_without_command=True,
    subcommand_metavar="[COMMAND [ARGS]...]",
)
@click.option("--track", help="Boards of this track, such as slam or steering.")
@click.option("--split", help="Boards of this split.")
@click.option("--id", "board", help="One board by its id (see --json), including boards of older evaluators.")
@click.option(
    "--rows", type=click.IntRange(min=1), help="Rows per board.  [default: 5, or all of a single board and in CSV]"
)
@click.option("--search", "words", default="", help="Only rows whose method or team name contains this.")
@click.option("--all", "every", is_flag=True, help="Include boards of older evaluators and former recipes.")
@click.option("--json", "as_json", is_flag=True, help="Print only JSON on stdout.")
@click.option(
    "--csv",
    "csv_file",
    type=click.Path(path_type=Path, allow_dash=True),
    help="Write a line per record, every digit; - for stdout.",
)
@click.option(
    "--tex", "tex_file", type=click.Path(path_type=Path, allow_dash=True), help=f"Write {TEXTS['tex']}; - for stdout."
)
@click.option(
    "--md", "md_file", type=click.Path(path_type=Path, allow_dash=True), help=f"Write {TEXTS['md']}; - for stdout."
)
@click.option(
    "--board",
    "folder",
    type=click.Path(path_type=Path, file_okay=False),
    envvar="OYSTERBENCH_BOARD",
    help="Folder of the records.  [default: OYSTERBENCH_BOARD, or the records shipped with oysterbench]",
)
@click.option("--index", "url", envvar="OYSTERBENCH_INDEX", help="File or postgresql+psycopg:// URL of the index.")
@click.pass_context
def command(context: click.Context, /, folder: Path | None, url: str | None, **asked: Any) -> None:
    """Show published results: which method leads, by how much, and whether that is significant.

    \b
    Examples:
      oysterbench leaderboard                                 all boards, with the top of each
      oysterbench leaderboard --track slam --split slam-val
      oysterbench leaderboard --split slam-val --tex table.tex --md -
      oysterbench leaderboard show 3f9c21ab
      oysterbench leaderboard history gtsam_vi
      oysterbench leaderboard add results/results.json --team "reef lab" --tier reported
      oysterbench leaderboard --board /srv/board rebuild
      oysterbench compare gtsam_vi gtsam_full --split slam-val

    A rank is 1 + the number of methods that are significantly better (95 %, paired bootstrap over sequences), and at
    least the rank of any placed above; of another team's submissions, only the best counts. "=" marks shared ranks.
    Places in brackets: too few sequences for a rank.
    """
    from oysterbench_leaderboard.commands.options import Place

    context.obj = Place(folder, url)
    if context.invoked_subcommand is None:
        from oysterbench_leaderboard.commands.terminal import show_boards

        show_boards(context.obj, **asked)
    elif given := [key for key, value in asked.items() if value]:
        raise click.UsageError(f"{', '.join(given)}: for the list of boards, not for {context.invoked_subcommand}")
