"""The command that renders, and what others show while something is rendered. `cli` takes it in."""

from __future__ import annotations

import json
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import click

from oysterbench.cli.echo import echo, message

if TYPE_CHECKING:
    from oysterbench.recipe import SequenceRecipe, SplitRecipe
    from oysterbench.simulation.generate import Progress

FOLDER = click.Path(path_type=Path, file_okay=False)
FILE = click.Path(path_type=Path, dir_okay=False)
TELL_S = 300.0  # between two lines on the progress, at most
TOLD_FROM_S = 60.0  # what rendering will take is said before it begins, from so much on


@click.command(short_help="Render a split into sequence files.")
@click.argument("split_name", metavar="SPLIT")
@click.option("--sequence", "names", multiple=True, metavar="NAME", help="Only this sequence; repeatable.")
@click.option(
    "--workers",
    type=click.IntRange(min=1),
    help="Processes that render.  [default: one per core; one where there is little to render]",
)
@click.option("--scheduler", metavar="ADDRESS", help="Render on the workers of a Dask scheduler instead.")
@click.option("--device", default="cpu", show_default=True, help="cpu, cuda, or cuda:N, where it is rendered.")
@click.option("--salt-file", type=FILE, help="Secret of a hidden split.  [default: OYSTERBENCH_SALT_FILE]")
@click.option("--out", type=FOLDER, help="Folder.  [default: under the home]")
@click.option("--preview", "as_preview", is_flag=True, help="Only contact sheets of small frames, in seconds.")
@click.option("--json", "as_json", is_flag=True, help="Print the files as JSON.")
def render(
    split_name: str,
    names: tuple[str, ...],
    workers: int | None,
    scheduler: str | None,
    device: str,
    salt_file: Path | None,
    out: Path | None,
    as_preview: bool,
    as_json: bool,
) -> None:
    """Render a split: a name from `oysterbench splits`, or the path of a .toml recipe.

    \b
    Examples:
      oysterbench render slam-mini
      oysterbench render slam-train --sequence train-03 --sequence train-07
      oysterbench render my-reef.toml --workers 4 --out data
      oysterbench render my-reef.toml --preview
      oysterbench render slam-val --scheduler tcp://10.0.0.1:8786
      oysterbench render slam-test --salt-file secret/slam-test.salt --out secret/slam-test

    May be interrupted at any time, even killed; the same command goes on from there, to the frame. Any number of
    workers, here or on a cluster, gives the same bytes. A hidden split needs its salt, which is read from a file or
    from OYSTERBENCH_SALT, as a command line can be read by others; its preview shows how it looks without one.
    """
    from oysterbench.recipe import load_split
    from oysterbench.simulation.salt import salt_for

    if workers is not None and scheduler is not None:
        raise click.UsageError("--workers and --scheduler exclude each other: a cluster's workers are its own")
    split = load_split(split_name)
    if as_preview:
        files = _preview(split, names, out or Path("."))
    else:
        salt = salt_for(split.name, split.hidden, salt_file)
        files = render_files(split, out, workers, names, salt, device, scheduler)
    if as_json:
        echo(json.dumps({"split": split.name, "files": {k: str(v) for k, v in files.items()}}, indent=2))
    else:
        for path in files.values():
            echo(path)


def render_files(
    split: SplitRecipe,
    folder: Path | None = None,
    workers: int | None = None,
    names: tuple[str, ...] = (),
    salt: bytes = b"",
    device: str = "cpu",
    scheduler: str | None = None,
) -> dict[str, Path]:
    """The sequence files of a split, rendered with a progress bar where they are not there yet."""
    from oysterbench.simulation import cost
    from oysterbench.simulation.generate import check_workers, default_workers, generate_split, split_folder

    folder = folder or split_folder(split, salt, device)
    missing = _missing(split, folder, names)
    if workers is None:
        workers = default_workers(sum(cost.estimated(split, sequence) for sequence in missing))
    workers = check_workers(workers)
    if scheduler is None and device == "cpu":
        _announce(split, missing, workers)
    with frames_bar(f"rendering {split.name}") as progress:
        return generate_split(split, folder, workers, progress, salt, device, scheduler, names)


def _missing(split: SplitRecipe, folder: Path, names: tuple[str, ...]) -> list[SequenceRecipe]:
    """The sequences that are asked for and not there yet."""
    from oysterbench.simulation.generate import sequence_files

    files = sequence_files(split, folder)
    wanted = [sequence for sequence in split.sequence if not names or sequence.name in names]
    return [sequence for sequence in wanted if not files[sequence.name].exists()]


def _announce(split: SplitRecipe, missing: list[SequenceRecipe], workers: int) -> None:
    """Say what rendering will take, where it is minutes."""
    from oysterbench.simulation import cost

    seconds = sum(cost.estimated(split, sequence, workers) for sequence in missing) / workers
    if seconds > TOLD_FROM_S:
        what = missing[0].name if len(missing) == 1 else f"{len(missing)} sequences"
        on = f"{workers} worker{'s' if workers > 1 else ''}"
        message(f"rendering {split.name}: {what} will take about {_time(seconds)} on {on}")


def _preview(split: SplitRecipe, names: tuple[str, ...], folder: Path) -> dict[str, Path]:
    from oysterbench.simulation.gallery import preview, write_picture

    files = {}
    for sequence in [split.find_sequence(name) for name in names] or split.sequence:
        with frames_bar(f"previewing {sequence.name}") as progress:
            picture = preview(split, sequence.name, progress)
        files[sequence.name] = folder / f"{split.name}-{sequence.name}-preview.png"
        write_picture(files[sequence.name], picture)
    return files


@contextmanager
def frames_bar(title: str, unit: str = "frames") -> Iterator[Progress]:
    """A progress bar on a terminal, else a line at every tenth or few minutes; both on stderr, with the time left.

    Nothing is shown before it is told of anything.
    """
    from rich.console import Console
    from rich.progress import (
        BarColumn,
        MofNCompleteColumn,
        Progress,
        TextColumn,
        TimeElapsedColumn,
        TimeRemainingColumn,
    )

    console = Console(stderr=True)
    if not console.is_terminal:
        yield plain_progress(title, unit)
        return
    columns = (TextColumn(title), BarColumn(), MofNCompleteColumn(), TextColumn(unit))
    with Progress(*columns, TimeElapsedColumn(), TextColumn("left"), TimeRemainingColumn(), console=console) as bar:

        def update(done: int, total: int) -> None:
            if not bar.tasks:  # begun with what was there before, so that it does not count as fast work
                bar.add_task(title, total=total, completed=done)
            bar.update(bar.tasks[0].id, completed=done, total=total)

        yield update


def plain_progress(title: str, unit: str = "frames") -> Progress:
    """Progress as lines on stderr: at every tenth, and every few minutes."""
    first, told, began, at = -1, -1, 0.0, 0.0

    def tell(done: int, total: int) -> None:
        nonlocal first, told, began, at
        now = time.monotonic()
        if first < 0:
            first, began = done, now
        tenth = 10 * done // max(total, 1)
        if tenth <= told and now < at + TELL_S:
            return
        told, at = tenth, now
        left = f", {_time((now - began) * (total - done) / (done - first))} left" if first < done < total else ""
        message(f"{title}: {f'{done} of {total} {unit}'.rstrip()}{left}")

    return tell


def _time(seconds: float) -> str:
    """A time in words: 50 s, 12 min, 3 h 20 min."""
    if seconds < 90:
        return f"{seconds:.0f} s"
    hours, minutes = divmod(round(seconds / 60), 60)
    return f"{hours} h {minutes} min" if hours else f"{minutes} min"
