"""The command that runs methods of any track, and external programs: parse, call, print."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from oysterbench.cli.echo import message
from oysterbench.cli.evaluate import (
    FOLDER,
    argument,
    check_settings,
    click_option,
    evaluate,
    foreign_options,
    given_options,
)
from oysterbench.cli.numbers import Number
from oysterbench.cli.outputs import Outputs, output_options

if TYPE_CHECKING:
    from oysterbench.tracks import Option


class Run(click.Command):
    """Command with the options of all tracks, which are loaded when needed."""

    def get_params(self, context: click.Context) -> list[click.Parameter]:
        params = super().get_params(context)
        taken = {name for param in params for name in param.opts}
        of_tracks = [click_option(option) for name, option in track_options().items() if name not in taken]
        return [*params[:-1], *of_tracks, params[-1]]


def track_options() -> dict[str, Option]:
    """Options of all tracks, by the name as typed, except those for reading files."""
    from oysterbench.tracks import TRACKS

    return {option.name: option for track in TRACKS.values() for option in track.options if not option.files}


@click.command("run", cls=Run, short_help="Run experiments: methods or any program on a split, measured and resumable.")
@click.argument("names", metavar="[METHOD]...", nargs=-1)
@click.option("--track", "track_name", metavar="TRACK", help="Track to evaluate.  [default: the method's own]")
@click.option("--command", "template", metavar="TEXT", help="Command line of an external program, with placeholders.")
@click.option(
    "--poses-of", metavar="FRAME", help="Frame of the program's poses: base, imu, camera, or a camera's name."
)
@click.option("--set", "settings", multiple=True, metavar="KEY=VALUE", help="An option of each METHOD; repeatable.")
@click.option(
    "--ablate", multiple=True, metavar="KEY=VALUE", help="Run each METHOD once more, with this option; repeatable."
)
@click.option("--split", "split_name", help="A split's name (a downloaded hidden one, too) or a .toml recipe.")
@click.option(
    "--on",
    "places",
    multiple=True,
    metavar="PATH",
    type=click.Path(path_type=Path),
    help="Your own data instead: a sequence, a folder of them, or labelled images.",
)
@click.option("--sequence", "sequences", multiple=True, metavar="NAME", help="Only this sequence; repeatable.")
@click.option("--topics", multiple=True, metavar="GLOB", help="Render only these and the ground truth; repeatable.")
@click.option("--runs", type=click.IntRange(min=1), default=1, show_default=True, help="Runs on each sequence.")
@click.option("--jobs", type=click.IntRange(min=1), help="Maximum runs at a time.  [default: one per core]")
@click.option("--scheduler", metavar="ADDRESS", help="Run on the workers of a Dask scheduler instead.")
@click.option(
    "--timeout",
    "limit_s",
    type=Number(min=0, min_open=True),
    help="Time limit in s of a run, or of a rollout.  [default: 10 times the sequence's, 10 per image, at least 600, "
    "or a system's own; for a rollout 4 hours]",
)
@click.option("--again", is_flag=True, help="Rerun finished runs.")
@click.option("--retry", is_flag=True, help="Rerun failed runs, also those that could not be scored.")
@click.option("--out", type=FOLDER, help="Folder of the results.  [default: under the home folder]")
@output_options
def run_command(
    names: tuple[str, ...],
    track_name: str | None,
    template: str | None,
    poses_of: str | None,
    settings: tuple[str, ...],
    ablate: tuple[str, ...],
    split_name: str | None,
    places: tuple[Path, ...],
    sequences: tuple[str, ...],
    topics: tuple[str, ...],
    runs: int,
    jobs: int | None,
    scheduler: str | None,
    limit_s: float | None,
    again: bool,
    retry: bool,
    out: Path | None,
    outputs: Outputs,
    **values: Any,
) -> None:
    """Run methods, or any program, on the sequences of a split, and score their output; finished runs are kept.

    For experiments: each run is a separate process without the ground truth, with its time and memory measured. Runs go
    in parallel, and the same command resumes after interruption. For a first number, use `oysterbench eval`.

    \b
    Examples:
      oysterbench run gtsam_vi dead_reckoning --split slam-val
      oysterbench run my_slam:MySlam --split slam-mini --runs 5 --out results/mine
      oysterbench run openvins --split slam-val    (published: see oysterbench systems)
      oysterbench run basalt_mono --split slam-val --topics '/cam_left/*' --topics /imu
      oysterbench run my_slam --command "./my_slam {euroc} {out}" --split slam-val
      oysterbench run orb3 --command "./orb3.sh {euroc} {out}" \\
        --split slam-val --align se3 --timeout 900
      oysterbench run gtsam_vi --split slam-val --runs 5 --scheduler tcp://10.0.0.1:8786
      oysterbench run gtsam_vi --on V1_01_easy --align se3 --out results/euroc
      oysterbench run gtsam_vi --split slam-val \\
        --ablate frontend.max_tracks=70 --ablate loops.enabled=false
      oysterbench run unet --split seg-val
      oysterbench run my_net --command "./segment {images} {out}" \\
        --track detection --split seg-val

    METHOD is the name of an installed method or module:Class; with --command it is only a name for the program. Options
    of a method are the parameters and settings of its class. A variant is a separate method in the tables, named with
    its options, and can be run as it is written: gtsam_vi[frontend.max_tracks=70]. The program is given the sequence
    without the ground truth and must write poses to {out}, as TUM or in any format that `oysterbench eval --estimate`
    reads; for {images}, a folder of masks named like the images, or COCO annotations; on the track steering, a table
    stamp_ns,yaw,pitch.

    \b
    Placeholders:
      {euroc}  an EuRoC folder           its poses are taken as the IMU's
      {tum}    a TUM RGB-D folder        its poses are taken as the camera's
      {kitti}  a KITTI odometry folder   its poses are taken as the left camera's
      {rosbag} a folder with a ROS 1 bag its poses are taken as the IMU's
      {mcap}   a sequence file           its poses are taken as the vehicle's
      {images} a folder of images        (--track segmentation, detection or steering)
      {out}    the file that it writes   {seed}  the number of the run, from 0
      {online} an optional file: its path as it was known at each time (SLAM; measured, not ranked)

    The folder keeps each run's predictions, logs, cost and versions. A run that crashes, exceeds the time limit or
    writes nothing readable is a failure in the results. A run that the machine killed, or had no memory or disk for, is
    not, and the same command runs it again. If a METHOD needs trained weights that are missing, they are downloaded
    first where a hub is set: `oysterbench models`. After any interruption, even a kill, the same command resumes.
    A module:Class is known by its code and `weights`; once they have changed, its results are refused until --again.
    Temporary files go to the folder that TMPDIR names; folders given to programs are kept under the home folder for
    other runs, up to OYSTERBENCH_EXPORTS_GB (20). A program's lines `progress 120 of 700` are shown as a bar.
    """
    if (split_name is None) == (not places):
        raise click.UsageError("expected either --split SPLIT or --on SEQUENCE")
    if template is None and not names:
        raise click.UsageError("expected a METHOD, or --command; `oysterbench run --help` has examples")
    if template is not None and len(names) > 1:
        raise click.UsageError(f"--command runs one program: expected at most one name for it, got {', '.join(names)}")
    if template is None and poses_of is not None:
        raise click.UsageError("--poses-of is for --command: a Python method gives the poses of base_link")
    if template is not None and (settings or ablate):
        raise click.UsageError("--set and --ablate are for Python methods: put a program's options into --command")
    if places and sequences:
        raise click.UsageError("--sequence chooses from a split; with --on, every named sequence is used")
    if places and topics:
        raise click.UsageError("--topics chooses from a split; with --on, methods are given what the sequences have")
    if places and out is None:
        raise click.UsageError("--on needs --out: its results have no default folder")

    from oysterbench.methods.interfaces import track_of_command
    from oysterbench.methods.systems import track_of
    from oysterbench.recipe import load_split, split_names
    from oysterbench.sequence.cut import topics_folder
    from oysterbench.simulation.generate import split_folder
    from oysterbench.tracks import TRACKS, Request
    from oysterbench.tracks.downloaded import files_by_name

    methods = _variants(names, settings, ablate) if template is None else []
    name = track_name or (track_of(methods[0]) if template is None else track_of_command(template))
    if name not in TRACKS:
        raise click.UsageError(f"--track: expected one of {', '.join(TRACKS)}, got {name!r}")
    track = TRACKS[name]
    owners = {n: [t.name for t in TRACKS.values() if n in {o.name for o in t.options}] for n in track_options()}
    options = given_options(track.options, dict(values)) | ({"again": True} if again else {})
    given = {n for n, o in track_options().items() if values.get(argument(o)) not in (None, ())}
    foreign_options(name, {n: owners[n] for n in given if name not in owners[n]})
    check_settings(track, options)
    split = None
    if split_name is not None:
        ours = split_name.endswith(".toml") or split_name in split_names()
        if not ours and (files := files_by_name(split_name, sequences, topics, message)):
            places, sequences = tuple(files.values()), ()
        else:
            split = load_split(split_name)
    if topics:
        topics = track.with_truth(topics)
    if out is None:
        folder = places[0].parent if split is None else split_folder(split)
        out = (topics_folder(folder, topics) if topics else folder) / track.folder("runs", options)
    request = Request(
        out=out,
        split=split,
        places=places,
        sequences=sequences,
        topics=topics,
        methods=methods,
        template=template,
        name=names[0] if template is not None and names else "",
        poses_of=poses_of or "",
        options=options,
        runs=runs,
        jobs=jobs,
        scheduler=scheduler,
        limit_s=limit_s,
        again=again,
        retry=retry,
    )
    evaluate(track, request, outputs)


def _variants(names: tuple[str, ...], settings: tuple[str, ...], ablate: tuple[str, ...]) -> list[str]:
    """References of the methods with their options, each followed by its variants, without duplicates."""
    from oysterbench.methods.options import split_commas, with_options

    found = []
    for name in names:
        base = with_options(name, settings)
        found += [base, *(with_options(base, split_commas(each)) for each in ablate)]
    return list(dict.fromkeys(found))
