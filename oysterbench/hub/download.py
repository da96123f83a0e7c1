"""Downloading: index, manifest, files. A file appears under its name only once every byte of it has been checked."""

from __future__ import annotations

import contextlib
import os
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from fnmatch import fnmatchcase
from pathlib import Path
from typing import TypeVar

from oysterbench.core.atomic import naming, write_atomically
from oysterbench.core.disk_space import free_bytes
from oysterbench.core.errors import HubError, IntegrityError, NotOnHubError
from oysterbench.core.locks import locked_if_possible
from oysterbench.core.names import instead
from oysterbench.core.places import home
from oysterbench.hub.canonical import sha256
from oysterbench.hub.draft import remove_drafts
from oysterbench.hub.index import LARGEST, Index, R, check_not_older, read_index
from oysterbench.hub.manifest import FileEntry, Manifest, read_manifest, released_manifest
from oysterbench.hub.model import Model, read_model
from oysterbench.hub.part import Part
from oysterbench.hub.pieces import Pieced
from oysterbench.hub.sources import Patience, Refusal, Setback, Silence, is_offline, open_source
from oysterbench.hub.transfer import Mirror, Transfer, no_mirror_left, pause_s
from oysterbench.hub.trusted import remember, remember_folder, was_filled_here
from oysterbench.hub.verify import DAMAGED, MANIFEST, RIGHT, Check, check_file, claims, kept_manifest

T = TypeVar("T")

CONNECTIONS = 4
SPARE = 64 << 20
"""Disk space that a download leaves free, bytes."""

Progress = Callable[[int, int], None]
"""Called with the number of verified bytes and the total."""

Announce = Callable[[str], None]
"""Called with a sentence on what is being done."""


def quiet(text: str) -> None:
    """Ignore an announcement."""


@dataclass
class Hub:
    """Mirrors of one tree, and the key that its index is signed with (hex; None: only released manifests are known)."""

    mirrors: list[Mirror]
    public: str | None
    connections: int = CONNECTIONS
    patience: Patience = field(default_factory=Patience)
    announce: Announce = quiet

    @classmethod
    def at(cls, places: Sequence[str], public: str | None, announce: Announce = quiet, **options: object) -> Hub:
        """Hub at addresses or folders, each a mirror of the others."""
        hub = cls([], public, announce=announce, **options)  # type: ignore[arg-type]
        hub.mirrors = [Mirror(open_source(place, hub.connections, hub.patience)) for place in places]
        return hub

    def index(self) -> Index:
        """Fetch the index from the first mirror whose index is validly signed and not older than one seen before."""
        if self.public is None:
            hub = " and ".join(mirror.source.name for mirror in self.mirrors) or "the hub"
            raise HubError(
                f"{hub}: its public key is not known here, and nothing that the hub says is used without it: add "
                f"--key KEY (or OYSTERBENCH_HUB_KEY, or the key 'key' of {home() / 'hub.toml'}); `oysterbench keygen` "
                "printed it to the hub's owner, and the hub's page shows it"
            )
        public = self.public

        def check(data: bytes, what: str) -> Index:
            index = read_index(data, public, what)
            check_not_older(index, data, public, what)
            return index

        return self._document("index.json", LARGEST, "the hub's index", check)

    def manifest(self, split: str, version: str | None = None) -> Manifest:
        """Manifest of a split: the one that came with oysterbench, or else the one that the signed index names."""
        if version is not None and (released := released_manifest(split, version)) is not None:
            return released
        index = self.index()
        release = find_release(index, index.splits, split, version)
        version = release.version

        def check(data: bytes, what: str) -> Manifest:
            if sha256(data) != release.manifest:
                raise IntegrityError(f"{what}: expected a manifest with SHA-256 {release.manifest}, got another")
            manifest = read_manifest(data, what)
            if (manifest.split, manifest.version) != (split, version):
                raise IntegrityError(f"{what}: it is of {manifest.split} {manifest.version}, not of {split} {version}")
            return manifest

        manifest = self._document(
            f"manifests/{release.manifest}.json", release.manifest_size, f"the manifest of {split} {version}", check
        )
        assert self.public is not None  # or there had been no index
        remember(manifest, self.public)
        return manifest

    def model(self, name: str, version: str | None = None) -> Model:
        """Fetch the card of trained weights that the signed index names."""
        index = self.index()
        release = find_release(index, index.models, name, version)

        def check(data: bytes, what: str) -> Model:
            if sha256(data) != release.card:
                raise IntegrityError(f"{what}: expected a card with SHA-256 {release.card}, got another")
            model = read_model(data, what)
            if (model.name, model.version) != (name, release.version):
                raise IntegrityError(
                    f"{what}: it is of {model.name} {model.version}, not of {name} {release.version}; it was not used"
                )
            return model

        what = f"the card of {name} {release.version}"
        return self._document(f"models/{release.card}.json", release.card_size, what, check)

    def described(self, model: Model) -> str:
        """Describe in words what would be fetched of a model, and from where."""
        places = " and ".join(mirror.source.name for mirror in self.mirrors if mirror.failure is None)
        file = model.file
        return f"{model.name} {model.version} from {places}, {file.size / 1e6:.1f} MB, SHA-256 {file.sha256}"

    def has_model(self, name: str) -> bool:
        """Whether the signed index has a model of this name; false where no key is known."""
        return self.public is not None and name in self.index().models

    def _document(self, path: str, largest: int, what: str, check: Callable[[bytes, str], T]) -> T:
        """Fetch a small file of at most `largest` bytes from the first mirror whose file passes the check."""
        for mirror in self.mirrors:
            where = f"{mirror.source.name}/{path}"
            attempt = 0
            while mirror.why_not(path) is None:
                attempt += 1
                try:
                    return check(self._read(mirror, path, largest), where)
                except IntegrityError as error:
                    mirror.fail(str(error), lied=True)
                except Refusal as refusal:
                    mirror.answered = True
                    mirror.refused[path] = refusal
                except Setback as setback:
                    mirror.answered |= not isinstance(setback, Silence)
                    if attempt >= self.patience.first_contact or setback.wait_s > self.patience.longest_wait_s:
                        mirror.fail(f"{setback}, {attempt} times in a row")
                    else:
                        time.sleep(pause_s(attempt, setback.wait_s, self.patience))
        raise no_mirror_left(what, path, self.mirrors)

    @staticmethod
    def _read(mirror: Mirror, path: str, largest: int) -> bytes:
        data = bytearray()
        with mirror.source.open(path) as body:
            mirror.answered = True
            while more := body.read():
                data += more
                if len(data) > largest:
                    raise IntegrityError(f"{mirror.source.name}/{path} is longer than {largest} bytes")
        return bytes(data)


def find_release(index: Index, releases: Mapping[str, Mapping[str, R]], name: str, version: str | None) -> R:
    """Release of the requested version, or the newest. releases: splits or models of the index. Raises NotOnHubError
    where there is none, with the names and versions that exist."""
    versions = releases.get(name)
    if not versions:
        other = instead(name, sorted([*index.splits, *index.models]), "oysterbench splits --hub")
        raise NotOnHubError(f"the hub has no split or model {name!r}; {other}")
    if version is not None and version not in versions:
        raise NotOnHubError(f"the hub has no version {version!r} of {name}; it has {', '.join(versions)}")
    return versions[version or list(versions)[-1]]


def choose(manifest: Manifest, patterns: Sequence[str]) -> list[FileEntry]:
    """Files whose sequence matches a pattern such as `val-0*`; all without patterns. Raises HubError where a pattern
    matches none."""
    of = f"{manifest.split} {manifest.version}"
    names = [entry.sequence for entry in manifest.files]
    fitting = choose_names(names, patterns, of, f"oysterbench download {manifest.split}@{manifest.version} --dry-run")
    return [entry for entry in manifest.files if entry.sequence in fitting]


def choose_names(names: Sequence[str], patterns: Sequence[str], of: str, listed_by: str) -> list[str]:
    """Names that match a pattern; all without patterns. Raises HubError where a pattern matches none, with the command
    that lists all.

    of: whose names they are, in words
    """
    for pattern in patterns:
        if not any(fnmatchcase(name, pattern) for name in names):
            raise HubError(f"{of} has no sequence matching {pattern!r}; {instead(pattern, names, listed_by)}")
    return [name for name in names if not patterns or any(fnmatchcase(name, pattern) for pattern in patterns)]


@dataclass(frozen=True)
class Step:
    """What a download would do for a file: `state` is "here" or "to fetch", `there` the number of its bytes in a
    part."""

    entry: FileEntry
    path: Path
    state: str
    there: int = 0


def plan(manifest: Manifest, entries: Sequence[FileEntry], folder: Path) -> list[Step]:
    """Determine which files are here and which have to be fetched.

    In a folder that was filled here by this manifest, a file of the right name and size is right: it appeared complete.
    Others are read and, elsewhere, each file with a name of the manifest, also those not chosen, since the manifest
    will stand for them too. A chosen one that is damaged has to be fetched where this manifest is beside it, or where
    it says that it is this sequence (as rendered files do); raises HubError where another is different, and leaves it
    unchanged.
    """
    kept = kept_manifest(folder)
    same = kept is not None and kept.sha256 == manifest.sha256
    filled = same and was_filled_here(folder, manifest)
    wrong = set()
    for entry in entries if filled else manifest.files:
        path = folder / entry.name
        if not path.is_file() or (filled and path.stat().st_size == entry.size):
            continue
        found = check_file(path, entry)
        if found.good:
            continue
        ours = same or claims(path, manifest.split, manifest.version, manifest.recipe_digest)
        if not (ours and entry in entries and found.state == DAMAGED):
            raise _in_the_way(found)
        wrong.add(entry.name)
    steps = []
    for entry in entries:
        path, part = folder / entry.name, part_path(folder, entry)
        if path.is_file() and entry.name not in wrong:
            steps.append(Step(entry, path, "here", entry.size))
        else:
            there = min(part.stat().st_blocks * 512, entry.size) if part.is_file() else 0
            steps.append(Step(entry, path, "to fetch", there))
    return steps


def _in_the_way(found: Check) -> HubError:
    return HubError(
        f"{found.path}: a different file has this name ({found.detail}); it was left unchanged: delete it or choose "
        "another folder with --out"
    )


def find_here(
    split: str, version: str | None, patterns: Sequence[str] = (), folder: Path | None = None
) -> tuple[Path, Manifest] | None:
    """Find a folder, with its manifest, that has all chosen files of a split, without using the network.

    folder: look only there; otherwise under the home. Without a version, a local one suffices only if the offline
    variable is set, because a hub may have a newer one.
    """
    if version is None and not is_offline():
        return None
    found = all_here(split, version, patterns, folder)
    return found[-1] if found else None


def all_here(
    split: str, version: str | None, patterns: Sequence[str] = (), folder: Path | None = None
) -> list[tuple[Path, Manifest]]:
    """All folders, with their manifests, that have all chosen files of a version of a split; of any without one."""
    found = []
    for path in [folder] if folder else sorted((home() / "splits" / split).glob("*")):
        manifest = kept_manifest(path)
        if manifest is None or manifest.split != split or version not in (None, manifest.version):
            continue
        entries = choose(manifest, patterns)
        with contextlib.suppress(HubError):  # a different file is in the way, which `download` reports
            if all(step.state == "here" for step in plan(manifest, entries, path)):
                found.append((path, manifest))
    return found


def part_path(folder: Path, entry: Pieced) -> Path:
    """Path of a partial file; bound to the file's hash, so that no other version resumes from it."""
    return folder / f".{entry.name}.{entry.sha256[:16]}.part"


def topics_mark(part: Path) -> Path:
    """Path of an empty file that marks a part as begun for some topics only, to be removed once they are cut from it"""
    return part.with_suffix(".topics")


def check_space(folder: Path, wanted: int) -> None:
    """Raise HubError unless there is room for `wanted` more bytes, and `SPARE`."""
    free = free_bytes(folder)
    if wanted + SPARE > free:
        raise HubError(
            f"{folder}: not enough room: {wanted / 1e6:.0f} MB are to be fetched, and {free / 1e6:.0f} MB are free; "
            "nothing was fetched: make room, choose fewer files with --sequence, or another place with --out or "
            "OYSTERBENCH_HOME"
        )


def download(
    hub: Hub,
    manifest: Manifest,
    folder: Path,
    entries: Sequence[FileEntry] | None = None,
    verify: bool = False,
    progress: Progress = lambda done, total: None,
) -> dict[str, Path]:
    """Fetch the files of a manifest that are not in the folder yet, and return all: sequence -> path.

    verify: read back files that are here already, and those that were written, and repair what is damaged; progress:
    of the bytes of those and of what is fetched. Raises IntegrityError or NetworkError where that fails; downloaded
    data is kept.
    """
    entries = manifest.files if entries is None else entries
    steps = plan(manifest, entries, folder)
    check_space(folder, sum(step.entry.size - step.there for step in steps if step.state != "here"))
    write_atomically(folder / MANIFEST, manifest.data)
    if not any(step.path.is_file() for step in steps if step.state != "here"):
        remember_folder(folder, manifest)  # at once, so that resuming need not read what is complete
    total, done = sum(step.entry.size for step in steps if verify or step.state != "here"), 0

    def count(n: int) -> None:
        nonlocal done
        done += n
        progress(done, total)

    if total:
        count(0)
    for step in steps:
        _fetch(hub, step, verify, count if verify or step.state != "here" else lambda n: None)
    remember_folder(folder, manifest)  # damaged files were replaced
    return {step.entry.sequence: step.path for step in steps}


def _fetch(hub: Hub, step: Step, verify: bool, count: Callable[[int], None]) -> None:
    """Complete one file. Several processes may do so at once: they wait for one another where the disk has locks."""
    entry, target, path = step.entry, step.path, part_path(step.path.parent, step.entry)
    with locked_if_possible(path.with_suffix(".lock")):
        topics_mark(path).unlink(missing_ok=True)  # a part that is there is the complete file's from now on
        if target.is_file() and _is_good(hub, target, entry, verify or step.state != "here", path):
            count(entry.size)
            path.unlink(missing_ok=True)
            remove_drafts(path)
            return
        fetch_file(hub, entry, path, target, count)
        if verify and (found := check_file(target, entry)).state != RIGHT:
            os.replace(target, path)
            raise IntegrityError(
                f"{target}: read back from the disk, it is {found.state} ({found.detail}); it was removed again: the "
                "disk may be failing"
            )


def fetch_file(hub: Hub, entry: Pieced, path: Path, target: Path, count: Callable[[int], None]) -> None:
    """Fetch what is missing of a part, and move it to its final name, replacing any file there."""
    with naming(target, path.with_suffix("")):
        part = Part(path, entry)
        try:
            Transfer(part, hub.mirrors, hub.connections, hub.patience, count).fetch(range(len(entry.pieces)))
            part.install(target)
        finally:
            part.close()


def _is_good(hub: Hub, target: Path, entry: FileEntry, read: bool, part: Path) -> bool:
    """Whether a file under its final name can be used. A damaged one becomes a part again, so that only its wrong
    pieces are fetched again. Raises HubError where it is another file, and leaves it unchanged."""
    if not read:
        return True
    found = check_file(target, entry)
    if found.good:
        return True
    if found.state != DAMAGED:
        raise _in_the_way(found)
    hub.announce(f"{target}: {found.state} ({found.detail}); damaged parts are downloaded again")
    os.replace(target, part)
    return False
