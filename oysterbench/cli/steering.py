"""What `oysterbench eval --track steering` does: policies over labelled pictures, or pilots in a closed loop."""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from oysterbench.cli.outputs import Outputs, end, print_rich
from oysterbench.core.errors import MethodError, RecipeError

if TYPE_CHECKING:
    from oysterbench.exploration.labelled_views import LabelledViews
    from oysterbench.recipe import SplitRecipe
    from oysterbench.report.cards import Card
    from oysterbench.report.steering import DiveRun, PictureRun
    from oysterbench.report.table import Table

TRACK = "steering"
DEFAULT_SPLIT = "steer-mini"
DEFAULT_METHODS = ("straight", "chance")

OPTIONS: dict[str, tuple[str, dict[str, Any]]] = {
    "closed_loop": (
        "--closed-loop",
        {"is_flag": True, "help": "Steering: let the methods dive, beside the references."},
    ),
    "reefs": ("--reefs", {"type": click.IntRange(min=1), "help": "Closed loop: the first so many.  [default: all]"}),
    "seconds": ("--seconds", {"type": float, "help": "Closed loop: length of a dive.  [default: the split's]"}),
    "again": ("--again", {"is_flag": True, "help": "Closed loop: make dives anew that are kept in the folder."}),
}
"""Argument -> the option's name, and what click is told of it."""


@dataclass(frozen=True)
class Exploring:
    """The options that were given."""

    given: dict[str, Any]

    def refuse(self, why: str = "of the track steering", keys: Sequence[str] = tuple(OPTIONS)) -> None:
        """Refuse options that do not apply."""
        if names := [OPTIONS[key][0] for key in keys if key in self.given]:
            raise click.UsageError(f"{', '.join(names)}: {why}")


def exploring_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """Give a command the options, and the argument `exploring`."""

    @functools.wraps(command)
    def wrapped(**values: Any) -> Any:
        found = {key: values.pop(key) for key in OPTIONS}
        given = {key: value for key, value in found.items() if value is not None and value is not False}
        return command(exploring=Exploring(given), **values)

    for key, (name, about) in reversed(OPTIONS.items()):
        wrapped = click.option(name, key, **about)(wrapped)
    return wrapped


def evaluate_steering(
    split_name: str | None,
    method_names: Sequence[str],
    exploring: Exploring,
    sequences: Sequence[str],
    out: Path | None,
    workers: int | None,
    outputs: Outputs,
) -> None:
    """Run, score, print, write."""
    from oysterbench.methods import find_method
    from oysterbench.recipe import load_split
    from oysterbench.simulation.generate import split_folder
    from oysterbench.tracks.steering import evaluate_pictures
    from oysterbench.tracks.steering_rollouts import REFERENCES

    given = exploring.given
    closed = "closed_loop" in given
    if not closed:
        exploring.refuse("of dives: expected --closed-loop beside it", ("reefs", "seconds", "again"))
    # Everything that can be wrong with the request is found before the rendering begins.
    split = load_split(split_name or DEFAULT_SPLIT)
    if split.steering is None:
        raise RecipeError(
            f"split {split.name} is of the track {split.track!r}; expected one of the track {TRACK!r}, such as "
            f"{DEFAULT_SPLIT}"
        )
    names = list(dict.fromkeys(method_names or (() if closed else DEFAULT_METHODS)))
    for name in names:
        if name in REFERENCES:
            if not closed:
                raise MethodError(f"{name!r} sees the truth and answers no picture; expected --closed-loop beside it")
        elif (method := find_method(name)).track != TRACK:
            raise MethodError(f"method {method.name!r} is of the track {method.track!r}; expected one of {TRACK!r}")
    reefs = [split.find_sequence(name).name for name in sequences] or [one.name for one in split.sequence]
    if "reefs" in given:
        if given["reefs"] > len(reefs):
            raise RecipeError(f"--reefs: expected at most {len(reefs)}, as many as there are, got {given['reefs']}")
        reefs = reefs[: given["reefs"]]
    out = out or split_folder(split) / ("results-closed-loop" if closed else "results-steering")
    out.mkdir(parents=True, exist_ok=True)
    if closed:
        pilots = [*(name for name in names if name not in REFERENCES), *REFERENCES]
        _show_dives(_dive(split, reefs, pilots, given, out, workers), out, outputs)
    else:
        dives = _labelled(split, reefs, workers)
        _show_pictures(
            dives, evaluate_pictures(split, dives, [find_method(name) for name in names], _say), out, outputs
        )


def _labelled(split: SplitRecipe, sequences: Sequence[str], workers: int | None) -> list[LabelledViews]:
    from oysterbench.cli.render import render_files
    from oysterbench.exploration.labelled_views import labelled_views
    from oysterbench.simulation.salt import salt_for

    salt = salt_for(split.name, split.hidden)
    files = render_files(split, workers=workers, names=tuple(sequences), salt=salt)
    assert split.steering is not None
    return [labelled_views(files[name], split.steering) for name in sequences]


def _dive(
    split: SplitRecipe,
    reefs: Sequence[str],
    pilots: Sequence[str],
    given: dict[str, Any],
    out: Path,
    workers: int | None,
) -> list[DiveRun]:
    from oysterbench.cli.render import frames_bar
    from oysterbench.simulation.generate import check_workers
    from oysterbench.simulation.salt import salt_for
    from oysterbench.tracks.steering_rollouts import make_loop, run_dives

    loop = make_loop(split, given.get("seconds"), salt=salt_for(split.name, split.hidden))
    with frames_bar(f"diving over {split.name}", "dives") as progress:
        return run_dives(loop, reefs, pilots, out / "dives", check_workers(workers), "again" in given, progress)


def _show_pictures(dives: list[LabelledViews], runs: list[PictureRun], out: Path, outputs: Outputs) -> None:
    from oysterbench.report import comparison_tables, results_table
    from oysterbench.report.exploring import pictures_table, whole_of
    from oysterbench.report.steering_figures import picture_figures

    wholes = whole_of(runs)
    figures = picture_figures(dives, runs, wholes, out)
    first = [pictures_table(wholes)] if wholes else []
    records = [run.record for run in runs]
    several = len({record.sequence for record in records}) > 1
    printed = [*first, results_table(records), *(comparison_tables(records) if several else [])]
    _show(runs, first, printed, figures, out, outputs)


def _show_dives(runs: list[DiveRun], out: Path, outputs: Outputs) -> None:
    from oysterbench.report import results_table
    from oysterbench.report.exploring import pilots_table, places, places_table
    from oysterbench.report.steering_figures import dive_figures
    from oysterbench.report.tables import standings_table
    from oysterbench.results.comparison import boards

    first = [pilots_table(runs)]
    if found := places(runs):
        first.insert(0, places_table(found))
    # Pairs by the metric that ranks, and classes of conditions, are left to the files: they fill a screen.
    records = [run.record for run in runs]
    standings = [standings_table(board) for board in boards(records) if len(board.sequences) > 1]
    _show(runs, first, [results_table(records), *standings, *first], dive_figures(runs, out), out, outputs)


def _show(
    runs: Any,
    first: list[Table],
    printed: list[Table],
    figures: list[tuple[Path, Card]],
    out: Path,
    outputs: Outputs,
) -> None:
    from oysterbench.report import terminal_table
    from oysterbench.results.records import document, dump, write_results

    records = [run.record for run in runs]
    write_results(out / "results.json", records)
    written = [out / "results.json", *(path for path, _ in figures)]
    written += outputs.write(runs, out, first=first, figures=[figure for _, figure in figures])
    if outputs.as_json:
        click.echo(dump(document(records)))
    elif not outputs.on_stdout:
        for table in printed:
            if table.rows:
                print_rich(terminal_table(table))
    end(written, records)


def _say(text: str) -> None:
    click.echo(text, err=True)
