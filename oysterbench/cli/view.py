"""The command that shows a sequence as a page, in Rerun, or with a layout for Foxglove: parse, call, print."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from oysterbench.cli.echo import echo, message
from oysterbench.cli.numbers import Number
from oysterbench.cli.sequences import SequencePath

if TYPE_CHECKING:
    from oysterbench.report.viewer.estimates import EstimatedPath
    from oysterbench.sequence import Sequence

FILE = click.Path(path_type=Path, dir_okay=False)


@click.command(short_help="View a sequence: as a page, in Rerun, or with a layout for Foxglove.")
@click.argument("sequence", type=SequencePath())
@click.option("--start", "begin_s", type=Number(min=0), default=0.0, metavar="S", help="Start time.")
@click.option("--seconds", type=Number(min=0, min_open=True), metavar="S", help="Duration.  [default: all]")
@click.option(
    "--estimate", "estimates", type=FILE, multiple=True, help="A trajectory shown beside the true one; repeatable."
)
@click.option(
    "--align", default=None, metavar="HOW", help="How estimates are aligned to the ground truth.  [default: posyaw]"
)
@click.option("--rerun", "in_rerun", is_flag=True, help="Open Rerun's viewer; with --out, write a Rerun file.")
@click.option("--foxglove", "layout", type=FILE, help="Only write a Foxglove layout to this file.")
@click.option("--out", type=FILE, help="File.  [default: NAME.html; with --rerun none]")
def view(
    sequence: Path,
    begin_s: float,
    seconds: float | None,
    estimates: tuple[Path, ...],
    align: str | None,
    in_rerun: bool,
    layout: Path | None,
    out: Path | None,
) -> None:
    """Make one HTML page that plays a sequence: cameras with their layers, sonar fans, plots of the scalar sensors, the
    path with moving objects, and the times of faults. Or show the sequence in Rerun or Foxglove.

    \b
    Examples:
      oysterbench view mini-01.mcap
      oysterbench view mini-01.mcap --out preview.html
      oysterbench view mini-01.mcap --start 5 --seconds 10
      oysterbench view mini-01.mcap --estimate results/mini-01-gtsam_vi.tum
      oysterbench view mini-01.mcap --rerun
      oysterbench view mini-01.mcap --rerun --out mini-01.rrd --estimate mine.tum
      oysterbench view mini-01.mcap --foxglove layout.json

    The page needs no other file and no network, and stays small however long the sequence is: it shows samples of a
    long sequence, and every frame of some 10 s as a film.

    To install Rerun: pip install 'oysterbench[rerun]'. In Foxglove, open the sequence file, then load the layout with
    Layouts, Import from file; `export --format foxglove` writes both into one folder.
    """
    from oysterbench.sequence import open_sequence

    if layout is not None and (in_rerun or estimates or out or begin_s or seconds):
        raise click.UsageError("--foxglove: a layout covers a whole file and takes no other option")
    if align is not None and not estimates:
        raise click.UsageError("--align: expected an --estimate to align")
    opened = open_sequence(sequence)
    if layout is not None:
        _write_layout(opened, layout)
        return
    paths = _estimates(opened, estimates, align)
    for path in paths:
        message(f"{path.label} ({align or 'posyaw'})")
        for note in path.poses.notes:
            message(note)
    if in_rerun:
        _show(opened, paths, begin_s, seconds, out)
    else:
        _write_page(opened, paths, begin_s, seconds, out or Path(f"{opened.name}.html"))


def _write_layout(opened: Sequence, path: Path) -> None:
    from oysterbench.core.atomic import write_atomically
    from oysterbench.sequence.export.foxglove import layout_text

    write_atomically(path, layout_text(opened).encode())
    message(f"in Foxglove: open the file of {opened.name}, then Layouts, Import from file, {path.name}")
    echo(path)


def _estimates(opened: Sequence, files: tuple[Path, ...], align: str | None) -> list[EstimatedPath]:
    if not files:
        return []
    from oysterbench.evaluate.slam import SlamSettings
    from oysterbench.report.viewer.estimates import estimated_paths

    settings = SlamSettings() if align is None else SlamSettings(align=align)  # type: ignore[arg-type]  # checked there
    return estimated_paths(opened, files, settings)


def _show(
    opened: Sequence, paths: list[EstimatedPath], begin_s: float, seconds: float | None, out: Path | None
) -> None:
    from oysterbench.cli.progress import late_bar
    from oysterbench.report.viewer.page import span_of
    from oysterbench.report.viewer.recording import save_recording, show_recording

    span_ns = span_of(opened, begin_s, seconds) if begin_s or seconds else None
    with late_bar(f"logging {opened.name}", "parts") as progress:
        if out is None:
            show_recording(opened, paths, span_ns, progress)
            return
        save_recording(opened, out, paths, span_ns, progress)
    message(f"open it with: rerun {out}")
    echo(out)


def _write_page(opened: Sequence, paths: list[EstimatedPath], begin_s: float, seconds: float | None, out: Path) -> None:
    from oysterbench.cli.progress import late_bar
    from oysterbench.core.atomic import write_atomically
    from oysterbench.report.viewer import view_page

    with late_bar(f"drawing {opened.name}", "images") as progress:
        page = view_page(opened, begin_s, seconds, paths, progress)
    write_atomically(out, page.encode())
    echo(out)
