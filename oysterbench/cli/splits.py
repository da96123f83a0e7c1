"""The command `splits`: which splits exist, which are here, and how large they are. `cli.main` adds it."""

from __future__ import annotations

import json
from collections.abc import Collection, Iterable, Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import click

from oysterbench.cli.echo import echo

if TYPE_CHECKING:
    from oysterbench.hub.manifest import Manifest
    from oysterbench.recipe import SplitRecipe
    from oysterbench.report.table import Table


@dataclass(frozen=True)
class SplitRow:
    """A version of a split. size_bytes: size of its complete files that are here; full_bytes: its total size, None if
    neither a manifest nor a complete set of files tells; duration_s: None if only the hub knows the split; hub_bytes:
    size on the hub, None if it was not asked or does not have it."""

    name: str
    version: str
    track: str
    sequences: int
    duration_s: float | None
    here: int  # number of sequences here
    size_bytes: int
    full_bytes: int | None
    complete: bool
    hidden: bool
    folder: str | None
    summary: str
    hub_bytes: int | None = None

    @property
    def state(self) -> str:
        """How much of it is here, in words."""
        full = "" if self.full_bytes is None else f"{self.full_bytes / 1e6:.0f} MB"
        if self.complete:
            return full
        if self.here:
            of = f"{self.size_bytes / 1e6:.0f} of {full}" if full else f"{self.size_bytes / 1e6:.0f} MB"
            return f"{self.here} of {self.sequences} ({of})"
        return f"no ({full})" if full else "no"


@click.command(short_help="List what can be rendered or downloaded, and what is here.")
@click.argument("name", metavar="[SPLIT]", required=False)
@click.option("--hub", "ask_hub", is_flag=True, help="Also ask the hub for its splits and their sizes.")
@click.option("--from", "places", multiple=True, metavar="URL", help="Address or folder of a hub; implies --hub.")
@click.option("--key", help="Public key of the hub.  [default: OYSTERBENCH_HUB_KEY]")
@click.option("--json", "as_json", is_flag=True, help="Print as JSON.")
def splits(name: str | None, ask_hub: bool, places: tuple[str, ...], key: str | None, as_json: bool) -> None:
    """List the splits: what they contain, which are on this machine, and how large they are.

    With a SPLIT (a name or the path of a .toml recipe): its sequences, their conditions, and their rendering cost.

    \b
    Examples:
      oysterbench splits
      oysterbench splits --hub
      oysterbench splits --json
      oysterbench splits slam-val

    Without --hub, no network is used.
    """
    from oysterbench.recipe import load_split, split_names

    if name is not None:
        if ask_hub or places:
            raise click.UsageError("SPLIT and --hub cannot be combined: a hub lists splits, a recipe lists sequences")
        split = load_split(name)
        if name.endswith(".toml"):
            from oysterbench.scene.vehicle import check_cameras

            for sequence in split.sequence:  # as rendering does, at its beginning
                check_cameras(split.rig_of(sequence), f"split {split.name}: sequence {sequence.name}")
        _print_sequences(split, as_json)
        return
    from oysterbench.simulation.generate import split_folder

    known = {split_folder(split): split for split in map(load_split, split_names())}
    kept = list(_kept(known))
    # A downloaded split is listed once, even if this version would keep its own renders in another folder.
    downloaded = {(row.name, row.version) for row in kept}
    rows = [row for row in _known(known) if row.here or (row.name, row.version) not in downloaded] + kept
    if ask_hub or places:
        rows = list(_with_hub(rows, places, key))
    if as_json:
        echo(json.dumps({"splits": [asdict(row) for row in rows]}, indent=2))
        return
    from oysterbench.cli.outputs import print_table

    print_table(splits_table(rows, bool(ask_hub or places)))


def splits_table(rows: Iterable[SplitRow], with_hub: bool = False) -> Table:
    """Table with a row for each split; with_hub: whether a hub was asked."""
    from oysterbench.report.table import Column, Table, TableRow

    columns = (
        Column("split", "split"),
        Column("track", "track", wide=True),
        Column("sequences", "sequences", kind="number", wide=True),
        Column("duration_s", "seconds", kind="number", wide=True),
        Column("here", "here"),
        *((Column("hub", "hub"),) if with_hub else ()),
        Column("summary", "what"),
    )
    cells = []
    for row in rows:
        of_hub = ("no" if row.hub_bytes is None else f"{row.hub_bytes / 1e6:.0f} MB",) if with_hub else ()
        head = (f"{row.name} {row.version}", row.track, row.sequences, row.duration_s, row.state)
        cells.append((*head, *of_hub, row.summary))
    return Table("", columns, tuple(map(TableRow, cells)))


def _print_sequences(split: SplitRecipe, as_json: bool) -> None:
    from oysterbench.cli.outputs import print_table
    from oysterbench.report.recipes import sequences_table
    from oysterbench.report.renderers.json import json_rows

    table = sequences_table(split)
    if as_json:
        echo(json.dumps({"split": split.name, "sequences": json_rows(table)}, indent=2))
    else:
        print_table(table)


def _known(splits: dict[Path, SplitRecipe]) -> Iterator[SplitRow]:
    """Yield the splits that this version can render. splits: folder -> split."""
    from oysterbench.hub.manifest import released_manifest
    from oysterbench.hub.verify import kept_manifest
    from oysterbench.simulation.generate import sequence_files

    for folder, split in splits.items():
        files = [path for path in sequence_files(split, folder).values() if path.is_file()]
        size = sum(path.stat().st_size for path in files)
        complete = len(files) == len(split.sequence)
        manifest = kept_manifest(folder) or released_manifest(split.name, split.version)
        full = size if complete else manifest.size if manifest else None
        yield SplitRow(
            name=split.name,
            version=split.version,
            track=split.track,
            sequences=len(split.sequence),
            duration_s=sum(sequence.duration_s for sequence in split.sequence),
            here=len(files),
            size_bytes=size,
            full_bytes=full,
            complete=complete,
            hidden=split.hidden,
            folder=str(folder) if files else None,
            summary=split.summary,
        )


def _kept(rendered: Collection[Path]) -> Iterator[SplitRow]:
    """Yield downloaded splits that this version would render differently, or not at all."""
    from oysterbench.core.places import home
    from oysterbench.hub.verify import kept_manifest

    for folder in sorted((home() / "splits").glob("*/*")):
        manifest: Manifest | None = kept_manifest(folder) if folder.is_dir() and folder not in rendered else None
        if manifest is None:
            continue
        here = [entry for entry in manifest.files if _is_whole(folder / entry.name, entry.size)]
        yield SplitRow(
            name=manifest.split,
            version=manifest.version,
            track=manifest.track,
            sequences=len(manifest.files),
            duration_s=sum(entry.duration_ns for entry in manifest.files) * 1e-9,
            here=len(here),
            size_bytes=sum(entry.size for entry in here),
            full_bytes=manifest.size,
            complete=len(here) == len(manifest.files),
            hidden=manifest.hidden,
            folder=str(folder),
            summary=manifest.summary,
        )


def _with_hub(rows: list[SplitRow], places: tuple[str, ...], key: str | None) -> Iterator[SplitRow]:
    """Yield the rows, with sizes from the hub where unknown, then the hub's other splits."""
    from dataclasses import replace

    from oysterbench.core.errors import HubError
    from oysterbench.hub.download import Hub
    from oysterbench.hub.settings import NAME_ONE, NO_HUB, hub_key, hub_places

    hub_at = hub_places(places)
    if not hub_at:
        raise HubError(f"{NO_HUB}; {NAME_ONE}")
    index = Hub.at(hub_at, hub_key(key)).index()
    releases = {(name, version): release for name, known in index.splits.items() for version, release in known.items()}
    for row in rows:
        release = releases.pop((row.name, row.version), None)
        size = release.size if release else None
        yield replace(row, full_bytes=size if row.full_bytes is None else row.full_bytes, hub_bytes=size)
    for (name, version), release in releases.items():
        yield SplitRow(
            name=name,
            version=version,
            track=release.track,
            sequences=release.sequences,
            duration_s=None,
            here=0,
            size_bytes=0,
            full_bytes=release.size,
            complete=False,
            hidden=release.hidden,
            folder=None,
            summary=release.summary,
            hub_bytes=release.size,
        )


def _is_whole(path: Path, size: int) -> bool:
    return path.is_file() and path.stat().st_size == size
