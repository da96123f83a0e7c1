"""The command line: parse, call, print. Data goes to stdout, progress and messages to stderr."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import click

from oysterbench.cli.compare import compare_command
from oysterbench.cli.density import TRACK as DENSITY
from oysterbench.cli.density import Mapping, density_options, evaluate_density
from oysterbench.cli.hub import COMMANDS as HUB_COMMANDS
from oysterbench.cli.imaging import TRACKS as IMAGE_TRACKS
from oysterbench.cli.imaging import Imaging, evaluate_images, imaging_options
from oysterbench.cli.learn import Installed, experiment, train, translate
from oysterbench.cli.map import map_command
from oysterbench.cli.outputs import Outputs, output_options, print_rich
from oysterbench.cli.reading import Reading, reading_options
from oysterbench.cli.render import frames_bar, render, render_files
from oysterbench.cli.run import run_command
from oysterbench.cli.scoring import Scoring, scoring_options
from oysterbench.cli.splits import splits
from oysterbench.cli.steering import TRACK as STEERING
from oysterbench.cli.steering import Exploring, evaluate_steering, exploring_options
from oysterbench.core.errors import OysterbenchError
from oysterbench.version import VERSION

TRACKS = ("slam", *IMAGE_TRACKS, DENSITY, STEERING)
DEFAULT_SPLIT = {"slam": "slam-mini"}
DEFAULT_METHODS = {"slam": ("gtsam_vi", "dead_reckoning")}
"""On slam-mini, one camera and an inertial unit: gtsam_full has nothing there that gtsam_vi has not, and visual_only,
which has no scale, cannot be scored as they are."""
ALIGNMENTS = ("none", "origin", "se3", "posyaw", "sim3")
ASSOCIATIONS = ("interpolate", "nearest")
INTERRUPTED = 130
COMMANDS = Installed("oysterbench", "oysterbench.commands")


class Commands(click.Group):
    """Turns expected failures into one line on stderr and an exit code. Commands that packages bring under the entry
    points `oysterbench.commands` are found as well."""

    def list_commands(self, context: click.Context) -> list[str]:
        return sorted({*super().list_commands(context), *COMMANDS.found()})

    def get_command(self, context: click.Context, name: str) -> click.Command | None:
        return super().get_command(context, name) or COMMANDS.get_command(context, name)

    def invoke(self, context: click.Context) -> Any:
        try:
            return super().invoke(context)
        except OysterbenchError as error:
            _fail(str(error), error.exit_code)
        except KeyboardInterrupt:
            _fail("interrupted; what was finished is kept, and the same command goes on from there", INTERRUPTED)
        except BrokenPipeError:
            raise
        except OSError as error:
            place = f"{error.filename}: " if error.filename else ""
            _fail(f"{place}{error.strerror or error}", 1)


def _fail(message: str, code: int) -> None:
    click.echo(f"oysterbench: {' '.join(message.split())}", err=True)
    sys.exit(code)


@click.group(
    cls=Commands,
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100},
    epilog="Data is kept in the folder that OYSTERBENCH_HOME names, or in the user's data folder.",
)
@click.version_option(VERSION, prog_name="oysterbench")
def main() -> None:
    """Benchmarks for underwater robots on seeded, re-creatable oyster reefs.

    \b
    Examples:
      oysterbench eval --track slam                 the demo: render, run the baselines, print the table
      oysterbench eval --track slam --method gtsam_vi --out results
      oysterbench eval --track slam --truth truth.tum --estimate mine.tum --align se3
      oysterbench eval --track steering             policies that explore, against an expert
      oysterbench run my_slam --command "..."       run any program on a split, and score it
      oysterbench compare ours theirs               ranks, ties, and who is better where
      oysterbench train unet --data seg-train       a method that learns
      oysterbench splits                            what can be rendered, and what is here
      oysterbench render slam-mini --workers 2
      oysterbench download slam-mini                from a hub, or rendered where none is set
      oysterbench info mini-01.mcap
      oysterbench export mini-01.mcap --format euroc --out mini-01
      oysterbench map val-01.mcap --trajectory poses.tum --masks answers --out map    oysters per m2
      oysterbench map mini-01.mcap --trajectory poses.tum --out mini-01.ply
      oysterbench view mini-01.mcap                 one page to look through it
      oysterbench gallery                           waters, lights, reefs and views on one sheet
      oysterbench oyster --seed 7 --out oyster.glb
    """


for _command in (
    run_command,
    compare_command,
    map_command,
    train,
    translate,
    experiment,
    render,
    splits,
    *HUB_COMMANDS,
):
    main.add_command(_command)


@main.command("eval", short_help="Run methods on a split and score them, or score two files.")
@click.option("--track", type=click.Choice(TRACKS), required=True, help="What is evaluated.")
@click.option("--split", "split_name", help="A split's name or the path of a .toml recipe.  [default: the mini one]")
@click.option("--method", "method_names", multiple=True, help="A method; repeatable.  [default: the track's baselines]")
@click.option("--truth", type=click.Path(path_type=Path), help="Score files: the true trajectory, or masks.")
@click.option("--estimate", type=click.Path(path_type=Path), help="Score files: the estimated ones.")
@reading_options
@scoring_options
@imaging_options
@density_options
@exploring_options
@click.option(
    "--out", type=click.Path(path_type=Path, file_okay=False), help="Folder of the results.  [default: under the home]"
)
@click.option("--workers", type=click.IntRange(min=1), help="Processes that render, or dive.  [default: one per core]")
@click.option("--runs", "times", type=click.IntRange(min=1), help="Runs of each method on each sequence.  [default: 1]")
@output_options
def eval_command(
    track: str,
    split_name: str | None,
    method_names: tuple[str, ...],
    truth: Path | None,
    estimate: Path | None,
    reading: Reading,
    settings: Scoring,
    imaging: Imaging,
    mapping: Mapping,
    exploring: Exploring,
    out: Path | None,
    workers: int | None,
    times: int | None,
    outputs: Outputs,
) -> None:
    """Run methods on a split and score them, or score files: trajectories, masks, single oysters.

    \b
    Examples:
      oysterbench eval --track slam
      oysterbench eval --track slam --method dead_reckoning --json
      oysterbench eval --track slam --runs 5 --out five-runs
      oysterbench eval --track slam --truth truth.tum --estimate mine.tum --align se3 --associate nearest
      oysterbench eval --track slam --truth truth.tum --estimate mine.tum --report mine.html --tex -
      oysterbench eval --track segmentation --method my_net:MyNet --split seg-val
      oysterbench eval --track segmentation --truth masks/ --estimate probabilities/ --threshold 0.4
      oysterbench eval --track detection --truth instances.json --estimate results.json
      oysterbench eval --track density --split slam-val --method gtsam_full --method dead_reckoning
      oysterbench eval --track density --split slam-val --poses results --masks answers --depth stereo
      oysterbench eval --track steering --method my_pilot:MyPilot --split steer-val
      oysterbench eval --track steering --closed-loop --method my_pilot:MyPilot --split steer-val --reefs 3

    The split is rendered on first use. The folder of results has them as JSON, CSV, LaTeX, Markdown and as an HTML
    report. Run k of a method that draws random numbers has the method's seed + k.
    """
    if (truth is None) != (estimate is None):
        raise click.UsageError("--truth and --estimate belong together: expected both or none")
    if truth is None and reading.given:
        raise click.UsageError(f"{', '.join(reading.given)}: says how to read files, but no --truth and --estimate are")
    if truth is not None and (split_name or method_names or workers or times):
        raise click.UsageError(
            "--truth and --estimate score two files: --split, --method, --workers and --runs do not apply"
        )
    if track in (DENSITY, STEERING):
        names = [*reading.given, *(["--runs"] if times else []), *(["--truth"] if truth else [])]
        names += [name for name in settings.given if track == STEERING or name != "--align"]
        if names:
            raise click.UsageError(f"{', '.join(names)}: of other tracks, not of {track}")
        imaging.refuse(tuple(imaging.given), "of the tracks segmentation and detection")
    if track == STEERING:
        mapping.refuse(besides=("sequences",))
        sequences = mapping.given.get("sequences", ())
        evaluate_steering(split_name, method_names, exploring, sequences, out, workers, outputs)
        return
    exploring.refuse()
    if track == DENSITY:
        evaluate_density(split_name, method_names, mapping, settings.values.get("align"), out, workers, outputs)
        return
    mapping.refuse()
    if track in IMAGE_TRACKS:
        if names := [*reading.given, *(["--runs"] if times else []), *settings.given]:
            raise click.UsageError(f"{', '.join(names)}: of the track slam, not of {track}")
        evaluate_images(track, split_name, method_names, truth, estimate, imaging, out, workers, outputs)
        return
    imaging.refuse(tuple(imaging.given), "of the tracks segmentation and detection")

    from oysterbench.results.records import document, dump, write_results

    chosen = settings()
    if truth is not None and estimate is not None:
        from oysterbench.tracks.slam import score_files

        runs = [score_files(truth, estimate, chosen, *reading.options())]
    else:
        from oysterbench.methods.entrants import PythonMethod
        from oysterbench.recipe import load_split
        from oysterbench.simulation.generate import split_folder
        from oysterbench.tracks.slam_runs import Dive, run_slam

        # Everything that can be wrong with the request is found before the rendering begins.
        split = load_split(split_name or DEFAULT_SPLIT[track])
        methods = [PythonMethod(name) for name in dict.fromkeys(method_names or DEFAULT_METHODS[track])]
        out = out or split_folder(split) / "results"
        out.mkdir(parents=True, exist_ok=True)
        files = render_files(split, workers=workers)
        dives = [Dive(name, path, split) for name, path in files.items()]
        # One at a time, so that none takes time from another, and anew: `run` is the command that goes on.
        finished = run_slam(dives, methods, chosen, out, times or 1, again=True, announce=_say)
        runs = [each.scored for each in finished if each.scored is not None]

    records = [run.record for run in runs]
    if out is not None:
        write_results(out / "results.json", records)
    written = outputs.write(runs, out)
    if outputs.as_json:
        click.echo(dump(document(records)))
    elif not outputs.on_stdout:
        _print_slam_table(records)
    for path in [*([out / "results.json"] if out is not None else []), *written]:
        _say(f"written: {path}")
    failures = [record for record in records if record.failure is not None]
    for record in failures:
        _say(f"{record.method} failed on {record.sequence}: {record.failure}")
    if failures:
        sys.exit(OysterbenchError.exit_code)


@main.command(short_help="What is in a sequence file.")
@click.argument("sequence", type=click.Path(path_type=Path))
@click.option("--json", "as_json", is_flag=True, help="Print as JSON.")
def info(sequence: Path, as_json: bool) -> None:
    """Say what is in a sequence: an MCAP file or a folder in EuRoC layout.

    \b
    Examples:
      oysterbench info mini-01.mcap
      oysterbench info mini-01.mcap --json
    """
    from oysterbench.sequence import describe

    facts = describe(sequence)
    if as_json:
        click.echo(json.dumps(facts, indent=2))
        return
    from rich.table import Table

    click.echo(
        f"{facts['sequence']}: {facts['duration_s']:g} s, {facts['path_length_m'] or float('nan'):.2f} m of path"
    )
    for key, value in facts["metadata"].items():
        click.echo(f"  {key}: {value}")
    for name, camera in facts["cameras"].items():
        click.echo(f"  {name}: {camera['width']} x {camera['height']} at {camera['rate_hz']:g} Hz")
    table = Table(box=None, pad_edge=False)
    for heading in ("topic", "type", "messages", "per second"):
        table.add_column(heading, justify="right" if heading in ("messages", "per second") else "left")
    for row in facts["topics"]:
        table.add_row(row["topic"], row["type"], str(row["messages"]), f"{row['rate_hz']:g}")
    print_rich(table)


class ExportCommand(click.Command):
    """Lists the formats that there are, which takes too long for `oysterbench --help`."""

    def format_epilog(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        from oysterbench.sequence.export import FORMATS

        with formatter.section("Formats"):
            formatter.write_dl(list(FORMATS.items()))


def _known_format(ctx: click.Context, parameter: click.Parameter, value: str) -> str:
    from oysterbench.sequence.export import FORMATS

    if value not in FORMATS:
        raise click.BadParameter(f"{value!r} is not one of {', '.join(FORMATS)}.", ctx, parameter)
    return value


@main.command(cls=ExportCommand, short_help="Export a sequence: EuRoC, TUM RGB-D, KITTI, COCO, Kalibr, PLY.")
@click.argument("sequence", type=click.Path(path_type=Path))
@click.option("--format", "form", metavar="FORMAT", callback=_known_format, required=True, help="What to write.")
@click.option("--out", type=click.Path(path_type=Path), required=True, help="Folder, which must not be there yet.")
@click.option("--truth/--no-truth", default=True, show_default=True, help="With or without what no method may see.")
@click.option("--json", "as_json", is_flag=True, help="Print the folder and what there is to say as JSON.")
def export(sequence: Path, form: str, out: Path, truth: bool, as_json: bool) -> None:
    """Export a sequence in a format of others, as a folder that is there whole or not at all.

    \b
    Examples:
      oysterbench export mini-01.mcap --format euroc --out mini-01-euroc
      oysterbench export mini-01.mcap --format euroc --out for-a-method --no-truth
      oysterbench export mini-01.mcap --format tum --out mini-01-tum
      oysterbench export mini-01.mcap --format coco --out mini-01-coco
    """
    from oysterbench.sequence import open_sequence
    from oysterbench.sequence.export import export_sequence

    folder, notes = export_sequence(open_sequence(sequence), form, out, truth)
    if as_json:
        click.echo(json.dumps({"folder": str(folder), "format": form, "notes": notes}, indent=2))
        return
    for note in notes:
        _say(note)
    click.echo(folder)


@main.command(short_help="One HTML page to look through a sequence.")
@click.argument("sequence", type=click.Path(path_type=Path))
@click.option("--out", type=click.Path(path_type=Path, dir_okay=False), help="File.  [default: NAME.html]")
def view(sequence: Path, out: Path | None) -> None:
    """Make one HTML page of a sequence: all cameras, sonar fans, strips of the scalar sensors, the path from above.

    \b
    Examples:
      oysterbench view mini-01.mcap
      oysterbench view mini-01.mcap --out preview.html

    The page needs no other file and no network, and stays small however long the sequence is.
    """
    from oysterbench.core.files import write_atomically
    from oysterbench.report.viewer import view_page
    from oysterbench.sequence import open_sequence

    opened = open_sequence(sequence)
    path = out or Path(f"{opened.name}.html")
    write_atomically(path, view_page(opened).encode())
    click.echo(path)


@main.command(short_help="One sheet of pictures over waters, lights, reefs and views.")
@click.option("--real", type=click.Path(path_type=Path, file_okay=False), help="Show close-ups beside real images.")
@click.option("--out", type=click.Path(path_type=Path, dir_okay=False), default="gallery.png", show_default=True)
def gallery(real: Path | None, out: Path) -> None:
    """Render one sheet of pictures: waters, lights, densities and views; or close-ups beside real images.

    \b
    Examples:
      oysterbench gallery
      oysterbench gallery --out sheet.jpg
      oysterbench gallery --real real-oysters --out beside-real.png

    The panels are those of datasets/gallery/*.toml.
    """
    from oysterbench.simulation.gallery import gallery as make_gallery
    from oysterbench.simulation.gallery import write_picture

    if out.suffix not in (".png", ".jpg"):
        raise click.UsageError(f"--out: expected a name that ends in .png or .jpg, got {out}")
    with frames_bar("gallery") as progress:
        picture = make_gallery(real, progress)
    write_picture(out, picture)
    click.echo(out)


@main.command(short_help="Export one oyster as a mesh.")
@click.option("--seed", type=click.IntRange(min=0), default=0, show_default=True, help="Which oyster.")
@click.option("--size", "size_mm", type=float, help="Height of the shell in mm, 25 to 172.  [default: by the seed]")
@click.option("--state", default="live", show_default=True, help="live, box, left valve or right valve.")
@click.option("--out", type=click.Path(path_type=Path, dir_okay=False), default="oyster.glb", show_default=True)
@click.option("--json", "as_json", is_flag=True, help="Print its measures as JSON.")
def oyster(seed: int, size_mm: float | None, state: str, out: Path, as_json: bool) -> None:
    """Export one oyster in real-world size, in metres: .glb, .obj, .stl or .ply by the suffix.

    \b
    Examples:
      oysterbench oyster --seed 7 --out oyster.glb
      oysterbench oyster --seed 7 --size 110 --state box --out box.stl
    """
    from oysterbench.scene.export import export_oyster

    facts = export_oyster(seed, out, size_mm, state)
    if as_json:
        click.echo(json.dumps({"file": str(out), **facts}, indent=2))
        return
    height, length, width = (1000 * facts[f"{key}_m"] for key in ("height", "length", "width"))
    click.echo(f"{out}: {height:.0f} x {length:.0f} x {width:.0f} mm, {1e6 * facts['volume_m3']:.1f} ml")


def _print_slam_table(records: list[Any]) -> None:
    from oysterbench.report import comparison_tables, results_table, runs_table, terminal_table
    from oysterbench.results.comparison import boards

    print_rich(terminal_table(results_table(records), titled=False))
    several = len({record.sequence for record in records}) > 1
    tables = comparison_tables(records) if several else [runs_table(board) for board in boards(records)]
    for table in tables:
        if table.rows:
            print_rich(terminal_table(table))


def _say(text: str) -> None:
    click.echo(text, err=True)
