"""The command `tune`: random search over the options of a method, with the same budget for every method."""

from __future__ import annotations

import math
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from oysterbench.cli.echo import echo, message
from oysterbench.cli.evaluate import FOLDER
from oysterbench.cli.numbers import Number
from oysterbench.cli.outputs import print_table
from oysterbench.core.errors import MethodError, OysterbenchError

if TYPE_CHECKING:
    from oysterbench.methods.tuning import OptionRange


@click.command("tune", short_help="Search a method's options on a split, in a given number of trials.")
@click.argument("method", metavar="METHOD")
@click.option("--split", "split_name", help="Split to tune on.  [default: slam-train, or that of its track]")
@click.option("--sequence", "sequences", multiple=True, metavar="NAME", help="Only this sequence; repeatable.")
@click.option("--topics", multiple=True, metavar="GLOB", help="Render only these and the ground truth; repeatable.")
@click.option(
    "--trials",
    "count",
    type=click.IntRange(min=2),
    default=30,
    show_default=True,
    help="Number of trials; the first uses the method's defaults.",
)
@click.option(
    "--ranges",
    type=click.Path(path_type=Path, exists=True, dir_okay=False),
    help="TOML: [OPTION] range, log, choices.  [default: a published system's own]",
)
@click.option("--seed", type=int, default=0, show_default=True, help="Seed of the search.")
@click.option("--jobs", type=click.IntRange(min=1), help="Maximum runs at a time.  [default: one per core]")
@click.option("--timeout", "limit_s", type=Number(min=0, min_open=True), help="Time limit of a run, in s.")
@click.option("--scheduler", metavar="ADDRESS", help="Run on the workers of a Dask scheduler instead.")
@click.option("--again", is_flag=True, help="Rerun finished trials.")
@click.option("--out", type=FOLDER, required=True, help="Folder of all runs; the same command resumes in it.")
def tune_command(
    method: str,
    split_name: str | None,
    sequences: tuple[str, ...],
    topics: tuple[str, ...],
    count: int,
    ranges: Path | None,
    seed: int,
    jobs: int | None,
    limit_s: float | None,
    scheduler: str | None,
    again: bool,
    out: Path,
) -> None:
    """Try METHOD with random options, and print those with the best mean of the ranking metric of its track.

    \b
    Examples:
      oysterbench tune openvins_dynamic --sequence train-02 \\
        --sequence train-07 --trials 30 --out tuning/openvins
      oysterbench tune gtsam_vi --ranges ranges.toml --trials 30 --out tuning/gtsam_vi

    A trial's options depend only on the seed, its number and their names, so methods with the same budget are searched
    alike. A ranges file has a table for each option: range = [1, 9], log = true, or choices = ["a", "b"]. A failed run
    counts as one without any estimates. The last line is the method with the best options, ready for `oysterbench run`.
    A trial with a run that the machine ended, as for lack of memory, has no mean; the same command runs it again, and
    resumes after interruption.
    """
    from oysterbench.cli.progress import runs_shown
    from oysterbench.cli.render import frames_bar, render_files
    from oysterbench.core.places import home
    from oysterbench.methods.systems import split_reference, track_of
    from oysterbench.methods.tuning import read_ranges, trials
    from oysterbench.recipe import load_split
    from oysterbench.report.tuning import best_of, ranking_heading, trials_table
    from oysterbench.results.records import add_results
    from oysterbench.tracks import TRACKS, Request

    track = TRACKS[track_of(method)]
    found = split_reference(method)
    if ranges is None and found is None:
        raise click.UsageError(
            f"--ranges: {method} is not a published system, so it has no ranges of its own: give --ranges FILE.toml, "
            "with a table [OPTION] for each: range = [1, 9], or choices = [...]"
        )
    known = read_ranges(ranges) if ranges is not None else dict(found[0].description.options) if found else {}
    if found is not None:  # the method's own values, which may differ from its system's defaults
        known = {key: replace(option, default=found[2].get(key, option.default)) for key, option in known.items()}
    references = trials(method, known, count, seed)

    def keep(runs: Sequence[Any]) -> None:
        add_results(out / "results.json", [run.record for run in runs])

    request = Request(
        out=out,
        split=load_split(split_name or track.default_split.replace("-mini", "-train")),
        sequences=sequences,
        topics=track.with_truth(topics) if topics else (),
        methods=references,
        jobs=jobs,
        limit_s=limit_s,
        scheduler=scheduler,
        again=again,
        exports=home() / "exports",
        render=render_files,
        bar=frames_bar,
        announce=message,
        finished=keep,
    )
    if ranges is not None:
        _check_values(ranges, known, references[:2], lambda one: track.adapters(replace(request, methods=[one])))
    names = {adapter.name: reference for adapter, reference in zip(track.adapters(request), references, strict=True)}
    with runs_shown() as show:
        evaluation = track.evaluate(replace(request, on_output=show))
    records = evaluation.records
    table = trials_table(records, names)
    print_table(table)
    best = best_of(records, names)
    if math.isfinite(best[1]):
        message(f"best of {len(references)} trials, mean {ranking_heading(track.name)} {best[1]:.3f}:")
        echo(names[best[0]])
    absent = [each.failure for each in evaluation.unscored if each.failure is not None]
    for failure in absent:
        message(failure)
    if absent:
        sys.exit(OysterbenchError.exit_code)


def _check_values(
    file: Path, ranges: Mapping[str, OptionRange], bases: Sequence[str], make: Callable[[str], object]
) -> None:
    """Refuse ranges and choices with values that the method takes neither with its other options as they are, nor with
    those of the first trial: some only go together, such as the ends of an interval. bases: both; make: makes one."""
    from oysterbench.methods.options import with_options
    from oysterbench.methods.tuning import written

    for key, option in ranges.items():
        for value in sorted(option.ends, key=lambda end: isinstance(end, float) and end.is_integer()):  # 2.5 before 1.0
            refusals = []
            for base in bases:
                try:
                    make(with_options(base, [f"{key}={written(value)}"]))
                    break
                except MethodError as error:
                    refusals.append(error)
            else:
                raise MethodError(f"{file}: [{key}] {refusals[0]}")
