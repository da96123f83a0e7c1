"""Commands for users of a hub: `download` and `verify`: parse, call, print. `cli.main` adds them."""

from __future__ import annotations

import json
import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from oysterbench.cli.echo import echo, message
from oysterbench.cli.models import download_model, model_path, part_of_oysterbench
from oysterbench.core.errors import HubError, IntegrityError, NetworkError, NotOnHubError, SilentError

if TYPE_CHECKING:
    from oysterbench.hub.download import Hub
    from oysterbench.hub.manifest import FileEntry, Manifest
    from oysterbench.hub.model import Model
    from oysterbench.hub.weights import Here
    from oysterbench.recipe import SplitRecipe

FOLDER = click.Path(path_type=Path, file_okay=False)


@click.command(short_help="Download a split or trained weights from a hub; without a hub, render the split.")
@click.argument("name", metavar="SPLIT|MODEL")
@click.option("--from", "places", multiple=True, metavar="URL", help="Address or folder of a hub; repeat for mirrors.")
@click.option("--key", help="Public key of the hub.  [default: OYSTERBENCH_HUB_KEY]")
@click.option("--sequence", "patterns", multiple=True, metavar="GLOB", help="Only these sequences; repeatable.")
@click.option("--topics", multiple=True, metavar="GLOB", help="Only these topics, in a smaller file; repeatable.")
@click.option("--out", type=FOLDER, help="Folder.  [default: under the home folder]")
@click.option("--connections", type=click.IntRange(1, 32), default=4, show_default=True, help="Connections at once.")
@click.option("--dry-run", is_flag=True, help="Only show what is here and what is not.")
@click.option("--verify", "check", is_flag=True, help="Read every file again afterwards, and repair damaged ones.")
@click.option("--again", is_flag=True, help="Replace weights trained here.")
@click.option("--json", "as_json", is_flag=True, help="Print the files as JSON.")
@click.pass_context
def download(
    context: click.Context,
    name: str,
    places: tuple[str, ...],
    key: str | None,
    patterns: tuple[str, ...],
    topics: tuple[str, ...],
    out: Path | None,
    connections: int,
    dry_run: bool,
    check: bool,
    again: bool,
    as_json: bool,
) -> None:
    """Download a split or trained weights: NAME or NAME@VERSION. Every byte is checked; a file appears once it is
    complete.

    \b
    Examples:
      oysterbench download slam-val --from https://hub.example.org --key 9f86d0...
      oysterbench download slam-val --from /mnt/hub --sequence 'val-0*'
      oysterbench download slam-val --topics /imu --topics '/cam_left/*' --out small
      oysterbench download slam-val --dry-run
      oysterbench download unet    trained weights; `oysterbench models --hub` lists them

    May be interrupted at any time, even killed; the same command resumes. Without a hub (--from, OYSTERBENCH_HUB or
    hub.toml in the home folder), a split is rendered instead, with the same bytes. Released splits, whose manifests are
    part of oysterbench, need no key, and of what is here already no hub is asked. Weights trained here are replaced
    only with --again.
    """
    from oysterbench.hub.download import Hub, choose, download, find_here
    from oysterbench.hub.settings import hub_key, hub_places
    from oysterbench.hub.sources import is_offline
    from oysterbench.hub.trusted import is_trusted

    name, _, version = name.partition("@")
    split = _known_split(name, version)
    version = version or (split.version if split else "")
    split_name = split.name if split else name
    hub_at = hub_places(places)
    # Local data needs no network: a released version never changes. But a manifest from elsewhere may be anybody's.
    found = None if check else find_here(split_name, version or None, patterns, out)
    vouched = found is None or not hub_at or is_offline() or is_trusted(found[1])
    here, unvouched = (found, None) if vouched or found is None else (None, found[0])
    ours = None if split or out else part_of_oysterbench(name, version)
    if ours and (not hub_at or is_offline()):  # a hub may have newer ones, or others of the same version
        message(f"nothing to download: {ours.described}, is part of oysterbench; a hub may have others: --from URL")
        _print_ours(name, ours, as_json)
        return
    try:
        model = None if here or unvouched or split else _model(name, version, hub_at, key, out, connections)
    except (NotOnHubError, SilentError) as error:
        if ours is None or patterns or topics:
            raise
        message(f"{error}; {ours.described}, is part of oysterbench, and methods run on it")
        _print_ours(name, ours, as_json)
        return
    if model is not None:
        if patterns or topics:
            raise click.UsageError(f"--sequence and --topics apply to splits; {name} is trained weights")
        download_model(*model, out, dry_run, again, as_json)
        return
    if here is None and not hub_at:
        _render_instead(context, split, name, patterns, topics, out, dry_run, check, as_json)
        return
    with _telling_of(unvouched), _or_rendered(split):
        hub = Hub([], None) if here else Hub.at(hub_at, hub_key(key), message, connections=connections)
        folder, manifest = here or (None, hub.manifest(split_name, version or None))
    folder = folder or out or _folder(split, manifest)
    entries = choose(manifest, patterns)
    if dry_run:
        _print_plan(manifest, _planned(hub, manifest, entries, folder, topics, out), as_json)
        return
    from oysterbench.cli.progress import bytes_bar

    doing = "downloading and verifying" if check else "downloading"
    with _or_rendered(split), bytes_bar(f"{doing} {split_name}") as progress:
        if topics:
            from oysterbench.hub.topics import fetch_topics

            files = fetch_topics(hub, entries, folder, topics, out, progress, check)
        else:
            files = download(hub, manifest, folder, entries, check, progress)
    _print_files(files, manifest.split, as_json)


def _print_ours(name: str, ours: Here, as_json: bool) -> None:
    """Print the path of weights that are part of oysterbench."""
    echo(json.dumps({"model": name, "file": str(ours.path), "sha256": ours.sha256}) if as_json else ours.path)


@contextmanager
def _telling_of(folder: Path | None) -> Iterator[None]:
    """Where a hub gives no manifest, add to its error that the files are here, in a folder whose manifest no key
    vouches for. Not to an IntegrityError: a hub that gives wrong bytes is no reason to believe such a folder instead.
    """
    try:
        yield
    except IntegrityError:
        raise
    except HubError as error:
        if folder is None:
            raise
        raise type(error)(
            f"{error}; the files are in {folder}, by a manifest that no key vouches for here: OYSTERBENCH_OFFLINE=1 "
            "uses them"
        ) from None


@contextmanager
def _or_rendered(split: SplitRecipe | None) -> Iterator[None]:
    """Where a hub cannot give a split, add to its error what renders it here, if its recipe is known."""
    try:
        yield
    except (NotOnHubError, NetworkError) as error:
        if split is None or split.hidden:
            raise
        raise type(error)(f"{error}; `oysterbench render {split.name}` makes the same files") from None


def _model(
    name: str, version: str, hub_at: list[str], key: str | None, out: Path | None, connections: int
) -> tuple[Hub, Model] | None:
    """Find trained weights by name. Returns the hub that has them and their entry; None if the name may be a split's.

    Raises HubError, with what to type, where the name is that of weights and no hub is set.
    """
    from oysterbench.hub.download import Hub
    from oysterbench.hub.settings import NAME_ONE, NO_HUB, hub_key
    from oysterbench.hub.sources import is_offline
    from oysterbench.hub.weights import weights_here
    from oysterbench.methods.weights import find_weights, weights_names
    from oysterbench.recipe import split_names

    if name in split_names():
        return None
    path = model_path(name, out)
    here = weights_here(path)
    # As for a split: a version that is here needs no network, nor does the newest one when offline.
    if here and here.model and (here.model.version == version or (not version and is_offline())):
        return Hub([], None), here.model
    known = name in weights_names()
    if not hub_at:
        if here is not None:
            raise HubError(f"{name}: {NO_HUB}; {NAME_ONE}; found here: {here.described}")
        if known:
            weights = find_weights(name)
            raise HubError(
                f"{name}: {NO_HUB}; {NAME_ONE}; or `oysterbench train {weights.train}` trains them on your machine "
                f"({weights.takes})"
            )
        return None
    hub = Hub.at(hub_at, hub_key(key), message, connections=connections)
    return (hub, hub.model(name, version or None)) if known or hub.has_model(name) else None


def _known_split(name: str, version: str) -> SplitRecipe | None:
    """Recipe of a split, if this installation knows it in this version; a hub may have others."""
    from oysterbench.recipe import load_split, split_names

    if not name.endswith(".toml") and name not in split_names():
        return None
    split = load_split(name)
    return split if version in ("", split.version) else None


def _folder(split: SplitRecipe | None, manifest: Manifest) -> Path:
    """Folder where a split is kept: that of rendered splits if rendering here would give the same files."""
    from oysterbench.core.places import home
    from oysterbench.simulation.generate import digest, split_folder

    if split is not None and manifest.recipe_digest == digest(split):
        return split_folder(split)
    if split is not None and not manifest.hidden:
        message(
            f"{manifest.split} {manifest.version} on the hub was made by another recipe or version: it is stored "
            "separately"
        )
    return home() / "splits" / manifest.split / f"{manifest.version}-{manifest.sha256[:12]}"


def _render_instead(
    context: click.Context,
    split: SplitRecipe | None,
    name: str,
    patterns: tuple[str, ...],
    topics: tuple[str, ...],
    out: Path | None,
    dry_run: bool,
    check: bool,
    as_json: bool,
) -> None:
    """Without a hub, render the split, which gives the same bytes; with `check`, damaged files make way."""
    from oysterbench.core.names import did_you_mean, nearest
    from oysterbench.hub.download import choose_names
    from oysterbench.hub.settings import NAME_ONE, NO_HUB
    from oysterbench.methods.weights import weights_names
    from oysterbench.recipe.split import split_names
    from oysterbench.sequence.cut import topics_folder
    from oysterbench.simulation.generate import split_folder
    from oysterbench.simulation.jobs import wanted_topics

    if split is None:
        meant = did_you_mean(nearest(name.partition("@")[0], [*split_names(), *weights_names()]))
        raise HubError(
            f"{name}: {NO_HUB}, and no split of this name and version can be rendered here; {meant}`oysterbench "
            f"splits` and `oysterbench models` list what there is without a hub; {NAME_ONE}"
        )
    if split.hidden:
        raise HubError(f"{name}: {NO_HUB}, and a hidden split cannot be rendered without its salt; {NAME_ONE}")
    known = [sequence.name for sequence in split.sequence]
    names = choose_names(known, patterns, f"{split.name} {split.version}", f"oysterbench splits {name}")
    found = [wanted_topics(split, split.find_sequence(each), topics) for each in names]
    if dry_run:
        some = f", {len(found[0])} topics of each" if topics else ""
        message(f"{NO_HUB}: of {split.name} {split.version} would be rendered: {', '.join(names)}{some}")
        return
    message(f"{NO_HUB}: {split.name} {split.version} is rendered instead, which gives the same bytes")
    group = context.find_root().command
    assert isinstance(group, click.Group)
    whole = split_folder(split)
    folders = {out or (topics_folder(whole, topics) if topics else whole)}
    folders |= {whole} if topics else set()  # from whose files smaller ones are cut
    paths = [folder / f"{each}.mcap" for folder in folders for each in names]
    with _aside(split, paths, [whole] if topics else [], check):
        context.invoke(
            group.commands["render"], split_name=name, names=tuple(names), topics=topics, out=out, as_json=as_json
        )


@contextmanager
def _aside(split: SplitRecipe, paths: Sequence[Path], kept: Sequence[Path], check: bool) -> Iterator[None]:
    """Where `check` is set, set damaged files of a split aside, under hidden names, while others are made in their
    place: each is deleted once there is another, as is one that a killed process left aside, and put back otherwise.

    kept: folders in which nothing is made now, from whose files smaller ones are cut. Raises HubError, and leaves all
    unchanged, where a file does not say that it is this sequence: it may be somebody's own
    """
    from oysterbench.hub.verify import ASIDE, DAMAGED, FOREIGN, check_alone, claims
    from oysterbench.simulation.generate import digest

    made_by = digest(split)
    damaged = [found for found in map(check_alone, paths) if found.state in (DAMAGED, FOREIGN)] if check else []
    for found in damaged:
        if not claims(found.path, split.name, split.version, made_by):
            raise HubError(
                f"{found.path}: expected {found.path.stem} of {split.name} {split.version}, as its recipe makes it, "
                "got a file that does not say so; it was left unchanged: delete it or choose another folder with --out"
            )
    aside = {path: path.with_name(ASIDE.format(path.name)) for path in paths}
    try:
        for found in damaged:
            then = "it is deleted once it has been rendered again"
            if found.path.parent in kept:
                then = "it is not used now, and stays: --verify without --topics renders it again"
            message(f"{found.path}: damaged ({found.detail}); {then}")
            os.replace(found.path, aside[found.path])
        yield
    finally:
        for path, hidden in aside.items():
            if path.exists():
                hidden.unlink(missing_ok=True)
            elif check and hidden.exists():
                os.replace(hidden, path)


@click.command(short_help="Check local data against its manifest.")
@click.argument("what", nargs=-1, metavar="[SPLIT|MODEL|FILE|FOLDER]...")
@click.option("--json", "as_json", is_flag=True, help="Print as JSON.")
def verify(what: tuple[str, ...], as_json: bool) -> None:
    """Read files again and compare them with the manifest of their split. Checks all local data by default.

    \b
    Examples:
      oysterbench verify
      oysterbench verify slam-val
      oysterbench verify data/mini-01.mcap
      oysterbench verify data                   every sequence file of a folder
      oysterbench verify hub                    signature and files of a published tree

    Prints for each file: right; right, with some of the topics (made with --topics); same content, other bytes; alike
    (within one grey level on 99.9 % of the pixels checked); or what differs. Exits with 3 if anything differs, is
    damaged or missing; `oysterbench download SPLIT --verify`, or `download MODEL --again`, repairs what is damaged or
    absent. A file of other content is left alone: delete it first.
    """
    from oysterbench.hub.verify import checks

    found = []
    for check in (check for name in (what or ("",)) for check in checks(name)):
        found.append(check)
        if not as_json:  # file by file, as each takes seconds
            echo(f"{check.path}: {check.state}" + (f" ({check.detail})" if check.detail else ""))
    if as_json:
        rows = [{"file": str(check.path), "state": check.state, "detail": check.detail} for check in found]
        echo(json.dumps({"files": rows}, indent=2))
    if not found:
        message("there is no local data; `oysterbench splits` lists the splits")
    bad = sum(not check.good for check in found)
    if bad and what and all((Path(name) / "index.json").is_file() for name in what):
        raise IntegrityError(f"{bad} of {len(found)} files are damaged or missing; each line above says what mends it")
    if bad:
        raise IntegrityError(
            f"{bad} of {len(found)} files are damaged, missing, from another program, or different from the release; "
            "`oysterbench download SPLIT --verify`, or `oysterbench download MODEL --again`, makes damaged and missing "
            "ones anew; delete those of other content first"
        )


def _print_files(files: dict[str, Path], split: str, as_json: bool) -> None:
    if as_json:
        echo(json.dumps({"split": split, "files": {k: str(v) for k, v in files.items()}}, indent=2))
        return
    for path in files.values():
        echo(path)


def _planned(
    hub: Hub,
    manifest: Manifest,
    entries: Sequence[FileEntry],
    folder: Path,
    topics: tuple[str, ...],
    out: Path | None,
) -> list[dict[str, Any]]:
    """What would be fetched of each file; with topics, only the pieces that contain them."""
    from oysterbench.hub.download import plan
    from oysterbench.hub.topics import plan_topics

    if topics:
        sizes = plan_topics(hub, entries, folder, topics, out)
        states = {True: "to fetch", False: "here"}
        return [
            {"file": entry.name, "state": states[size > 0], "size_bytes": size, "there_bytes": 0}
            for entry, size in zip(entries, sizes.values(), strict=True)
        ]
    return [
        {"file": str(step.path), "state": step.state, "size_bytes": step.entry.size, "there_bytes": step.there}
        for step in plan(manifest, entries, folder)
    ]


def _print_plan(manifest: Manifest, rows: list[dict[str, Any]], as_json: bool) -> None:
    if as_json:
        echo(json.dumps({**manifest.facts, "files": rows}, indent=2))
        return
    for row in rows:
        echo(f"{row['file']}: {row['state']}, {row['size_bytes'] / 1e6:.1f} MB")
    wanted = sum(row["size_bytes"] - row["there_bytes"] for row in rows)
    message(
        f"{manifest.split} {manifest.version}: {wanted / 1e6:.1f} of {sum(r['size_bytes'] for r in rows) / 1e6:.1f} MB "
        "to fetch"
    )


COMMANDS = (download, verify)
