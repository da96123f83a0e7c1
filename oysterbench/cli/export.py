"""The command that exports sequences and labelled sets in other formats: parse, call, print."""

from __future__ import annotations

import json
from pathlib import Path

import click

from oysterbench.cli.echo import echo, message
from oysterbench.core.errors import NoTruthError, OptionError, SequenceError


class ExportCommand(click.Command):
    """Command whose own help lists the formats; loading them would take too long for `oysterbench --help`."""

    def format_epilog(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        from oysterbench.annotations.export import SET_FORMATS
        from oysterbench.sequence.export import FORMATS

        with formatter.section("Formats of a sequence"):
            formatter.write_dl(list(FORMATS.items()))
        with formatter.section("Formats of labelled images"):
            formatter.write_dl(list(SET_FORMATS.items()))


def _known_format(ctx: click.Context, parameter: click.Parameter, value: str) -> str:
    from oysterbench.annotations.export import SET_FORMATS
    from oysterbench.core.names import instead
    from oysterbench.sequence.export import FORMATS

    known = [*FORMATS, *SET_FORMATS]
    if value not in known:
        raise click.BadParameter(f"{value!r} is not a format; {instead(value, known, 'oysterbench export --help')}.")
    return value


@click.command(cls=ExportCommand, short_help="Export a sequence or labelled images: EuRoC, KITTI, ROS bag, YOLO, ...")
@click.argument("what", nargs=-1, required=True, metavar="SEQUENCE|SPLIT...")
@click.option("--format", "form", metavar="FORMAT", callback=_known_format, required=True, help="What to write.")
@click.option("--out", type=click.Path(path_type=Path), required=True, help="New folder; it must not exist yet.")
@click.option("--truth/--no-truth", default=True, show_default=True, help="With or without what methods may not see.")
@click.option("--json", "as_json", is_flag=True, help="Print the folder and notes as JSON.")
def export(what: tuple[str, ...], form: str, out: Path, truth: bool, as_json: bool) -> None:
    """Export a sequence, or the labelled images of splits, in another format.

    \b
    Examples:
      oysterbench export mini-01.mcap --format euroc --out mini-01-euroc
      oysterbench export mini-01.mcap --format euroc --out for-a-method --no-truth
      oysterbench export mini-01.mcap --format tum --out mini-01-tum
      oysterbench export mini-01.mcap --format coco --out mini-01-coco
      oysterbench export mini-01.mcap --format rosbag --out mini-01-bag
      oysterbench export mini-01.mcap --format mcap --out for-ros2 --no-truth
      oysterbench export mini-01.mcap --format foxglove --out for-foxglove
      oysterbench export seg-train seg-val --format yolo --out oysters-yolo
      oysterbench export seg-train seg-val --format parquet --out oysters-hf
      oysterbench export seg-train --format webdataset --out oysters-tars

    A sequence is a file (.mcap) or a folder in EuRoC layout. Labelled images come from splits, which are rendered if
    missing, recipes (.toml), sequence files, or folders with images and labels. Sides that they state are parts;
    else a name such as reef-train, reef-val (or valid), reef_test or test says which part its images belong to.

    The folder is written completely or not at all; an interrupted export leaves nothing and starts again.
    """
    from oysterbench.annotations.export import SET_FORMATS

    folder, notes = _export_sets(what, form, out, truth) if form in SET_FORMATS else _export_one(what, form, out, truth)
    if as_json:
        echo(json.dumps({"folder": str(folder), "format": form, "notes": notes}, indent=2))
        return
    for note in notes:
        message(note)
    echo(folder)


def _export_one(what: tuple[str, ...], form: str, out: Path, truth: bool) -> tuple[Path, list[str]]:
    from oysterbench.annotations.export import SET_FORMATS
    from oysterbench.cli.progress import late_bar
    from oysterbench.recipe import split_names
    from oysterbench.sequence import open_sequence
    from oysterbench.sequence.export import export_sequence

    sets = ", ".join(SET_FORMATS)
    if len(what) > 1:
        raise OptionError(f"the format {form} takes one sequence, got {len(what)}; for several, use {sets}")
    if what[0] in split_names() and not Path(what[0]).exists():
        raise SequenceError(
            f"{what[0]} is a split, but the format {form} takes one sequence: expected its file (.mcap), as printed by "
            f"`oysterbench download {what[0]}`; for whole splits, use {sets}"
        )
    opened = open_sequence(Path(what[0]))
    with late_bar(f"exporting {opened.name}", "images") as progress:
        try:
            return export_sequence(opened, form, out, truth, progress)
        except NoTruthError as error:
            raise SequenceError(f"{error}; --no-truth exports it without") from None


def _export_sets(what: tuple[str, ...], form: str, out: Path, truth: bool) -> tuple[Path, list[str]]:
    from oysterbench.annotations.export import export_set
    from oysterbench.cli.labelled import open_data
    from oysterbench.cli.progress import late_bar

    if not truth:
        raise OptionError(f"--no-truth: the format {form} needs labels, which are ground truth")
    sets = [open_data(name) for name in what]
    with late_bar(f"exporting {', '.join(one.name for one in sets)}", "images") as progress:
        return export_set(sets, form, out, progress)
