"""The command line: parse, call, print. Data goes to stdout, progress and messages to stderr."""

from __future__ import annotations

import json
import re
import sys
from pathlib import Path
from typing import Any

import click

from oysterbench.__main__ import INTERRUPTED
from oysterbench.cli.compare import compare_command
from oysterbench.cli.doctor import doctor
from oysterbench.cli.download import COMMANDS as DOWNLOAD_COMMANDS
from oysterbench.cli.echo import echo, message
from oysterbench.cli.eval import eval_command
from oysterbench.cli.export import export
from oysterbench.cli.extras import extra_of
from oysterbench.cli.failures import told
from oysterbench.cli.groups import Group
from oysterbench.cli.interrupts import BEGUN, TERMINATED, Terminated, interruption
from oysterbench.cli.learn import Installed, experiment, train, translate
from oysterbench.cli.map import map_command
from oysterbench.cli.models import COMMANDS as MODEL_COMMANDS
from oysterbench.cli.numbers import Number
from oysterbench.cli.outputs import print_rich
from oysterbench.cli.publish import COMMANDS as PUBLISH_COMMANDS
from oysterbench.cli.release import COMMANDS as RELEASE_COMMANDS
from oysterbench.cli.render import frames_bar, render
from oysterbench.cli.run import run_command
from oysterbench.cli.segment import segment_command
from oysterbench.cli.sequences import SequencePath
from oysterbench.cli.splits import splits
from oysterbench.cli.systems import systems_command
from oysterbench.cli.tune import tune_command
from oysterbench.cli.values import check_values
from oysterbench.cli.view import view
from oysterbench.core.errors import OysterbenchError
from oysterbench.version import VERSION

STATES = ("live", "box", "left valve", "right valve")
"""Copy of `scene.oyster.STATES`, which is slow to load for a page of help."""

COMMANDS = Installed("oysterbench", "oysterbench.commands")

EMPTY_OPTION = re.compile(r"--[a-z][a-z-]*=")
NOT_SET = {"--from", "--key"}
"""Options whose empty value counts as not given: an empty shell variable may mean that there is no hub."""

RENAMED = {"hub-key": "keygen"}
"""Former name of a command -> present name."""


class Commands(Group):
    """Command group that turns expected failures into one line on stderr and an exit code. It includes the commands
    that packages register in the entry-point group `oysterbench.commands`."""

    def list_commands(self, context: click.Context) -> list[str]:
        return sorted({*super().list_commands(context), *COMMANDS.found()})

    def get_command(self, context: click.Context, name: str) -> click.Command | None:
        return super().get_command(context, name) or COMMANDS.get_command(context, name)

    def parse_args(self, context: click.Context, args: list[str]) -> list[str]:
        # An empty path would mean the current folder.
        for before, word in zip(["", *args], args, strict=False):
            if word == "" or EMPTY_OPTION.fullmatch(word):
                if {word.rstrip("="), before} & NOT_SET:
                    continue
                of = word.rstrip("=") or (before if before.startswith("-") else "an argument")
                raise click.UsageError(
                    f"{of}: expected a value, got an empty one: is a variable of the shell not set?", context
                )
        return super().parse_args(context, args)

    def resolve_command(
        self, context: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        if args and args[0] in RENAMED:
            context.fail(f"No such command {args[0]!r}: it is called `oysterbench {RENAMED[args[0]]}`.")
        name, command, rest = super().resolve_command(context, args)
        check_values(context, command, rest)
        return name, command, rest

    def invoke(self, context: click.Context) -> Any:
        try:
            return super().invoke(context)
        except OysterbenchError as error:
            _fail(str(error), error.exit_code)
        except KeyboardInterrupt as stop:
            what, code = ("terminated", TERMINATED) if isinstance(stop, Terminated) else ("interrupted", INTERRUPTED)
            _fail(interruption(context.invoked_subcommand or "", what, BEGUN in context.meta), code)
        except ModuleNotFoundError as error:
            extra = extra_of(error.name or "")
            if extra is None:
                raise
            _fail(
                f"{context.invoked_subcommand}: {error}; install what it needs: pip install 'oysterbench[{extra}]'", 1
            )
        except BrokenPipeError:
            raise
        except OSError as error:
            _fail(told(error), 1)


def _fail(why: str, code: int) -> None:
    message(f"oysterbench: {' '.join(why.split())}")
    sys.exit(code)


@click.group(
    cls=Commands,
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100},
    epilog="Data is kept in the folder that OYSTERBENCH_HOME names, or in the user's data folder.",
)
@click.version_option(VERSION, prog_name="oysterbench")
def main() -> None:
    """Benchmarks for underwater robots on seeded, reproducible oyster reefs.

    \b
    Examples:
      oysterbench eval slam                      a first number: render, run, score
      oysterbench eval slam --method gtsam_vi --out results
      oysterbench eval slam --truth truth.tum --estimate mine.tum --align se3
      oysterbench eval steering                  policies against an expert
      oysterbench run my_slam --command "..."    experiments: any program, many runs
      oysterbench systems                        published systems: build and run
      oysterbench tune openvins_dynamic --out tuning
      oysterbench compare ours theirs            ranks, ties, which is better where
      oysterbench train unet --data seg-train    train a learned method
      oysterbench download unet                  trained weights, from a hub
      oysterbench download slam-mini             from a hub; without one, rendered
      oysterbench render slam-mini --workers 2
      oysterbench splits                         which exist, and which are here
      oysterbench doctor                         what is missing or broken
      oysterbench info mini-01.mcap
      oysterbench view mini-01.mcap              one page to browse it
      oysterbench export mini-01.mcap --format euroc --out mini-01
      oysterbench map mini-01.mcap --trajectory poses.tum --out mini-01.ply
      oysterbench map val-01.mcap --trajectory poses.tum --masks masks --out map
      oysterbench segment dive.mp4 --out counted     oysters in your own images
      oysterbench gallery                        every recipe effect on one sheet
      oysterbench oyster --seed 7 --out oyster.glb
    """


for _command in (
    eval_command,
    run_command,
    compare_command,
    map_command,
    segment_command,
    train,
    translate,
    experiment,
    render,
    *RELEASE_COMMANDS,
    splits,
    systems_command,
    tune_command,
    *PUBLISH_COMMANDS,
    *DOWNLOAD_COMMANDS,
    *MODEL_COMMANDS,
    export,
    view,
    doctor,
):
    main.add_command(_command)


@main.command(short_help="Show what is in a sequence file.")
@click.argument("sequence", type=SequencePath())
@click.option("--json", "as_json", is_flag=True, help="Print as JSON.")
def info(sequence: Path, as_json: bool) -> None:
    """Show what is in a sequence: an MCAP file or a folder in EuRoC layout.

    \b
    Examples:
      oysterbench info mini-01.mcap
      oysterbench info mini-01.mcap --json
    """
    from oysterbench.sequence import describe

    facts = describe(sequence)
    if as_json:
        echo(json.dumps(facts, indent=2))
        return
    from rich.table import Table

    length_m = facts["path_length_m"]
    path = "no true path" if length_m is None else f"{length_m:.2f} m of path"
    echo(f"{facts['sequence']}: {facts['duration_s']:g} s, {path}")
    for key, value in facts["metadata"].items():
        echo(f"  {key}: {value}")
    for name, camera in facts["cameras"].items():
        echo(f"  {name}: {camera['width']} x {camera['height']} at {camera['rate_hz']:g} Hz")
    table = Table(box=None, pad_edge=False)
    for heading in ("topic", "type", "messages", "per second"):
        table.add_column(heading, justify="right" if heading in ("messages", "per second") else "left")
    for row in facts["topics"]:
        rate = "-" if row["rate_hz"] is None else f"{row['rate_hz']:g}"
        table.add_row(row["topic"], row["type"], str(row["messages"]), rate)
    print_rich(table)


@main.command(short_help="Render one sheet that shows every recipe effect.")
@click.option("--real", type=click.Path(path_type=Path, file_okay=False), help="Show close-ups beside real images.")
@click.option("--out", type=click.Path(path_type=Path, dir_okay=False), default="gallery.png", show_default=True)
def gallery(real: Path | None, out: Path) -> None:
    """Render one sheet of images: water, light, reef, life, sensors and faults; or close-ups beside real images.

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
    echo(out)


@main.command(short_help="Export one oyster as a mesh.")
@click.option("--seed", type=click.IntRange(min=0), default=0, show_default=True, help="Seed of the oyster.")
@click.option("--size", "size_mm", type=Number(25, 172), help="Height of the shell in mm.  [default: from the seed]")
@click.option("--state", type=click.Choice(STATES), default="live", show_default=True)
@click.option("--out", type=click.Path(path_type=Path, dir_okay=False), default="oyster.glb", show_default=True)
@click.option("--json", "as_json", is_flag=True, help="Print its measurements as JSON.")
def oyster(seed: int, size_mm: float | None, state: str, out: Path, as_json: bool) -> None:
    """Export one oyster at real size, in metres: .glb, .obj, .stl or .ply, by suffix.

    \b
    Examples:
      oysterbench oyster --seed 7 --out oyster.glb
      oysterbench oyster --seed 7 --size 110 --state box --out box.stl
    """
    from oysterbench.scene.export import export_oyster

    facts = export_oyster(seed, out, size_mm, state)
    if as_json:
        echo(json.dumps({"file": str(out), **facts}, indent=2))
        return
    height, length, width = (1000 * facts[f"{key}_m"] for key in ("height", "length", "width"))
    echo(f"{out}: {height:.0f} x {length:.0f} x {width:.0f} mm, {1e6 * facts['volume_m3']:.1f} ml")
