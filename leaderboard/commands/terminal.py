"""The commands that show boards, records and histories: parse, call, print."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from oysterbench.cli.echo import echo, message
from oysterbench.cli.outputs import print_table
from oysterbench.core.errors import ResultError
from oysterbench.core.names import did_you_mean, listed, nearest
from oysterbench_leaderboard.commands.options import Place, find_place

if TYPE_CHECKING:
    from oysterbench_leaderboard.boards.board import BoardInfo, BoardPage, BoardReader

TOP = 5
"""Maximum number of rows of each board, where there are several."""

MOST = 100_000
"""Maximum number of rows of a single board, and of each in CSV."""


def show_boards(
    place: Place,
    track: str | None,
    split: str | None,
    board: str | None,
    rows: int | None,
    words: str,
    every: bool,
    as_json: bool,
    csv_file: Path | None,
    tex_file: Path | None,
    md_file: Path | None,
) -> None:
    """Print boards, or write them to files: what `oysterbench leaderboard` does without a command."""
    from oysterbench.report.renderers import latex_tables, markdown_table
    from oysterbench.results.records import dump
    from oysterbench_leaderboard.boards.board import Query
    from oysterbench_leaderboard.boards.tables import board_name, board_table, boards_csv, page_plain

    files = {"csv": csv_file, "tex": tex_file, "md": md_file}
    if as_json + list(files.values()).count(Path("-")) > 1:
        raise click.UsageError("--json, --csv, --tex, --md: at most one of them can go to stdout")
    index = place.reader()
    chosen = _chosen(index, track, split, board, every)

    def pages_of(size: int) -> list[BoardPage]:
        return [index.page(each.id, Query(text=words, size=rows or size)) for each in chosen]

    pages = pages_of(MOST if len(chosen) == 1 else TOP)
    tables = [board_table(page) for page in pages]
    makers = {
        "csv": lambda: boards_csv(pages_of(MOST)),
        "tex": lambda: latex_tables(tables),
        "md": lambda: "\n".join(map(markdown_table, tables)),
    }
    for form, path in files.items():
        if path is not None:
            _write(path, makers[form]())
    if as_json:
        echo(dump({"revision": index.revision, "boards": [page_plain(page) for page in pages]}))
    elif Path("-") not in files.values():
        if not tables:
            message(f"no board is in {place.path} yet; `oysterbench leaderboard add` puts results on one")
        for page, table in zip(pages, tables, strict=True):
            if page.rows:
                print_table(table)
            else:
                found = f"no row with {words!r}" if words else "no current record: those that it had are withdrawn"
                message(f"{board_name(page.board)}: {found}")
        if board is None and (history := len(_chosen(index, track, split, None, True)) - len(chosen)):
            boards = "one board is" if history == 1 else f"{history} boards are"
            message(f"{boards} of an older evaluator or a former recipe, and left out: --all shows all")
    for file, why in index.problems().items():
        message(f"left out: {file[:12]}: {why}")


def _chosen(
    index: BoardReader, track: str | None, split: str | None, board: str | None, every: bool
) -> list[BoardInfo]:
    known = index.boards()
    found = [
        each
        for each in known
        if (track is None or each.track == track)
        and (split is None or each.split == split)
        and (board is None or each.id == board)
        and (every or board is not None or each.newest)
    ]
    if not found and (track or split or board):
        there = ", ".join(dict.fromkeys(f"{each.track} on {each.split}" for each in known)) or "none yet"
        meant = did_you_mean(
            [*_meant(track, {each.track for each in known}), *_meant(split, {each.split for each in known})]
        )
        asked = " on ".join(filter(None, (track, split))) or board
        if any(track in (None, each.track) and split in (None, each.split) for each in known) and board is None:
            raise ResultError(f"no board {asked} of today's evaluator and recipe; --all shows those of former ones")
        if board is not None:
            ids = listed(f"{each.id} ({each.track} on {each.split})" for each in known)
            raise ResultError(f"no board {asked}; `oysterbench leaderboard --all --json` has the ids: {ids}")
        raise ResultError(f"no board {asked}; {meant}there are: {there}")
    return found


def _meant(name: str | None, known: set[str]) -> list[str]:
    """Known names that an unknown one may have been meant to be."""
    return [] if name is None or name in known else nearest(name, sorted(known))


def _write(path: Path, text: str) -> None:
    from oysterbench.core.atomic import write_atomically

    if path == Path("-"):
        echo(text, nl=False)
    else:
        write_atomically(path, text.encode())
        message(f"written: {path}")


AS_JSON = click.option("--json", "as_json", is_flag=True, help="Print only JSON on stdout.")


@click.command("show", short_help="Show a record: its place, and its numbers by sequence.")
@click.argument("digest")
@AS_JSON
@click.pass_context
def show_command(context: click.Context, digest: str, as_json: bool) -> None:
    """Show a record: its author, its place, and its numbers by sequence.

    \b
    Examples:
      oysterbench leaderboard show 3f9c21ab
      oysterbench leaderboard show 3f9c21ab --json      the whole record

    DIGEST is the record's name, or at least its first 8 digits.
    """
    index = find_place(context).reader()
    row = index.row(digest)

    from oysterbench.evaluate.metrics import TRACKS  # imported only once the record was found
    from oysterbench.results.records import dump
    from oysterbench_leaderboard.boards.tables import record_table

    record = index.store.record(row.digest)
    if as_json:
        echo(dump({"row": asdict(row), "record": record.to_dict()}))
        return
    board = next(each for each in index.boards() if each.id == row.board)
    for name, value in _facts(row, record, board):
        if value:
            echo(f"{name:<12}{value}")
    reasons = [n for n in index.store.read_status_changes()[0] if n.record == row.digest]
    for change in reasons:
        echo(f"{change.action:<12}{change.created[:10]}: {change.reason}")
    means = index.sequence_means(row.digest)
    print_table(record_table(row, means, TRACKS[board.track].table))
    for result in record.results:
        if result.failure is not None:
            echo(f"{result.sequence}, run {result.run + 1} failed: {result.failure}")


def _facts(row: Any, record: Any, board: BoardInfo) -> list[tuple[str, str]]:
    from oysterbench.report.columns import metric_column
    from oysterbench_leaderboard.boards.tables import board_name, interval_of

    column = metric_column(board.metric)
    score = f"{column.text(row.score)} ({column.heading}), 95 % interval {column.text(interval_of(row))}"
    place = "" if row.place is None else f"rank {row.rank}, " if row.rank is not None else ""
    return [
        ("method", row.method),
        ("team", row.team),
        ("record", row.digest),
        ("board", f"{board_name(board)}, {board.id}"),
        ("state", row.state),
        ("standing", "" if row.place is None else f"{place}place {row.place} of {board.entries}"),
        ("score", score),
        ("runs", f"{row.runs}, sequences: {row.sequences}, failed or lacking: {row.failures}"),
        ("tier", row.tier),
        ("created", row.created),
        ("summary", row.summary),
        ("url", row.url),
        ("in place of", row.supersedes),
        ("because", record.reason),
        ("manifest", record.manifest),
    ]


@click.command("history", short_help="Show all records of a method, newest first.")
@click.argument("method")
@click.option("--team", help="Only of this team.")
@AS_JSON
@click.pass_context
def history_command(context: click.Context, method: str, team: str | None, as_json: bool) -> None:
    """Show all records of a method, including superseded and withdrawn ones.

    \b
    Examples:
      oysterbench leaderboard history gtsam_vi
      oysterbench leaderboard history gtsam_vi --team "reef lab" --json
    """
    from oysterbench.results.records import dump
    from oysterbench_leaderboard.boards.tables import history_table

    index = find_place(context).reader()
    rows = index.method(method, team)
    if not rows:
        known = dict.fromkeys(name for name, _, _ in index.methods())
        meant = did_you_mean(nearest(method, known))
        raise ResultError(
            f"no record of {method!r:.80}{f' by {team}' if team else ''}; {meant}the methods are: {listed(known)}"
        )
    if as_json:
        echo(dump([asdict(row) for row in rows]))
        return
    print_table(history_table(rows, {board.id: board for board in index.boards()}))


@click.command("literature", short_help="Show results reported by others on other data.")
@click.option("--track", help="Only of this track.")
@AS_JSON
def literature_command(track: str | None, as_json: bool) -> None:
    """Show results reported by others on other data, each with its source. They are never ranked with ours.

    \b
    Examples:
      oysterbench leaderboard literature
      oysterbench leaderboard literature --track slam --json
    """
    from oysterbench.results.records import dump
    from oysterbench_leaderboard.boards.literature import REPORTED, literature
    from oysterbench_leaderboard.boards.tables import literature_tables

    rows = literature(track)
    if not rows:
        raise ResultError(f"nothing is listed for track {track!r:.40}")
    if as_json:
        echo(dump({"note": REPORTED, "rows": [asdict(row) for row in rows]}))
        return
    echo(REPORTED)
    for table in literature_tables(rows):
        print_table(table)
