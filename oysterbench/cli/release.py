"""Commands for what is released with oysterbench: manifests of splits, and trained weights. `cli.main` adds them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from oysterbench.cli.echo import echo, message
from oysterbench.cli.interrupts import started_over
from oysterbench.cli.models import card_options, release_card
from oysterbench.core.names import counted

FOLDER = click.Path(path_type=Path, file_okay=False)


@click.command(short_help="Write the manifest that renders of a split are checked against.")
@click.argument("split_name", metavar="SPLIT")
@click.option("--sequence", "names", multiple=True, metavar="NAME", help="Only this sequence; repeatable.")
@click.option("--data", type=FOLDER, help="Folder of the rendered files.  [default: under the home folder]")
@click.option("--out", type=FOLDER, help="Folder of the manifest.  [default: that of the package]")
@click.option("--reads", type=FOLDER, help="Folder of what was read.  [default: under the home folder, in `releases`]")
@click.option("--so-far", is_flag=True, help="Write a partial manifest while not all sequences have been read.")
@click.option("--again", is_flag=True, help="Read sequences again that have been read before.")
def release(
    split_name: str,
    names: tuple[str, ...],
    data: Path | None,
    out: Path | None,
    reads: Path | None,
    so_far: bool,
    again: bool,
) -> None:
    """Read a rendered split and write its manifest, for maintainers of splits: hashes of every file and of its decoded
    content, with the versions of the software that made them.

    \b
    Examples:
      oysterbench release slam-mini
      oysterbench release slam-val --sequence val-03    one at a time
      oysterbench release slam-train --sequence train-01 \\
        --reads /mnt/shared/slam-train    and others on other machines
      oysterbench release slam-train --sequence train-01 --so-far

    What is read of a sequence is kept: its file may then be deleted. The manifest is written once all sequences have
    been read. With --so-far, those read until now make a partial one, with which renders of them are compared, and
    which the next call continues, on any machine. A release never changes: another manifest under its name, or without
    what the partial one has, is refused.
    """
    from importlib import resources

    from oysterbench.cli.progress import bytes_bar
    from oysterbench.core.errors import HubError
    from oysterbench.core.places import home
    from oysterbench.hub.publish import check_made_by
    from oysterbench.hub.release import (
        forget_read,
        keep_read,
        not_read,
        put_together,
        take_over,
        write_partial,
        write_release,
    )
    from oysterbench.recipe import load_split
    from oysterbench.sequence.truth import rig_topics
    from oysterbench.simulation.generate import digest, sequence_files, split_folder

    split = load_split(split_name)
    if split.hidden:
        raise HubError(
            f"{split.name} is a hidden split, which others cannot render; `oysterbench publish --hidden` pins it"
        )
    made_by = digest(split)
    kept = (reads or home() / "releases") / f"{split.name}-{split.version}-{made_by[:12]}"
    known = [sequence.name for sequence in split.sequence]
    wanted = [split.find_sequence(name).name for name in names] or known
    files = sequence_files(split, data or split_folder(split))
    folder = out or Path(str(resources.files("oysterbench_datasets"))) / "manifests"
    take_over(kept, folder, split.name, split.version, made_by)
    todo = {name: files[name] for name in (wanted if again else not_read(kept, wanted))}
    check_made_by(todo, split.name, split.version, made_by, hidden=False, texts=split.texts)
    if again:
        forget_read(kept, wanted)
        started_over()
    done, total = 0, sum(path.stat().st_size for path in todo.values())
    with bytes_bar(f"reading {split.name}") as progress:
        for name, path in todo.items():
            keep_read(kept, name, path, rig_topics(split.rig_of(split.find_sequence(name))))
            done += path.stat().st_size
            progress(done, total)
    take_over(kept, folder, split.name, split.version, made_by)  # what others have added meanwhile
    missing = not_read(kept, known)
    read = [name for name in known if name not in missing]
    if missing:
        message(f"{split.name} {split.version}: {len(missing)} of {len(known)} to be read: {', '.join(missing)}")
    released = (folder / f"{split.name}-{split.version}.json").is_file()
    if not read or (missing and (released or not so_far)):
        return
    facts = {"split": split.name, "version": split.version, "track": split.track, "summary": split.summary}
    manifest = put_together(kept, {**facts, "rig": split.rig.name}, read, made_by, split.texts)
    message(f"{split.name} {split.version}: {counted(len(manifest.files), 'file')}, {manifest.size / 1e6:.1f} MB")
    echo((write_partial if missing else write_release)(manifest, folder))


@click.command("release-model", short_help="Make trained weights, and their card, part of oysterbench.")
@click.argument("name", metavar="MODEL")
@card_options
@click.option("--out", type=FOLDER, help="Folder of the weights.  [default: that of the package]")
def release_model(name: str, out: Path | None, **card: Any) -> None:
    """Copy trained weights into the package, for maintainers: methods run on them unless others have been trained or
    downloaded. Their card is that of `publish-model`.

    \b
    Examples:
      oysterbench run unet --split seg-val --out val
      oysterbench release-model unet --results val

    A release never changes: another card or other weights under its version are refused.
    """
    from oysterbench.core.places import released_models
    from oysterbench.hub.publish_model import write_released

    path, model = release_card(name, **card)
    message(f"{model.name} {model.version}: {model.file.size / 1e6:.1f} MB, {len(model.figures)} figures")
    echo(write_released(model, path, out or released_models()))


COMMANDS = (release, release_model)
