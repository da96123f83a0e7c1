"""Sources of the files of a split: a folder, the renderer of this machine, or a hub; each file on demand."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from contextlib import nullcontext
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

from oysterbench.core.errors import HubError, SequenceError
from oysterbench.core.places import home
from oysterbench.notebook.progress import frames_bar, say
from oysterbench.notebook.rendering import render_files

if TYPE_CHECKING:
    from oysterbench.hub.download import Hub
    from oysterbench.hub.manifest import Manifest
    from oysterbench.recipe import SplitRecipe

NO_HUB = "no hub is set (OYSTERBENCH_HUB, or hub.toml in the home folder)"


class Source(ABC):
    """Source of the sequence files of a split.

    name, version, track, about: of the split; about is a sentence
    names:  names of its sequences, in order
    recipe: what it is rendered from; None where only files are known
    """

    name: str
    version: str = ""
    track: str = ""
    about: str = ""
    names: tuple[str, ...]
    recipe: SplitRecipe | None = None

    @abstractmethod
    def here(self, name: str) -> Path | None:
        """File of a sequence, or None where it is not on this machine or not complete."""

    def size_bytes(self, name: str) -> int | None:
        """Size of the file of a sequence; None where it is unknown until the file is here."""
        path = self.here(name)
        return path.stat().st_size if path is not None else None

    @abstractmethod
    def get(self, names: Sequence[str], workers: int | None, quiet: bool) -> None:
        """Get the files of sequences that are not here. Raises OysterbenchError where that fails; the next call resumes
        what was started."""


class FolderSource(Source):
    """Sequence files in a folder, and nothing else."""

    def __init__(self, folder: Path) -> None:
        self.folder, self.name = folder, folder.resolve().name
        self._paths = {path.stem: path for path in sorted(folder.glob("*.mcap"))}
        self.names = tuple(self._paths)
        if not self.names:
            raise SequenceError(f"{folder}: expected a folder with sequence files (.mcap), found none in it")

    def here(self, name: str) -> Path | None:
        path = self._paths[name]
        return path if path.is_file() else None

    def get(self, names: Sequence[str], workers: int | None, quiet: bool) -> None:
        gone = self._paths[names[0]]
        raise SequenceError(f"{gone}: no longer exists; it did when the folder was opened")


class HubSource(Source):
    """A split that, in this version, only a hub has."""

    def __init__(self, hub: Hub, manifest: Manifest) -> None:
        self._hub, self._manifest = hub, manifest
        self.name, self.version, self.track = manifest.split, manifest.version, manifest.track
        self.about = manifest.summary
        self.names = tuple(entry.sequence for entry in manifest.files)
        self.folder = home() / "splits" / manifest.split / f"{manifest.version}-{manifest.sha256[:12]}"

    def here(self, name: str) -> Path | None:
        return _whole(self._manifest, self.folder, name)

    def size_bytes(self, name: str) -> int | None:
        entry = self._manifest.find(f"{name}.mcap")
        return entry.size if entry else None

    def get(self, names: Sequence[str], workers: int | None, quiet: bool) -> None:
        fetch(self._hub, self._manifest, self.folder, names, quiet)


class RecipeSource(Source):
    """A split that is rendered from its recipe, or downloaded from a hub where one is set.

    A recipe of the user's own is always rendered, as the split of its name on a hub may be another one; unless it is
    hidden and its salt is not here.
    """

    def __init__(self, recipe: SplitRecipe, from_file: bool = False) -> None:
        """from_file: whether the user named the file of the recipe, which may be one of their own."""
        self.recipe, self._from_file = recipe, from_file
        self.name, self.version, self.track, self.about = recipe.name, recipe.version, recipe.track, recipe.summary
        self.names = tuple(sequence.name for sequence in recipe.sequence)

    @cached_property
    def _salt(self) -> bytes:
        from oysterbench.simulation.salt import read_salt

        return (read_salt() or b"") if self.recipe is not None and self.recipe.hidden else b""

    @cached_property
    def _own(self) -> bool:
        """Whether it is a recipe of the user's own, whose files only its digest tells from those of others."""
        from oysterbench.recipe import load_split, split_names
        from oysterbench.simulation.generate import digest

        assert self.recipe is not None
        if not self._from_file:
            return False
        if self.name in split_names():
            return digest(self.recipe) != digest(load_split(self.name))
        return bool(self._salt) or not self.recipe.hidden

    @property
    def folder(self) -> Path:
        """Folder of its rendered files."""
        from oysterbench.simulation.generate import split_folder

        assert self.recipe is not None
        return split_folder(self.recipe, self._salt)

    def here(self, name: str) -> Path | None:
        path = self.folder / f"{name}.mcap"
        return path if path.is_file() else self._downloaded(name)

    def _downloaded(self, name: str) -> Path | None:
        """File of a sequence from a separate folder, as for a hub whose files another version of this program made."""
        from oysterbench.hub.verify import kept_manifest
        from oysterbench.simulation.generate import digest

        assert self.recipe is not None
        made_by = digest(self.recipe, self._salt) if self._own else None
        for folder in sorted((home() / "splits" / self.name).glob(f"{self.version}-*")):
            manifest = kept_manifest(folder)
            if manifest is None or (manifest.split, manifest.version) != (self.name, self.version):
                continue
            found = _whole(manifest, folder, name)
            if found is not None and made_by in (None, manifest.recipe_digest):
                return found
        return None

    def get(self, names: Sequence[str], workers: int | None, quiet: bool) -> None:
        assert self.recipe is not None
        hub = None if self._own else hub_here(quiet)
        if hub is None:
            if self.recipe.hidden and not self._salt:
                lacking = "its recipe is not the released one" if self._own else NO_HUB
                raise HubError(
                    f"{self.name} is a hidden split: it comes from a hub, without its ground truth, and {lacking}; "
                    "rendering it needs its salt"
                )
            render_files(self.recipe, self.folder, workers, tuple(names), self._salt, quiet=quiet)
            return
        from oysterbench.simulation.generate import digest

        manifest = hub.manifest(self.name, self.version)
        folder = self.folder
        if manifest.recipe_digest != digest(self.recipe, self._salt):
            folder = home() / "splits" / self.name / f"{manifest.version}-{manifest.sha256[:12]}"
        fetch(hub, manifest, folder, names, quiet)


def find_source(name: str | Path) -> Source:
    """Find the source of a split, by its name (NAME or NAME@VERSION), the path of a recipe, or that of a folder.

    Raises RecipeError for a name that neither this version of oysterbench nor the hub that is set knows.
    """
    from oysterbench.recipe import load_split, split_names

    text = str(name)
    known = split_names()
    if text not in known and Path(text).is_dir():
        return FolderSource(Path(text))
    plain, _, version = text.partition("@")
    if text.endswith(".toml") or plain in known:
        recipe = load_split(text if text.endswith(".toml") else plain)
        if version in ("", recipe.version) or text.endswith(".toml"):
            return RecipeSource(recipe, from_file=text.endswith(".toml"))
    hub = hub_here()
    if hub is not None and hub.public is not None:
        return HubSource(hub, hub.manifest(plain, version or None))
    if plain in known:
        raise HubError(f"{text}: this version of oysterbench renders {plain} {load_split(plain).version}, and {NO_HUB}")
    return RecipeSource(load_split(text))  # which says what is wrong with the name


def hub_here(quiet: bool = True) -> Hub | None:
    """Hub that is set; None without one."""
    from oysterbench.hub.settings import hub_key, hub_places

    places = hub_places()
    if not places:
        return None
    from oysterbench.hub.download import Hub

    return Hub.at(places, hub_key()) if quiet else Hub.at(places, hub_key(), say)


def fetch(hub: Hub, manifest: Manifest, folder: Path, names: Sequence[str], quiet: bool) -> None:
    """Download files of a manifest into a folder. Raises HubError for an unknown sequence or a failed download."""
    from oysterbench.hub.download import choose, download

    entries = choose(manifest, names)
    with nullcontext() if quiet else frames_bar(f"downloading {manifest.split}", "kB") as told:

        def tell(done: int, total: int) -> None:
            if told is not None:
                told(done // 1000, total // 1000)

        download(hub, manifest, folder, entries, progress=tell)


def _whole(manifest: Manifest, folder: Path, name: str) -> Path | None:
    """File of a manifest in a folder, or None: files appear there only once every byte has been checked."""
    entry, path = manifest.find(f"{name}.mcap"), folder / f"{name}.mcap"
    try:
        return path if entry is not None and path.stat().st_size == entry.size else None
    except OSError:
        return None
