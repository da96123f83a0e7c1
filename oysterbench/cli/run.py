"""The command that runs methods, one's own and other programs: parse, call, print. `cli` takes it in."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

import click

from oysterbench.cli.outputs import Outputs, output_options, print_rich
from oysterbench.cli.scoring import scoring_options
from oysterbench.core.errors import OysterbenchError

if TYPE_CHECKING:
    from oysterbench.evaluate.slam.scoring import SlamSettings
    from oysterbench.methods.entrants import Entrant
    from oysterbench.report import SlamRun
    from oysterbench.results.records import ResultRecord
    from oysterbench.tracks.slam_runs import Dive

FOLDER = click.Path(path_type=Path, file_okay=False)


@click.command("run", short_help="Run methods, or any program, on a split: contained, measured, resumable.")
@click.argument("names", metavar="[METHOD]...", nargs=-1)
@click.option("--command", "template", metavar="TEXT", help="Another program: its command line, with placeholders.")
@click.option("--poses-of", metavar="FRAME", help="Whose poses it writes: base, imu, camera, or a camera's name.")
@click.option("--set", "options", multiple=True, metavar="KEY=VALUE", help="An option of each METHOD; repeatable.")
@click.option(
    "--ablate", multiple=True, metavar="KEY=VALUE", help="Run each METHOD once more, with this option; repeatable."
)
@click.option("--split", "split_name", help="A split's name or the path of a .toml recipe.")
@click.option("--on", "places", multiple=True, type=click.Path(path_type=Path), help="A sequence of your own instead.")
@click.option("--sequence", "sequences", multiple=True, metavar="NAME", help="Only this sequence; repeatable.")
@click.option(
    "--runs", "times", type=click.IntRange(min=1), default=1, show_default=True, help="Runs on each sequence."
)
@click.option("--jobs", "workers", type=click.IntRange(min=1), help="At a time, at most.  [default: one per core]")
@click.option(
    "--timeout",
    "limit_s",
    type=click.FloatRange(min=0, min_open=True),
    help="Seconds a run may take.  [default: 10 times the sequence's, at least 600]",
)
@click.option("--again", is_flag=True, help="Run what is finished once more.")
@click.option("--retry", is_flag=True, help="Run what failed once more.")
@click.option("--keep-exports", is_flag=True, help="Keep what programs were given, for the next time.")
@click.option("--out", type=FOLDER, help="Folder of the results.  [default: under the home]")
@scoring_options
@output_options
def run_command(
    names: tuple[str, ...],
    template: str | None,
    poses_of: str | None,
    options: tuple[str, ...],
    ablate: tuple[str, ...],
    split_name: str | None,
    places: tuple[Path, ...],
    sequences: tuple[str, ...],
    times: int,
    workers: int | None,
    limit_s: float | None,
    again: bool,
    retry: bool,
    keep_exports: bool,
    out: Path | None,
    settings: Callable[[], SlamSettings],
    outputs: Outputs,
) -> None:
    """Run methods on the sequences of a split, each in a process of its own, and score what they leave.

    \b
    Examples:
      oysterbench run gtsam_vi dead_reckoning --split slam-val
      oysterbench run my_slam:MySlam --split slam-mini --runs 5 --out results/mine
      oysterbench run my_slam --command "./my_slam {euroc} {out}" --split slam-val
      oysterbench run orb3 --command "./orb3.sh {euroc} {out}" --split slam-val --timeout 900 --jobs 1
      oysterbench run gtsam_vi --on V1_01_easy --align se3 --out results/euroc
      oysterbench run gtsam_vi --ablate frontend.max_tracks=70 --ablate loops.enabled=false --split slam-val

    METHOD is the name of an installed method or module:Class; with --command it is only a name for the program.
    Options of a method are the parameters and settings that its class has; a variant is a method of its own in the
    tables, named with them, and can be asked for by that name: gtsam_vi[frontend.max_tracks=70].
    The program is given the sequence without the truth, and must leave poses at {out}, as TUM or in any format that
    `oysterbench eval --estimate` reads.

    \b
    Placeholders:
      {euroc}  an EuRoC folder           its poses are taken as the IMU's
      {tum}    a TUM RGB-D folder        its poses are taken as the camera's
      {kitti}  a KITTI odometry folder   its poses are taken as the left camera's
      {mcap}   a sequence file           its poses are taken as the vehicle's
      {out}    the file that it leaves   {seed}  the number of the run, from 0

    The folder keeps each run's poses, logs, cost and versions. A run that ends badly, takes too long, or leaves
    nothing that can be read is a failure in the results. Whatever is interrupted, even killed: the same command goes
    on from there.
    """
    if (split_name is None) == (not places):
        raise click.UsageError("expected --split SPLIT or --on SEQUENCE, one of them")
    if template is None and not names:
        raise click.UsageError("expected a METHOD, or --command; `oysterbench run --help` has examples")
    if template is not None and len(names) > 1:
        raise click.UsageError(f"--command runs one program: expected one name for it at most, got {', '.join(names)}")
    if template is None and poses_of is not None:
        raise click.UsageError("--poses-of is for --command: a method of Python answers with the poses of base_link")
    if template is not None and (options or ablate):
        raise click.UsageError("--set and --ablate are for methods of Python: a program takes options in its --command")
    if places and sequences:
        raise click.UsageError("--sequence chooses from a split; with --on every sequence that is named is taken")

    if places and out is None:
        raise click.UsageError("--on needs --out: there is no folder that the results would belong to")

    from oysterbench.methods.entrants import Command, PythonMethod
    from oysterbench.methods.runner import default_workers
    from oysterbench.results.records import document, dump, write_results
    from oysterbench.tracks.slam_runs import run_slam

    # Everything that can be wrong with the request is found before anything is rendered.
    chosen = settings()
    entrants: list[Entrant] = (
        [PythonMethod(name) for name in _variants(names, options, ablate)]
        if template is None
        else [Command(template, names[0] if names else "", poses_of or "")]
    )
    dives, folder = _dives(split_name, sequences, places)
    out = out or folder
    assert out is not None
    finished = run_slam(
        dives, entrants, chosen, out, times, workers or default_workers(), limit_s, again, retry, keep_exports, say
    )
    runs, unscored = [], []
    for each in finished:
        if each.failure is not None:
            say(each.failure)
        if each.scored is None:
            unscored.append(each)
            continue
        runs.append(each.scored)
        # After each, so that a kill leaves a table of what was finished.
        write_results(out / "results.json", [run.record for run in runs])
    _sort(runs, dives, entrants)
    records = [run.record for run in runs]
    write_results(out / "results.json", records)
    written = outputs.write(runs, out) if runs else []
    if outputs.as_json:
        click.echo(dump(document(records)))
    elif not outputs.on_stdout and records:
        _print_tables(records)
    for each in unscored:
        if each.failure is None:
            say(f"{each.job.name} has no truth to score by; the poses: {each.job.folder(out)}")
    for path in [out / "results.json", *written]:
        say(f"written: {path}")
    if any(run.record.failure is not None for run in runs) or any(each.failure is not None for each in unscored):
        sys.exit(OysterbenchError.exit_code)


def _variants(names: tuple[str, ...], options: tuple[str, ...], ablate: tuple[str, ...]) -> list[str]:
    """The methods with their options, each followed by its variants; each once."""
    from oysterbench.methods.options import split_commas, with_options

    found = []
    for name in names:
        base = with_options(name, options)
        found += [base, *(with_options(base, split_commas(each)) for each in ablate)]
    return list(dict.fromkeys(found))


def say(text: str) -> None:
    """A message to the user, on stderr."""
    click.echo(text, err=True)


def _dives(
    split_name: str | None, sequences: tuple[str, ...], places: tuple[Path, ...]
) -> tuple[list[Dive], Path | None]:
    """The sequences to run on, rendered where they are not there yet, and the folder of the results by default."""
    from oysterbench.tracks.slam_runs import Dive, dives_of

    if split_name is None:
        return dives_of(places), None
    from oysterbench.cli.render import render_files
    from oysterbench.recipe import load_split
    from oysterbench.simulation.generate import split_folder

    split = load_split(split_name)
    files = render_files(split, names=sequences)
    chosen = {name: path for name, path in files.items() if not sequences or name in sequences}
    return [Dive(name, path, split) for name, path in chosen.items()], split_folder(split) / "runs"


def _sort(runs: list[SlamRun], dives: list[Dive], entrants: list[Entrant]) -> None:
    """From the order in which they were finished to that in which they were asked for."""
    places = {dive.name: i for i, dive in enumerate(dives)}
    ranks = {entrant.name: i for i, entrant in enumerate(entrants)}
    runs.sort(key=lambda run: (places[run.record.sequence], ranks[run.record.method], run.record.run))


def _print_tables(records: list[ResultRecord]) -> None:
    from oysterbench.report import comparison_tables, results_table, terminal_table

    print_rich(terminal_table(results_table(records), titled=False))
    for table in comparison_tables(records) if len({record.sequence for record in records}) > 1 else []:
        print_rich(terminal_table(table))
