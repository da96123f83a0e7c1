"""Commands that change or check a board: add, withdraw, restore, rebuild, verify, rescore."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from oysterbench.cli.echo import echo, message
from oysterbench.core.errors import OysterbenchError, ResultError
from oysterbench_leaderboard.commands.options import DAMAGED, find_place
from oysterbench_leaderboard.commands.terminal import AS_JSON
from oysterbench_leaderboard.storage.record import TIERS

if TYPE_CHECKING:
    from oysterbench_leaderboard.boards.board import Row
    from oysterbench_leaderboard.boards.index import BoardIndex


@click.command("add", short_help="Put results on the board.")
@click.argument("results", type=click.Path(path_type=Path, exists=True))
@click.option("--team", required=True, help="Team that submits them.")
@click.option("--tier", type=click.Choice(TIERS), default="reported", show_default=True, help="Source of the results.")
@click.option("--url", default="", help="Address of the method's description.")
@click.option("--summary", default="", help="One sentence about the method.")
@click.option("--reason", default="", help="Why they replace earlier results.")
@click.option("--split", "recipe", metavar="FILE.toml", help="Recipe of a split that is not shipped with oysterbench.")
@click.option(
    "--keep-estimates",
    "estimates",
    type=click.Path(path_type=Path, file_okay=False),
    help="Copy the paths beside the results to this private folder, for `rescore`.",
)
@AS_JSON
@click.pass_context
def add_command(
    context: click.Context,
    results: Path,
    team: str,
    tier: Any,
    url: str,
    summary: str,
    reason: str,
    recipe: str | None,
    estimates: Path | None,
    as_json: bool,
) -> None:
    """Make records from RESULTS, the output of `oysterbench run` or `oysterbench eval`: one per method and split.

    \b
    Examples:
      oysterbench leaderboard add runs/results.json --tier baseline --team oysterbench
      oysterbench leaderboard --board board add runs --team "reef lab" \\
        --summary "Smooths a window of 4 s."

    Of results on a hidden split only what a board needs is published, rounded; for other splits, paths beside the
    results are drawn on the record's page. The current record of the same method, team and board is superseded, but
    kept; reported results never supersede scored ones or a baseline's. Identical results are stored once.
    """
    from oysterbench.results.records import dump
    from oysterbench_leaderboard.boards.index import (
        open_index,  # if what it needs is missing, nothing has been written yet
    )
    from oysterbench_leaderboard.publishing.publish import Attribution, keep_estimates, publish, records_of

    place = find_place(context)
    by = Attribution(team, tier, url, summary, reason)
    found = records_of(results, by, message, recipe)
    if estimates is not None:
        folder = results if results.is_dir() else results.parent
        found = [(keep_estimates(record, folder, estimates), curves) for record, curves in found]
    done = publish(place.store(must_exist=False), found)
    index = open_index(place.store(), place.url)
    rows = [index.row(digest) for _, digest, _ in done]
    if as_json:
        made = [
            {"record": digest, "new": new, **_standing(row)} for (_, digest, new), row in zip(done, rows, strict=True)
        ]
        echo(dump(made))
        return
    for (record, digest, new), row in zip(done, rows, strict=True):
        kept = "kept" if new else "already there"
        instead = f", in place of {record.supersedes[:8]}" if new and record.supersedes else ""
        echo(f"{digest[:8]}  {kept}: {record.method} on {record.split}, {_place_text(index, row)}{instead}")


def _standing(row: Row) -> dict[str, Any]:
    return {"method": row.method, "team": row.team, "place": row.place, "rank": row.rank, "score": row.score}


def _place_text(index: BoardIndex, row: Row) -> str:
    board = next(each for each in index.boards() if each.id == row.board)
    score = "no score" if row.score is None else f"{board.metric} {row.score:.3f}"
    if row.place is None:
        return f"{score}, {row.state}"
    rank = f"rank {row.rank}, " if row.rank is not None else ""
    return f"{score}, {rank}place {row.place} of {board.entries}"


def _announcing(action: Any, past: str) -> Any:
    """Make the function of a command that withdraws or restores a record."""

    @click.argument("digest")
    @click.option("--reason", required=True, help="One sentence, shown with the record.")
    @click.pass_context
    def announce(context: click.Context, digest: str, reason: str) -> None:
        from oysterbench_leaderboard.storage.record import MOST_TEXT, check_text

        check_text("reason", reason, MOST_TEXT["reason"])
        if not reason.strip():
            raise ResultError("expected a reason, got an empty one")
        place = find_place(context)
        index = place.index()
        row = index.row(digest)
        if (row.state == "withdrawn") == (action == "withdrawn"):
            raise ResultError(f"{row.digest[:8]} ({row.method} by {row.team}) is {row.state} already")
        index.store.change_status(row.digest, action, reason)
        index.refresh()
        echo(f"{row.digest[:8]}  {past}: {row.method} by {row.team}")

    return announce


withdraw_command = click.command(
    "withdraw",
    short_help="Take a record off the board, with a reason.",
    help="""Take a record off the board: it is no longer ranked, and its page says so. Nothing is deleted.

    \b
    Examples:
      oysterbench leaderboard withdraw 3f9c21ab --reason "The estimates were made from the truth."

    The record that it superseded comes back.
    """,
)(_announcing("withdrawn", "withdrawn"))

restore_command = click.command(
    "restore",
    short_help="Put a withdrawn record back, with a reason.",
    help="""Put a withdrawn record back.

    \b
    Examples:
      oysterbench leaderboard restore 3f9c21ab --reason "The complaint was a mistake."
    """,
)(_announcing("restored", "put back"))


@click.command("rebuild", short_help="Rebuild the index from the records.")
@AS_JSON
@click.pass_context
def rebuild_command(context: click.Context, as_json: bool) -> None:
    """Rebuild the index from the records. Readers see the old index until the new one is complete.

    \b
    Examples:
      oysterbench leaderboard rebuild
      oysterbench leaderboard --board /srv/board --index postgresql+psycopg://board@db/board rebuild
    """
    from oysterbench.results.records import dump
    from oysterbench_leaderboard.boards.index import BoardIndex, default_url

    place = find_place(context)
    store = place.store()
    index = BoardIndex(place.url or default_url(store), store)
    index.rebuild(_progress() if sys.stderr.isatty() else None)
    boards, problems = index.boards(), index.problems()
    entries = sum(board.entries for board in boards)
    if as_json:
        facts = {"boards": len(boards), "entries": entries, "records": len(store.digests()), "left_out": problems}
        echo(dump({"index": index.name, "revision": index.revision, **facts}))
        return
    for file, why in problems.items():
        message(f"left out: {file[:12]}: {why}")
    echo(f"records: {len(store.digests())}, current ones: {entries}, boards: {len(boards)}, index: {index.name}")


def _progress() -> Any:
    def show(done: int, of: int) -> None:
        click.echo(f"\rreading records: {done} of {of}", err=True, nl=done == of)  # noqa: TID251

    return show


@click.command("verify", short_help="Check every record, status change and curve.")
@AS_JSON
@click.pass_context
def verify_command(context: click.Context, as_json: bool) -> None:
    """Check every file: that its bytes match its name, that this version knows everything in it, that its numbers are
    possible, and that its parts do not contradict each other or the files that it names.

    \b
    Examples:
      oysterbench leaderboard verify
      oysterbench leaderboard --board /srv/board verify --json

    A board itself checks less, as it must be built quickly. Exits with 3 if a file is damaged or impossible.
    """
    from oysterbench.results.records import dump
    from oysterbench_leaderboard.publishing.verifying import verify

    found = verify(find_place(context).store())
    if as_json:
        echo(dump({"checked": found.checked, "problems": found.problems}))
    else:
        for file, why in found.problems.items():
            echo(f"{file}: {why}")
        counts = ", ".join(f"{kind}: {count}" for kind, count in found.checked.items())
        echo(f"{counts}; {f'{len(found.problems)} damaged' if found.problems else 'all intact'}")
    if found.problems:
        sys.exit(DAMAGED)


@click.command("rescore", short_help="Score kept estimates with this version's evaluator.")
@click.argument("digests", nargs=-1)
@click.option(
    "--estimates",
    required=True,
    type=click.Path(path_type=Path, exists=True, file_okay=False),
    help="Private folder of the estimates, named by their SHA-256.",
)
@click.option(
    "--truth",
    type=click.Path(path_type=Path, exists=True, file_okay=False),
    help="Folder with the sequences of a hidden split.  [default: where public splits are rendered]",
)
@click.option(
    "--submissions",
    "server",
    envvar="OYSTERBENCH_SUBMISSIONS",
    type=click.Path(path_type=Path, exists=True, file_okay=False),
    help="Private folder of the server, closed to what reads uploads.  [default: that above --estimates]",
)
@click.option("--split", help="Only records of this split, by name or .toml recipe; required with --truth.")
@click.option("--reason", default="", help="Why.  [default: the evaluator's version]")
@click.option("--again", is_flag=True, help="Also rescore what this version has scored.")
@click.option("--dry-run", is_flag=True, help="Score and show what would change; write nothing.")
@AS_JSON
@click.pass_context
def rescore_command(
    context: click.Context,
    digests: tuple[str, ...],
    estimates: Path,
    truth: Path | None,
    server: Path | None,
    split: str | None,
    reason: str,
    again: bool,
    dry_run: bool,
    as_json: bool,
) -> None:
    """Score kept estimates with this version's evaluator, and show what changed. New records are appended and supersede
    the old ones; no record is changed.

    \b
    Examples:
      oysterbench leaderboard rescore --estimates /srv/private/estimates --dry-run
      oysterbench leaderboard rescore --estimates /srv/private/estimates --split slam-test \\
        --truth /srv/truth/slam-test
      oysterbench leaderboard rescore 3f9c21ab --estimates estimates --again \\
        --reason "A truth file was damaged."
    """
    from dataclasses import replace

    from oysterbench.results.records import dump
    from oysterbench_leaderboard.boards.withdrawn import withdrawn_successors, withdrawn_with
    from oysterbench_leaderboard.publishing.rescoring import is_outdated, score_again
    from oysterbench_leaderboard.submissions.catalogue import SCORED
    from oysterbench_leaderboard.submissions.scoring import evaluator
    from oysterbench_leaderboard.submissions.settings import is_server

    if truth is not None and split is None:
        raise click.UsageError("--truth: expected --split with it: the truth is of one split")
    recipe = None
    if split is not None and split.endswith(".toml"):
        from oysterbench.recipe import load_split

        recipe, split = split, load_split(split).name
    if server is not None and not is_server(server):
        raise ResultError(f"--submissions {server}: expected the private folder of a server, got one of something else")
    index = find_place(context).index()
    wanted = [index.row(digest) for digest in digests] or [
        row for board in index.boards() for row in _current(index, board.id) if split in (None, board.split)
    ]
    if server is None and any(row.tier == "scored" for row in wanted) and not is_server(estimates.absolute().parent):
        message(f"{estimates} is in no server's folder: uploads are read within the default limits; see --submissions")
    splits = {board.id: board.split for board in index.boards()}
    if other := next((row for row in wanted if split not in (None, splits.get(row.board))), None):
        raise ResultError(f"{other.digest[:8]} is of the split {splits.get(other.board)}, not of {split}")
    changes, skipped, damaged = [], False, False
    withdrawn = withdrawn_successors(index)
    for before in wanted:
        try:
            record = index.store.record(before.digest)
            if not again and not is_outdated(record) and not (digests and record.track not in SCORED):
                continue
            why_not = withdrawn_with(before, record.estimates, withdrawn, index.store)
        except OysterbenchError as error:
            message(f"{before.digest[:8]} ({before.method} by {before.team}) was not rescored: {error}")
            damaged = True
            continue
        if why_not:
            message(f"{before.digest[:8]} ({before.method} by {before.team}) was not rescored: {why_not}")
            skipped = True
            continue
        message(f"scoring {record.method} by {record.team} on {record.split}")
        why = reason or f"Rescored by {evaluator(record.track)[0]}, earlier by {record.evaluator_version}."
        done = score_again(record, estimates, truth, why, recipe, server)
        if done.record is None:
            message(f"{before.digest[:8]} ({record.method} on {record.split}) was not rescored: {done.why}")
            skipped = True
            continue
        made = done.record
        if not dry_run and done.curves is not None:
            made = replace(made, curves=index.store.add_curves(done.curves))
        if not dry_run:
            index.store.add(made)
        changes.append((before, made))
    if not dry_run:
        index.refresh()
    shown = [_change(index, before, made, dry_run) for before, made in changes]
    if as_json:
        echo(dump(shown))
    for line in [] if as_json else shown:
        rank = _rank(line["before"])
        echo(
            f"{line['before']['record'][:8]} -> {line['after']['record'][:8]}  {line['method']} on {line['split']}: "
            f"score {_number(line['before']['score'])} -> {_number(line['after']['score'])}, "
            + (f"now rank {rank}" if dry_run else f"rank {rank} -> {_rank(line['after'])}")
        )
    if shown and dry_run and not as_json:
        message("nothing was written: ranks are known once the same command without --dry-run has stored the records")
    if not (shown or skipped or damaged or as_json):
        echo("nothing was rescored: all current records that can be use this version's evaluator")
    if damaged:
        sys.exit(DAMAGED)


def _current(index: BoardIndex, board: str) -> list[Row]:
    from oysterbench_leaderboard.boards.board import Query

    return list(index.page(board, Query(size=1_000_000)).rows)


def _change(index: BoardIndex, before: Row, made: Any, dry_run: bool) -> dict[str, Any]:
    """Score and rank before and after; a dry run stores nothing, and so has no rank after."""
    from oysterbench.results.records import aggregate
    from oysterbench.results.standings import PRIMARY

    if dry_run:
        score = aggregate(made.results)[0]["metrics"].get(PRIMARY[made.track])
        after: dict[str, Any] = {"record": made.digest, "score": score, "place": None, "rank": None}
    else:
        row = index.row(made.digest)
        after = {"record": row.digest, "score": row.score, "place": row.place, "rank": row.rank}
    return {
        "method": made.method,
        "team": made.team,
        "split": made.split,
        "before": {"record": before.digest, "score": before.score, "place": before.place, "rank": before.rank},
        "after": after,
    }


def _number(value: float | None) -> str:
    return "none" if value is None else f"{value:.3f}"


def _rank(of: dict[str, Any]) -> str:
    if of["rank"] is not None:
        return str(of["rank"])
    return f"({of['place']})" if of["place"] is not None else "none"
