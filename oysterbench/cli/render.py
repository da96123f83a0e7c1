"""The command `render`, and the progress bars that other commands show while rendering. `cli.main` adds it."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING

import click

from oysterbench.cli.echo import echo, message
from oysterbench.core.names import listed
from oysterbench.notebook.progress import frames_bar, plain_progress
from oysterbench.notebook.rendering import render_files

if TYPE_CHECKING:
    from oysterbench.recipe import SplitRecipe

__all__ = ["frames_bar", "plain_progress", "render", "render_files"]

FOLDER = click.Path(path_type=Path, file_okay=False)
FILE = click.Path(path_type=Path, dir_okay=False)


@click.command(short_help="Render a split into sequence files.")
@click.argument("split_name", metavar="SPLIT")
@click.option("--sequence", "names", multiple=True, metavar="NAME", help="Only this sequence; repeatable.")
@click.option("--topics", multiple=True, metavar="GLOB", help="Only these topics, in smaller files; repeatable.")
@click.option(
    "--workers",
    type=click.IntRange(min=1),
    help="Rendering processes.  [default: one per core; one if there is little to render]",
)
@click.option("--scheduler", metavar="ADDRESS", help="Render on the workers of a Dask scheduler instead.")
@click.option("--device", default="cpu", show_default=True, help="Device to render on: cpu, cuda or cuda:N.")
@click.option("--salt-file", type=FILE, help="Secret of a hidden split.  [default: OYSTERBENCH_SALT_FILE]")
@click.option("--out", type=FOLDER, help="Folder.  [default: under the home folder]")
@click.option("--preview", "as_preview", is_flag=True, help="Render only contact sheets of small frames, in seconds.")
@click.option("--json", "as_json", is_flag=True, help="Print the files as JSON.")
def render(
    split_name: str,
    names: tuple[str, ...],
    topics: tuple[str, ...],
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
      oysterbench render slam-val --topics '/cam_left/*' --topics /imu --topics '/truth/*'
      oysterbench render my-reef.toml --workers 4 --out data
      oysterbench render my-reef.toml --preview
      oysterbench render slam-val --scheduler tcp://10.0.0.1:8786
      oysterbench render slam-test --salt-file secret/slam-test.salt --out secret/slam-test

    May be interrupted at any time, even killed; the same command resumes at the same frame. Files that are there
    already are kept and not read through: `oysterbench verify FILE` finds damage done later. Any number of workers,
    here or on a cluster, gives the same bytes. With --topics, cameras and sonars that make none of them are not
    rendered, and the smaller files go to a folder of their own. Frames that files under the home folder already have,
    complete or rendered with other --topics, are copied from these, except for complete files with --out. A hidden
    split needs its salt, read from a file or from OYSTERBENCH_SALT because others can see the command line; its preview
    shows the split without the salt.
    """
    from oysterbench.recipe import load_split, split_names

    if workers is not None and scheduler is not None:
        raise click.UsageError("--workers and --scheduler cannot be combined: a cluster has its own workers")
    if as_preview and topics:
        raise click.UsageError("--preview shows images of each camera: it takes no --topics")
    split = load_split(split_name)
    from oysterbench.simulation.generate import digest  # slow to load: only once the split is known to exist
    from oysterbench.simulation.salt import salt_for

    if as_preview:
        files = _preview(split, names, out or Path("."))
    else:
        salt = salt_for(split.name, split.hidden, salt_file)
        files = render_files(split, out, workers, names, salt, device, scheduler, topics=topics)
    if as_json:
        echo(json.dumps({"split": split.name, "files": {k: str(v) for k, v in files.items()}}, indent=2))
    else:
        for path in files.values():
            echo(path)
    if split_name in split_names() and not split.hidden and not as_preview:
        _compare(split, files, digest(split))


def _compare(split: SplitRecipe, files: dict[str, Path], made_by: str) -> None:
    """Report whether the files are the same as those of the release."""
    from oysterbench.cli.progress import bytes_bar
    from oysterbench.hub.manifest import partial_manifest, released_manifest
    from oysterbench.hub.verify import RIGHT, SMALLER, check_released

    name = f"{split.name} {split.version}"
    manifest = released_manifest(split.name, split.version) or partial_manifest(split.name, split.version)
    if manifest is None:
        message(f"{name}: no released manifest, so nothing was compared")
        return
    if manifest.recipe_digest != made_by:
        message(f"{name} was released with another recipe or generation than the one rendered here")
        return
    named = [path for sequence, path in files.items() if manifest.find(f"{sequence}.mcap")]
    if missing := [sequence for sequence in files if manifest.find(f"{sequence}.mcap") is None]:
        message(f"{name}: its manifest is not complete yet, so {listed(missing)} could not be compared")
    if not named:
        return
    done, total, checks = 0, sum(path.stat().st_size for path in named), []
    with bytes_bar(f"comparing {split.name} with the release") as progress:
        for path in named:
            check = check_released(path, manifest)
            checks.append(check)
            if check.state not in (RIGHT, SMALLER):
                message(f"{path}: {check.state} ({check.detail})")
            done += path.stat().st_size
            progress(done, total)
    other = sum(check.state not in (RIGHT, SMALLER) for check in checks)
    wrong = sum(not check.good for check in checks)
    some = {f" ({check.detail})" for check in checks if check.state == SMALLER}
    if wrong:
        message(f"{name}: {wrong} of {len(named)} files differ from the release: results from them cannot be compared")
    elif other:
        message(f"{name}: {other} of {len(named)} files can be used, though they differ from the release as said above")
    else:
        message(f"{name}: as released, {len(named)} of {len(split.sequence)} files{' '.join(some)}")


def _preview(split: SplitRecipe, names: tuple[str, ...], folder: Path) -> dict[str, Path]:
    from oysterbench.simulation.gallery import preview, write_picture

    files = {}
    for sequence in [split.find_sequence(name) for name in names] or split.sequence:
        with frames_bar(f"previewing {sequence.name}") as progress:
            picture = preview(split, sequence.name, progress)
        files[sequence.name] = folder / f"{split.name}-{sequence.name}-preview.png"
        write_picture(files[sequence.name], picture)
    return files
