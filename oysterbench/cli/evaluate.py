"""Code shared by `eval` and `run`: track options, requests, and what is written and printed at the end."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from oysterbench.cli.echo import echo, message
from oysterbench.cli.outputs import Outputs, print_table
from oysterbench.core.errors import OptionError, OysterbenchError, ResultError

if TYPE_CHECKING:
    from oysterbench.results.records import ResultRecord
    from oysterbench.tracks import Evaluation, Option, Request, Track

FOLDER = click.Path(path_type=Path, file_okay=False)


class Made(click.ParamType):  # type: ignore[type-arg]
    """Option type converted by a function; its ValueError becomes a usage error."""

    def __init__(self, make: Callable[[str], Any], name: str) -> None:
        self.make, self.name = make, name

    def convert(self, value: Any, param: click.Parameter | None, context: click.Context | None) -> Any:
        """Convert the text."""
        try:
            return self.make(value) if isinstance(value, str) else value
        except ValueError as error:
            self.fail(str(error), param, context)


def click_option(option: Option) -> click.Option:
    """Make the click option of a track option."""
    kind = option.kind
    if isinstance(kind, tuple):
        kind = click.Choice(kind)
    elif kind is Path:
        kind = click.Path(path_type=Path)
    elif kind is bool:
        return click.Option([option.name, argument(option)], is_flag=True, default=None, help=option.help)
    elif not isinstance(kind, type):
        kind = Made(kind, option.metavar or "TEXT")
    return click.Option(
        [option.name, argument(option)], type=kind, multiple=option.multiple, help=option.help, metavar=option.metavar
    )


def argument(option: Option) -> str:
    """Argument name of a track option in a command, with a prefix as general options may have the same name."""
    return f"of_track_{option.key.replace('-', '_').lower()}"


def given_options(options: Iterable[Option], values: dict[str, Any]) -> dict[str, Any]:
    """Remove track options from a command's arguments. Returns those that were given, key -> value."""
    found = {option.key: values.pop(argument(option), None) for option in options}
    return {key: value for key, value in found.items() if value not in (None, ())}


def check_settings(track: Track, options: dict[str, Any]) -> None:
    """Refuse options that the evaluator's settings do not allow, by their names. Raises OptionError."""
    try:
        track.settings(options)
    except OysterbenchError as error:
        text = str(error)
        for option in track.options:
            text = text.replace(f"evaluator setting {option.key!r}", option.name)
        raise OptionError(text) from None


def evaluate(track: Track, request: Request, outputs: Outputs) -> None:
    """Evaluate a request, showing progress, and finish with its outputs."""
    from dataclasses import replace

    from oysterbench.cli.progress import runs_shown
    from oysterbench.cli.render import frames_bar, render_files
    from oysterbench.core.places import home
    from oysterbench.results.records import add_results

    results = request.out / "results.json"
    before = _results_in(request.out)

    def keep(runs: Sequence[Any]) -> None:
        # After each run, so that finished runs are saved even if the process is killed.
        add_results(results, [run.record for run in runs])

    shown = replace(
        request, exports=home() / "exports", render=render_files, bar=frames_bar, announce=message, finished=keep
    )
    with nullcontext() if outputs.on_stdout else runs_shown() as show:
        found = track.evaluate(replace(shown, on_output=show))
    finish(found, request.out, outputs, before)


def _results_in(out: Path) -> list[ResultRecord]:
    """Results in a folder. Refuses unreadable ones, to which none could be added, before anything is run or written."""
    from oysterbench.results.records import read_results

    if not (out / "results.json").exists():
        return []
    try:
        return read_results(out / "results.json")
    except ResultError as error:
        raise ResultError(f"{error}; it was left unchanged: move it away, or choose another --out") from None


def finish(found: Evaluation, out: Path | None, outputs: Outputs, before: Sequence[ResultRecord] | None = None) -> None:
    """Write all files, print tables, and report failures; exits with an error if anything failed.

    before: results in the folder before the evaluation, which has added its own; None if it has added none
    """
    from oysterbench.core.atomic import write_atomically
    from oysterbench.core.text import as_unicode
    from oysterbench.results.records import add_results, document, dump, output_place, replaced
    from oysterbench.tracks.track import Kept

    records, data_set = found.records, [row.as_plain() for row in found.data_set]
    written: list[Path] = []
    kept: list[ResultRecord] = []
    if out is not None:
        there = _results_in(out)
        for what in replaced(there if before is None else before, records):
            message(f"{out}: replaced {what}: another --out keeps both")
        kept = add_results(out / "results.json", records, data_set)
        for name, text in found.files.items():
            write_atomically(out / name, as_unicode(text).encode())
        written = [out / "results.json", *(out / name for name in found.files), *(path for path, _ in found.figures)]
    if records:
        figures = [figure for _, figure in found.figures]
        beside = [Kept(one) for one in kept if one.track == records[0].track]
        written += outputs.write(found.runs, out, found.data_set, found.first, figures, beside)
    if outputs.as_json:
        echo(dump(document(records, data_set)))
    failures = [one for one in records if one.failure is not None]
    elsewhere = tuple(f" failed: {one.failure}" for one in failures)  # reported at the end, with where the output is
    for table in () if outputs.on_stdout else found.printed:
        if table.rows:
            notes = tuple(note for note in table.notes if not note.endswith(elsewhere))
            print_table(replace(table, notes=notes))
    for each in found.unscored:
        if each.failure is not None:
            message(f"{each.failure}{_again(each.outcome.earlier)}")
        elif out is not None:
            place = each.job.folder(out)
            message(f"{each.job.sequence.name} has no ground truth to score against; the predictions: {place}")
            for note in each.outcome.notes:
                message(f"{each.job.adapter.name} on {each.job.sequence.name}: {note}")
    if kept:
        methods = ", ".join(dict.fromkeys(one.method for one in kept))
        runs = "1 earlier run" if len(kept) == 1 else f"{len(kept)} earlier runs"
        message(
            f"{out}: results of {runs} are kept beside these, without figures: {methods}; `oysterbench compare {out}` "
            "shows them together"
        )
    for path in written:
        message(f"written: {path}")
    for one in failures:
        kept_at = None if out is None else out / output_place(one)
        logs = f"; full output: {kept_at}" if kept_at is not None and kept_at.is_dir() else ""
        message(f"{one.method} failed on {one.sequence}: {one.failure}{logs}{_again(one in found.earlier)}")
    if failures or any(each.failure is not None for each in found.unscored):
        sys.exit(OysterbenchError.exit_code)


def _again(earlier: bool) -> str:
    """What to add to a failure that an earlier command had."""
    return "; this is the result of an earlier run: --retry repeats it" if earlier else ""


def foreign_options(track: str, options: Mapping[str, Sequence[str]]) -> None:
    """Refuse options of other tracks. options: option as typed -> tracks that have it."""
    for name, of in options.items():
        if of:
            kind = "track" if len(of) == 1 else "tracks"
            raise click.UsageError(f"{name}: of the {kind} {' and '.join(of)}, not of {track}")
