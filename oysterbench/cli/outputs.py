"""Options for the output formats of a command's results: JSON, CSV, LaTeX, Markdown, HTML."""

from __future__ import annotations

import functools
import os
import shlex
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from oysterbench.cli.echo import echo

if TYPE_CHECKING:
    from rich.console import Console

    from oysterbench.report import DatasetRow
    from oysterbench.report.cards import Card
    from oysterbench.report.html import Runs
    from oysterbench.report.table import Table
    from oysterbench.tracks.track import Kept

PIPE = 1000
"""Line width, in characters, where it is unknown."""

TEXTS = {"csv": "every run, every digit", "tex": "tables with booktabs and graphicx", "md": "tables in Markdown"}
"""Suffix of a text format -> its description in the help."""


@dataclass(frozen=True)
class Outputs:
    """The outputs requested: JSON on stdout; files of the other formats, "-" for stdout."""

    as_json: bool
    texts: dict[str, Path]
    report: Path | None

    @property
    def on_stdout(self) -> bool:
        """Whether one of them goes to stdout."""
        return self.as_json or Path("-") in self.texts.values()

    def write(
        self,
        runs: Runs,
        folder: Path | None = None,
        data_set: Sequence[DatasetRow] = (),
        first: Sequence[Table] = (),
        figures: Sequence[Card] = (),
        beside: Sequence[Kept] = (),
    ) -> list[Path]:
        """Write all requested files and, if there is a folder, all formats into it. Returns the files written.

        data_set: for image tracks, a row for each method over all clips together; first: tables that come before all
        others; figures: figures of the report; beside: earlier runs, which the files in the folder also include.
        """
        from oysterbench.core.atomic import write_atomically
        from oysterbench.core.text import as_unicode
        from oysterbench.report import csv_text, dataset_tables, latex_text, markdown_text, write_html_report

        makers = {"tex": latex_text, "md": markdown_text}
        every: Any = [*beside, *runs]
        places = [(form, path, runs) for form, path in self.texts.items()]
        reports = [(self.report, runs)] if self.report is not None else []
        if folder is not None:
            places += [(form, folder / f"results.{form}", every) for form in TEXTS]
            reports.append((folder / "report.html", every))
        for form, path, shown in places:
            records = [run.record for run in shown]
            tables = [*first, *dataset_tables(data_set)]
            text = csv_text(records) if form == "csv" else makers[form](records, tables)
            if path == Path("-"):
                echo(text, nl=False)
            else:
                write_atomically(path, as_unicode(text).encode())
        for path, shown in reports:
            command = shlex.join(["oysterbench", *sys.argv[1:]])
            write_html_report(path, shown, command, data_set=data_set, first=first, figures=figures)
        return [*(path for _, path, _ in places if path != Path("-")), *(path for path, _ in reports)]


def output_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """Give a command --json, --csv, --tex, --md and --report, and the argument `outputs`."""

    @functools.wraps(command)
    def wrapped(*, as_json: bool, report: Path | None, **values: Any) -> Any:
        texts = {form: path for form in TEXTS if (path := values.pop(f"{form}_file")) is not None}
        if as_json + list(texts.values()).count(Path("-")) > 1:
            raise click.UsageError("--json, --csv, --tex, --md: at most one of them can go to stdout")
        if report == Path("-"):
            raise click.UsageError("--report: expected a file for the HTML page, which does not go to stdout, got -")
        return command(outputs=Outputs(as_json, texts, report), **values)

    option = click.option(
        "--report", type=click.Path(path_type=Path, dir_okay=False), help="Write the HTML report to this file."
    )
    wrapped = option(wrapped)
    for form, what in reversed(TEXTS.items()):
        kind = click.Path(path_type=Path, dir_okay=False, allow_dash=True)
        wrapped = click.option(f"--{form}", f"{form}_file", type=kind, help=f"Write {what}; - for stdout.")(wrapped)
    option = click.option("--json", "as_json", is_flag=True, help="Print only JSON on stdout.")
    return option(wrapped)


def print_table(table: Table) -> None:
    """Print a table on stdout, fitted to the terminal's width."""
    from oysterbench.report import terminal_table

    console = _console()
    _print(console, terminal_table(table, width=console.width))


def print_rich(table: Any) -> None:
    """Print a rich table on stdout."""
    _print(_console(), table)


def _print(console: Console, table: Any) -> None:
    """Print without trailing blanks on stdout if it is not a terminal: a reader of a pipe does not want padding."""
    with console.capture() as captured:
        console.print(table)
    lines = captured.get().splitlines()
    echo("\n".join(lines if console.is_terminal else map(str.rstrip, lines)))


def _console() -> Console:
    """Console on stdout; for a pipe, lines are wrapped only if COLUMNS gives a width."""
    from rich.console import Console

    console = Console()
    return console if console.is_terminal or os.environ.get("COLUMNS", "").isdigit() else Console(width=PIPE)
