"""Releasing a split: the manifest that ships with oysterbench, and with which everybody's render is compared.

It is made sequence by sequence, so that a split need never be on one disk as a whole: the description of each is kept,
and they are assembled once none is missing. Until then those of a large split can be shipped as a partial manifest.
"""

from __future__ import annotations

import platform
from collections.abc import Collection, Iterator, Mapping, Sequence
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import msgspec

from oysterbench.core.atomic import write_atomically
from oysterbench.core.errors import HubError
from oysterbench.hub.canonical import canonical, decode, sha256
from oysterbench.hub.manifest import PARTIAL, FileEntry, Manifest, describe_file, read_manifest
from oysterbench.version import GENERATION, VERSION

DECIDING = ("numpy", "scipy", "opencv-python-headless", "warp-lang", "trimesh", "mcap", "zstandard")
"""Packages whose arithmetic, coding or compression decides the bytes of a sequence file."""


class Read(msgspec.Struct, frozen=True):
    """Description of one sequence file, and the versions of the software that made it."""

    entry: FileEntry
    made_with: dict[str, str]


def made_with() -> dict[str, str]:
    """Versions, on this machine, of what decides the bytes: packages, Python, processor type, and render generation."""
    found = {"generation": str(GENERATION), "python": platform.python_version(), "processor": platform.machine()}
    for name in DECIDING:
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            continue
    return found


def keep_read(kept: Path, name: str, path: Path, topics: Collection[str]) -> None:
    """Read the file of a sequence, and keep its description in the folder `kept`. Raises HubError where one of
    `topics`, all those of its rig, has no message: the file is then only part of what is to be released."""
    read = Read(describe_file(path, f"{name}.mcap"), made_with())
    absent = sorted({*topics} - {*read.entry.content})
    if absent:
        raise HubError(f"{path}: expected all topics of its rig, got none of {', '.join(absent)}; it was not accepted")
    _keep(kept, name, read)


def _keep(kept: Path, name: str, read: Read) -> None:
    write_atomically(kept / f"{name}.json", canonical(msgspec.to_builtins(read)))


def take_over(kept: Path, folder: Path, split: str, version: str, recipe_digest: str) -> None:
    """Keep the descriptions in the partial manifest of a split among `folder`'s releases as if they had been read here;
    none where it has none, or one of another recipe."""
    path = folder / PARTIAL / f"{split}-{version}.json"
    if not path.is_file():
        return
    manifest = read_manifest(path.read_bytes(), str(path))
    for entry in manifest.files if manifest.recipe_digest == recipe_digest else ():
        if not_read(kept, [entry.sequence]):
            _keep(kept, entry.sequence, Read(entry, manifest.made_with or {}))


def not_read(kept: Path, names: Sequence[str]) -> list[str]:
    """Names of the sequences that have not been read yet."""
    return [name for name in names if not (kept / f"{name}.json").is_file()]


def forget_read(kept: Path, names: Sequence[str]) -> None:
    """Forget what was read of these sequences, so that they are read again."""
    for name in names:
        (kept / f"{name}.json").unlink(missing_ok=True)


def put_together(
    kept: Path, facts: Mapping[str, str], names: Sequence[str], recipe_digest: str, texts: Mapping[str, bytes]
) -> Manifest:
    """Assemble the manifest of sequences that were read; facts: split, version, track, rig and summary; texts: of the
    recipe and the rig (`SplitRecipe.texts`).

    Raises HubError where they were made with different versions of what decides the bytes, or from other texts, which
    every file keeps, perhaps before a comment was edited: nobody's render could match them all.
    """
    reads = {name: decode((kept / f"{name}.json").read_bytes(), Read, f"{kept}/{name}.json") for name in sorted(names)}
    first, *others = reads.items()
    for name, read in others:
        for what, here, there in _unlike(first[1].made_with, read.made_with):
            raise HubError(
                f"{name} was made with {what} {there}, and {first[0]} with {here}; nothing was written: render one of "
                "them again with the other's, and release it with --again"
            )
    for name, read in reads.items():
        for text, data in texts.items():
            if read.entry.attachments.get(text) != sha256(data):
                raise HubError(
                    f"{name} was made from another text of {text} than the recipe has now (a comment counts); nothing "
                    "was written: put that text back, or render the sequence again and release it with --again"
                )
    entries = tuple(read.entry for read in reads.values())
    made = {"oysterbench": VERSION, "files": entries, "made_with": first[1].made_with}
    return Manifest(**facts, **made, recipe_digest=recipe_digest)  # type: ignore[arg-type]


def write_partial(manifest: Manifest, folder: Path) -> Path:
    """Write the manifest of the sequences read so far, in the folder `partial` of the released ones, instead of the one
    of fewer. Raises HubError where that has another description of one of them: what was shipped never changes."""
    path = folder / PARTIAL / f"{manifest.split}-{manifest.version}.json"
    _check_kept(manifest, path)
    write_atomically(path, manifest.data)
    return path


def _check_kept(manifest: Manifest, path: Path) -> None:
    """Raise HubError unless a manifest has all that the partial one at a path has."""
    if not path.is_file():
        return
    shipped = read_manifest(path.read_bytes(), str(path))
    way_out = (
        "it was left unchanged and nothing was written: raise the version in the split's recipe, or delete that file "
        "if it has not been distributed"
    )
    if shipped.recipe_digest != manifest.recipe_digest:
        raise HubError(f"{path}: it is of another recipe or generation than was read now; {way_out}")
    for entry in shipped.files:
        if manifest.find(entry.name) != entry:
            raise HubError(f"{path}: {entry.sequence} has another description in it than was read now; {way_out}")


def write_release(manifest: Manifest, folder: Path) -> Path:
    """Write a manifest among the released ones, and delete the partial one. Raises HubError where a different one has
    its name: releases never change."""
    path = folder / f"{manifest.split}-{manifest.version}.json"
    if path.is_file() and path.read_bytes() != manifest.data:
        raise HubError(
            f"{path}: {manifest.split} {manifest.version} has another manifest, and a release never changes; it was "
            "left unchanged: raise the version in the split's recipe, or delete the file if it has not been distributed"
        )
    _check_kept(manifest, folder / PARTIAL / path.name)
    write_atomically(path, manifest.data)
    (folder / PARTIAL / path.name).unlink(missing_ok=True)
    return path


def _unlike(here: Mapping[str, str], there: Mapping[str, str]) -> Iterator[tuple[str, str, str]]:
    for what in sorted({*here, *there}):
        if here.get(what) != there.get(what):
            yield what, here.get(what, "none"), there.get(what, "none")
