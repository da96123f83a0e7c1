"""The command `eval TRACK`, with the options of each track, also as `eval --track TRACK`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from oysterbench.cli.evaluate import (
    FOLDER,
    check_settings,
    click_option,
    evaluate,
    finish,
    foreign_options,
    given_options,
)
from oysterbench.cli.outputs import Outputs, output_options
from oysterbench.cli.values import check_values

if TYPE_CHECKING:
    from oysterbench.tracks import Track

WORKERS = "Processes that render, or drive.  [default: one per core]"


class TrackCommands(click.Group):
    """Group with a command for each track, made on demand; `--track NAME` among the options also selects one."""

    def parse_args(self, context: click.Context, args: list[str]) -> list[str]:
        for i, word in enumerate(args):
            if word == "--track" and i + 1 < len(args):
                args = [args[i + 1], *args[:i], *args[i + 2 :]]
                break
            if word.startswith("--track="):
                args = [word.removeprefix("--track="), *args[:i], *args[i + 1 :]]
                break
        tracks = self.list_commands(context)
        if args and args[0] not in (*tracks, *context.help_option_names):
            got = "" if args[0].startswith("-") else f", got {args[0]!r}"
            context.fail(f"expected a track, one of {', '.join(tracks)}{got}")
        check_values(context, self, args)  # once more, as the options before --track have become the track's
        return super().parse_args(context, args)

    def list_commands(self, context: click.Context) -> list[str]:
        from oysterbench.tracks import NAMES

        return list(NAMES)

    def get_command(self, context: click.Context, name: str) -> click.Command | None:
        from oysterbench.tracks import NAMES, TRACKS

        return track_command(TRACKS[name]) if name in NAMES else None


@click.group("eval", cls=TrackCommands, short_help="Get a first number: score methods on a split, or two files.")
def eval_command() -> None:
    """Score methods on a split, one after the other and from scratch, or score files that you already have.

    For a first number: everything has a default. For experiments, use `oysterbench run`: any program, parallel runs,
    variants, and resuming after interruption.

    \b
    Examples:
      oysterbench eval slam
      oysterbench eval --track slam                 the same
      oysterbench eval slam --truth truth.tum --estimate mine.tum --align se3
      oysterbench eval segmentation --method my_net:MyNet --split seg-val
      oysterbench eval segmentation --truth masks/ --estimate probabilities/ --threshold 0.4
      oysterbench eval detection --truth instances.json --estimate results.json
      oysterbench eval density --split slam-val --method gtsam_full
      oysterbench eval steering --closed-loop --method my_policy:MyPolicy --split steer-val
      oysterbench eval slam --help                  its options

    The split is rendered on first use. The results folder has JSON, CSV, LaTeX, Markdown and an HTML report. Run k of a
    method that draws random numbers uses the method's seed + k.
    """


def track_command(track: Track) -> click.Command:
    """Make the command of a track."""
    parameters: list[click.Parameter] = [
        click.Option(
            ["--split", "split_name"], help=f"A split's name or a .toml recipe.  [default: {track.default_split}]"
        ),
        click.Option(["--sequence", "sequences"], multiple=True, metavar="NAME", help="Only this one; repeatable."),
        click.Option(
            ["--method", "methods"],
            multiple=True,
            help=f"A method; repeatable.  [default: {', '.join(track.default_methods)}]",
        ),
    ]
    if track.files:
        kind = click.Path(path_type=Path)
        parameters += [
            click.Option([name], type=kind, multiple=True, callback=_one, help=f"Score files: {what}.")
            for name, what in (
                ("--truth", f"the true {track.files.rstrip(',')}"),
                ("--estimate", "the estimates of one method; run again for another"),
            )
        ]
    parameters += [click_option(option) for option in track.options]
    parameters += [
        click.Option(["--out"], type=FOLDER, help="Folder of the results.  [default: under the home folder]"),
        click.Option(["--workers"], type=click.IntRange(min=1), help=WORKERS),
        click.Option(["--runs"], type=click.IntRange(min=1), help="Runs on each sequence.  [default: 1]"),
    ]

    def call(**values: Any) -> None:
        _evaluate(track, **values)

    text = f"{track.title}\n\n\b\nExamples:\n{track.examples.strip(chr(10))}\n"
    make = click.command(track.name, cls=Evaluate, params=parameters, short_help=track.title, help=text)
    return make(output_options(call))


def _one(context: click.Context, parameter: click.Parameter, given: tuple[Path, ...]) -> Path | None:
    """Return the single value of an option; refuse several, of which click alone would keep only the last."""
    if len(given) > 1:
        raise click.BadParameter(f"expected one path, got {len(given)}: score them one by one", context, parameter)
    return given[0] if given else None


class Evaluate(click.Command):
    """Command that says which tracks, or whether `run`, have an option that its own track does not have."""

    def parse_args(self, context: click.Context, args: list[str]) -> list[str]:
        try:
            return super().parse_args(context, args)
        except click.NoSuchOption as error:
            from oysterbench.cli.run import run_command

            foreign_options(self.name or "", {error.option_name: owners(error.option_name)})
            if any(error.option_name in parameter.opts for parameter in run_command.params):
                raise click.UsageError(
                    f"{error.option_name}: an option of `oysterbench run --track {self.name}`, not of eval"
                ) from None
            raise


def owners(name: str) -> list[str]:
    """Tracks that have an option."""
    from oysterbench.tracks import TRACKS

    return [track.name for track in TRACKS.values() if name in [option.name for option in track.options]]


def _evaluate(
    track: Track,
    split_name: str | None,
    sequences: tuple[str, ...],
    methods: tuple[str, ...],
    out: Path | None,
    workers: int | None,
    runs: int | None,
    outputs: Outputs,
    truth: Path | None = None,
    estimate: Path | None = None,
    **values: Any,
) -> None:
    options = given_options(track.options, values)
    check_settings(track, options)
    reading = [option.name for option in track.options if option.files and option.key in options]
    if (truth is None) != (estimate is None):
        raise click.UsageError("--truth and --estimate belong together: expected both or none")
    if truth is not None and estimate is not None:
        if split_name or methods or sequences or workers or runs:
            raise click.UsageError(
                "--truth and --estimate score two files: --split, --sequence, --method, --workers and --runs do not "
                "apply"
            )
        finish(track.score_files(truth, estimate, options), out, outputs)
        return
    if reading:
        raise click.UsageError(f"{', '.join(reading)}: says how to read files, but no --truth and --estimate are given")

    from oysterbench.methods.runner import AGAIN
    from oysterbench.recipe import load_split
    from oysterbench.simulation.generate import split_folder
    from oysterbench.tracks import Request

    split = load_split(split_name or track.default_split)
    out = out or split_folder(split) / track.folder("results", options)
    (out / AGAIN).unlink(missing_ok=True)  # an interrupted evaluation is not gone on with
    request = Request(
        out=out,
        split=split,
        sequences=sequences,
        methods=methods,
        options=options,
        runs=runs or 1,
        jobs=1,  # one at a time, so that runs do not slow each other down
        workers=workers,
        again=True,  # always from scratch: `run` is the command that resumes
    )
    evaluate(track, request, outputs)
