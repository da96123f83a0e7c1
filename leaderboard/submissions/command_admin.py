"""`oysterbench leaderboard team` and `submissions`: for the operators of a server that takes submissions."""

from __future__ import annotations

import json
import sys
from dataclasses import asdict
from pathlib import Path
from typing import Any, Literal

import click

from oysterbench.cli.echo import echo, message
from oysterbench.core.errors import ResultError
from oysterbench.core.names import counted
from oysterbench_leaderboard.commands.options import DAMAGED, find_place

FOLDER = click.option(
    "--submissions",
    "folder",
    required=True,
    envvar="OYSTERBENCH_SUBMISSIONS",
    type=click.Path(path_type=Path, file_okay=False),
    help="Private folder of the server.",
)
AS_JSON = click.option("--json", "as_json", is_flag=True, help="Print as JSON.")

STATES = ("queued", "running", "done", "failed", "withdrawn")
"""`database.State`, which takes a database library to import."""


@click.group("team", short_help="Manage teams and their tokens.")
def team() -> None:
    """Create, list and revoke the tokens of teams.

    \b
    Examples:
      oysterbench leaderboard team add "reef lab" --submissions /srv/oysters
      oysterbench leaderboard team list --submissions /srv/oysters
      oysterbench leaderboard team revoke 3f9c21ab77e0 --submissions /srv/oysters
    """


@team.command("add", short_help="Create a token for a team; it is shown only once.")
@click.argument("name")
@FOLDER
@click.option("--replace", is_flag=True, help="Revoke the tokens that the team has.")
@click.option("--another", is_flag=True, help="Keep the tokens that the team has, and add one.")
@click.option(
    "--token-file",
    "file",
    type=click.Path(path_type=Path, dir_okay=False),
    help="New file for the token, readable by its owner only, instead of printing it.",
)
@AS_JSON
def add(name: str, folder: Path, replace: bool, another: bool, file: Path | None, as_json: bool) -> None:
    """Print a new token for a team; a new team is created. Only its hash is stored, so the token is shown only once.

    \b
    Examples:
      oysterbench leaderboard team add "reef lab" --submissions /srv/oysters
      oysterbench leaderboard team add "reef lab" --submissions /srv/oysters --token-file token
      oysterbench leaderboard team add "reef lab" --submissions /srv/oysters --replace

    --replace is for a token that was lost, or that others have seen.
    """
    from oysterbench.core.atomic import appearing
    from oysterbench_leaderboard.submissions.accounts.tokens import issue

    if replace and another:
        raise click.UsageError("--replace and --another: expected one of them")
    if file is not None and file.exists():
        raise ResultError(f"--token-file {file}: already exists and was left unchanged; name another file")
    held: Literal["refuse", "revoke", "keep"] = "revoke" if replace else "keep" if another else "refuse"
    use = f"--team-token-file {file or 'FILE'}"
    if file is not None:
        with appearing(file, mode=0o600) as private:  # open the file first, so that no token is issued and then lost
            private.write(f"{issue(_database(folder), name, held)}\n".encode())
        echo(json.dumps({"team": name, "file": str(file)}) if as_json else file)
    else:
        token = issue(_database(folder), name, held)
        echo(json.dumps({"team": name, "token": token}) if as_json else token)
    message(f"this token is not shown again; pass it to `submit` with {use} (chmod 600) or OYSTERBENCH_TOKEN")


@team.command("list", short_help="List all teams and tokens.")
@FOLDER
@AS_JSON
def list_teams(folder: Path, as_json: bool) -> None:
    """List the tokens of all teams, without their secrets."""
    from oysterbench_leaderboard.submissions.accounts.tokens import listed

    rows = listed(_database(folder, must_exist=True))
    if as_json:
        echo(json.dumps(rows, indent=2))
    for row in () if as_json else rows:
        echo(f"{row['id']}  {row['created']}  {'revoked ' + row['revoked'] if row['revoked'] else ''}  {row['team']}")


@team.command("revoke", short_help="Revoke a token, or all tokens of a team.")
@click.argument("name")
@FOLDER
@AS_JSON
def revoke_token(name: str, folder: Path, as_json: bool) -> None:
    """Revoke a token by its id (`team list`), or all tokens of a team."""
    from oysterbench_leaderboard.submissions.accounts.tokens import revoke

    gone = revoke(_database(folder, must_exist=True), name)
    echo(
        json.dumps({"revoked": gone})
        if as_json
        else f"revoked: {', '.join(gone) or 'none that were not revoked before'}"
    )


@click.group("submissions", short_help="Manage submissions.")
def submissions() -> None:
    """List submissions, read the log, retry failed submissions.

    \b
    Examples:
      oysterbench leaderboard submissions list --submissions /srv/oysters --state failed
      oysterbench leaderboard submissions log --submissions /srv/oysters
      oysterbench leaderboard submissions retry 1a2b3c4d5e6f7081 --submissions /srv/oysters
      oysterbench leaderboard --board /srv/board submissions backup oysters.tar \\
        --submissions /srv/oysters
    """


@submissions.command("list", short_help="List the newest submissions.")
@FOLDER
@click.option("--team", "of", help="Only of this team.")
@click.option("--state", type=click.Choice(STATES), help="Only in this state.")
@click.option(
    "--limit", type=click.IntRange(min=1), default=50, show_default=True, help="Maximum number of submissions."
)
@AS_JSON
def list_submissions(folder: Path, of: str | None, state: str | None, limit: int, as_json: bool) -> None:
    """List submissions, newest first."""
    from oysterbench_leaderboard.submissions import database

    c = database.submissions.c
    wanted = [column == value for column, value in ((c.team, of), (c.state, state)) if value]
    with _database(folder, must_exist=True).reading() as connection:
        found = database.find(connection, *wanted, limit=limit)
    if as_json:
        echo(json.dumps([asdict(one) for one in found], indent=2))
        return
    for one in found:
        why = f": {one.reason}" if one.reason else ""
        shown = ", published" if one.published and one.state == "done" else ""
        echo(f"{one.id}  {one.created}  {one.team}  {one.method} on {one.split} ({one.track})  {one.state}{shown}{why}")


@submissions.command("log", short_help="Show the log of events, including refusals.")
@FOLDER
@click.argument("id", required=False, default="")
@click.option(
    "--limit",
    type=click.IntRange(min=1),
    default=200,
    show_default=True,
    help="Only the newest N entries.",
)
@AS_JSON
def show_log(folder: Path, id: str, limit: int, as_json: bool) -> None:
    """Print the log, or that of one submission if its ID is given. Entries are never removed."""
    from oysterbench_leaderboard.submissions import database

    with _database(folder, must_exist=True).reading() as connection:
        rows = database.log(connection, id, limit)
        if id and not rows:
            raise ResultError(f"{id}: no submission has that id; `submissions list` lists them")
    if as_json:
        echo(json.dumps(rows, indent=2))
    for row in () if as_json else rows:
        echo(f"{row['at']}  {row['who']}  {row['what']}  {row['submission']}  {row['why']}".rstrip())


@submissions.command("retry", short_help="Score a failed submission again.")
@click.argument("id")
@FOLDER
@AS_JSON
def retry(id: str, folder: Path, as_json: bool) -> None:
    """Put a failed submission back into the queue; a running server scores it."""
    import time

    from oysterbench_leaderboard.submissions import database

    at = database.utc(time.time())
    with _database(folder, must_exist=True).writing() as connection:
        c = database.submissions.c
        values: dict[str, Any] = {"state": "queued", "reason": "", "attempt": 0}
        if not database.change(connection, id, at, c.state == "failed", **values):
            raise ResultError(
                f"{id}: no submission of that id has failed; `submissions list --state failed` lists them"
            )
        database.log_event(connection, at, "operator", "queued", id, "tried again")
    echo(json.dumps({"id": id, "state": "queued"}) if as_json else f"{id}: queued")


@submissions.command("backup", short_help="Back up a server into one file, while it runs.")
@click.argument("file", type=click.Path(path_type=Path, dir_okay=False))
@FOLDER
@AS_JSON
@click.pass_context
def backup_command(context: click.Context, file: Path, folder: Path, as_json: bool) -> None:
    """Write database, estimates and records into a file that only its owner can read; the server may keep running. With
    `leaderboard --board DIR` or OYSTERBENCH_BOARD, the board's records are included. Damaged files are named and left
    out, as are estimates that are gone, with exit code 3.

    \b
    Examples:
      oysterbench leaderboard --board /srv/board submissions backup /backup/monday.tar \\
        --submissions /srv/oysters
    """
    from oysterbench_leaderboard.submissions.backup import backup
    from oysterbench_leaderboard.submissions.settings import load_settings

    _check_server(folder)
    board = find_place(context).folder
    made = backup(load_settings(folder), file, board)
    _show_backup(file, made, as_json, board is not None)
    for path, wrong in made.damaged.items():
        message(f"{path} is damaged, and not in the backup: {wrong}; restore it from an older one")
    if made.damaged:
        sys.exit(DAMAGED)


@submissions.command("restore", short_help="Restore a server from a backup, into an empty folder.")
@click.argument("file", type=click.Path(path_type=Path, dir_okay=False))
@FOLDER
@AS_JSON
@click.pass_context
def restore_command(context: click.Context, file: Path, folder: Path, as_json: bool) -> None:
    """Restore the private folder and its database from a backup and, with `leaderboard --board DIR` or
    OYSTERBENCH_BOARD, also the board's folder. Both must be empty, except for a settings.toml, which is used and may
    name another database. Submissions that were being scored are scored again.

    \b
    Examples:
      oysterbench leaderboard --board /srv/board submissions restore /backup/monday.tar \\
        --submissions /srv/oysters
    """
    from oysterbench_leaderboard.submissions.backup import restore

    board = find_place(context).folder
    _show_backup(file, restore(file, folder, board), as_json, board is not None)


def _show_backup(file: Path, made: Any, as_json: bool, board: bool) -> None:
    rows = ", ".join(counted(count, name.removesuffix("s")) for name, count in made.rows.items())
    records = f", with {counted(made.records, 'record')} of the board" if board else ""
    echo(json.dumps(asdict(made)) if as_json else f"{file}: {rows}; {counted(made.files, 'file')}{records}")


def _database(folder: Path, must_exist: bool = False) -> Any:
    from oysterbench_leaderboard.submissions.database import SubmissionDatabase
    from oysterbench_leaderboard.submissions.settings import load_settings

    if must_exist:
        _check_server(folder)
    return SubmissionDatabase(load_settings(folder))


def _check_server(folder: Path) -> None:
    """Raise ResultError where a folder is no server's, or has no database yet: to open it would make one."""
    from oysterbench_leaderboard.submissions.settings import has_database

    if not folder.is_dir():
        raise ResultError(f"--submissions {folder}: no such folder; `oysterbench leaderboard team add` makes it")
    if not has_database(folder):
        raise ResultError(
            f"--submissions {folder}: expected the private folder of a server, got one without submissions.sqlite, or "
            "a settings.toml that names a database; `oysterbench leaderboard team add` makes one in an empty folder"
        )
