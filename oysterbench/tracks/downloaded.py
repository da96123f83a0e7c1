"""Hidden splits as a hub gave them: without the ground truth, in a folder under the home."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from oysterbench.core.errors import RecipeError
from oysterbench.core.names import is_plain, listed
from oysterbench.core.places import home

if TYPE_CHECKING:
    from oysterbench.hub.manifest import Manifest
    from oysterbench.recipe import SplitRecipe
    from oysterbench.tracks.track import Announce


def files_of_split(
    split: SplitRecipe, sequences: Sequence[str], topics: Sequence[str], announce: Announce
) -> dict[str, Path]:
    """Files of a hidden split, by sequence name. Raises RecipeError, with what to type, where they are not there, or
    belong to the released recipe of that name and `split` is another one."""
    from oysterbench.hub.download import find_here
    from oysterbench.recipe import load_split, split_names
    from oysterbench.simulation.generate import digest
    from oysterbench.simulation.salt import SALT_FILE, how_to_take_part

    if split.name in split_names() and digest(split) != digest(load_split(split.name)):
        raise RecipeError(
            f"{split.name} is a hidden split: it comes from a hub, without its ground truth, and its recipe is not the "
            f"released one; rendering it needs its salt ({SALT_FILE}), and --split {split.name} is the released one"
        )
    found = find_here(split.name, split.version, sequences)
    if found is None:
        raise RecipeError(
            f"split {split.name} is hidden, and was not downloaded here; {how_to_take_part(split.name)}; to host it: "
            f"set {SALT_FILE} to the file of its salt"
        )
    return _files(*found, sequences, topics, announce)


def files_by_name(
    name: str, sequences: Sequence[str], topics: Sequence[str], announce: Announce
) -> dict[str, Path] | None:
    """Files of a hidden split whose recipe only its host has, by sequence name; None where it was not downloaded.
    Raises RecipeError where it was only in part, or in several releases."""
    from oysterbench.hub.download import all_here
    from oysterbench.hub.verify import kept_manifest

    if not is_plain(name):  # such as the path of a folder, which --on takes
        return None
    found = [(folder, manifest) for folder, manifest in all_here(name, None, sequences) if manifest.hidden]
    kept = [kept_manifest(folder) for folder in (home() / "splits" / name).glob("*")]
    if not found and any(manifest is not None and manifest.hidden for manifest in kept):
        raise RecipeError(
            f"split {name}: its recipe is not known here, and only a part of it was downloaded; "
            f"`oysterbench download {name}` fetches the rest, and --sequence NAME takes what is there"
        )
    if len(found) > 1:
        raise RecipeError(
            f"split {name}: expected one release of it under the home folder, got "
            f"{listed([str(folder) for folder, _ in found])}; choose one of them: --on FOLDER, with --out"
        )
    return _files(*found[0], sequences, topics, announce) if found else None


def _files(
    folder: Path, manifest: Manifest, sequences: Sequence[str], topics: Sequence[str], announce: Announce
) -> dict[str, Path]:
    from oysterbench.hub.download import choose

    name = manifest.split
    if topics:
        raise RecipeError(
            f"--topics: split {name} was downloaded with all its topics; `oysterbench download {name} --topics GLOB "
            "--out FOLDER` makes smaller files, for --on FOLDER"
        )
    announce(f"{name}: as downloaded to {folder}")
    return {entry.sequence: folder / entry.name for entry in choose(manifest, sequences)}
