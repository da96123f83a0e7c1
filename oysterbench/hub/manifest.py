"""The manifest of a split's version: every file with its size, hashes and content. Immutable once released."""

from __future__ import annotations

import re
from collections.abc import Mapping
from functools import cached_property
from importlib import resources
from pathlib import Path
from typing import Annotated, Any, Literal

import msgspec

from oysterbench.core.errors import IntegrityError
from oysterbench.hub.canonical import Sha256, canonical, decode, sha256
from oysterbench.hub.pieces import PIECE, Pieced, PieceSize, hashed
from oysterbench.version import VERSION

LICENCE = "https://creativecommons.org/licenses/by/4.0/"

PARTIAL = "partial"
"""Folder, among the released manifests, of those that lack sequences still."""

NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_-]*")
VERSION_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]*")

SplitName = Annotated[str, msgspec.Meta(pattern=rf"^{NAME.pattern}\Z")]
SplitVersion = Annotated[str, msgspec.Meta(pattern=rf"^{VERSION_NAME.pattern}\Z")]
FileName = Annotated[str, msgspec.Meta(pattern=rf"^{NAME.pattern}\.mcap\Z")]
"""Names that cannot lead out of a folder."""


class FileEntry(Pieced, msgspec.Struct, frozen=True):
    """One file: its name in the split's folder, size in bytes, SHA-256 of the whole and of each piece.

    content, attachments: content of the file, however it is compressed; see `content_of`. piece_size: the manifest's.
    """

    name: FileName
    size: Annotated[int, msgspec.Meta(ge=1)]
    sha256: Sha256
    pieces: tuple[Sha256, ...]
    content: dict[str, dict[str, Any]]
    attachments: dict[str, str]
    duration_ns: int
    piece_size: PieceSize = PIECE

    @property
    def sequence(self) -> str:
        """Name of the sequence that the file holds."""
        return self.name.removesuffix(".mcap")


class Manifest(msgspec.Struct, frozen=True, dict=True):
    """A version of a split. `recipe_digest` is absent (None) from a hidden split, whose `commitment` stands for its
    ground truth: the SHA-256 of the truth package's manifest. made_with: for a released split, the versions of the
    software that decides its bytes."""

    split: SplitName
    version: SplitVersion
    track: str
    rig: str
    summary: str
    oysterbench: str
    files: tuple[FileEntry, ...]
    recipe_digest: Sha256 | None = None
    commitment: Sha256 | None = None
    made_with: dict[str, str] | None = None
    piece_size: PieceSize = PIECE
    format: Literal["oysterbench-manifest/1"] = "oysterbench-manifest/1"
    licence: str = LICENCE

    @property
    def hidden(self) -> bool:
        """Whether the ground truth is withheld."""
        return self.commitment is not None

    @property
    def size(self) -> int:
        """Total size of all files, bytes."""
        return sum(entry.size for entry in self.files)

    @property
    def facts(self) -> dict[str, str | int | None]:
        """Facts about it that commands print as JSON."""
        return {
            "split": self.split,
            "version": self.version,
            "manifest": self.sha256,
            "commitment": self.commitment,
            "size_bytes": self.size,
        }

    @cached_property
    def data(self) -> bytes:
        """The manifest as canonical JSON; what is absent has no key."""
        document = {key: value for key, value in msgspec.to_builtins(self).items() if value is not None}
        for entry in document["files"]:
            del entry["piece_size"]  # the same for all of them
        return canonical(document)

    @cached_property
    def sha256(self) -> str:
        """The manifest's own hash, which is its name."""
        return sha256(self.data)

    def find(self, name: str) -> FileEntry | None:
        """The file with that name, or None."""
        return next((entry for entry in self.files if entry.name == name), None)


def describe_file(path: Path, name: str | None = None, piece_size: int = PIECE) -> FileEntry:
    """Hash a sequence file: the whole, its pieces and its content."""
    from oysterbench.hub.content import content_of  # code that reads messages is loaded only when needed

    size, whole, pieces = hashed(path, piece_size)
    found = content_of(path)
    return FileEntry(
        name=name or path.name,
        size=size,
        sha256=whole,
        pieces=pieces,
        content=found.topics,
        attachments=found.attachments,
        duration_ns=found.duration_ns,
        piece_size=piece_size,
    )


def build_manifest(
    facts: Mapping[str, str],
    files: Mapping[str, Path],
    recipe_digest: str | None = None,
    commitment: str | None = None,
    piece_size: int = PIECE,
) -> Manifest:
    """Build the manifest of sequence files, sequence name -> path; facts: split, version, track, rig and summary, and
    the version of `oysterbench` where it is not this one."""
    entries = tuple(describe_file(path, f"{name}.mcap", piece_size) for name, path in sorted(files.items()))
    made = {"oysterbench": VERSION, **facts, "files": entries, "piece_size": piece_size}
    return Manifest(**made, recipe_digest=recipe_digest, commitment=commitment)  # type: ignore[arg-type]


def read_manifest(data: bytes, what: str) -> Manifest:
    """Read a manifest from its bytes, checked so that no name leads out of a folder and all numbers are consistent.

    Raises IntegrityError naming `what` and the first key that is wrong.
    """
    manifest = decode(data, Manifest, what)
    files = tuple(msgspec.structs.replace(entry, piece_size=manifest.piece_size) for entry in manifest.files)
    for entry in files:
        entry.check(what)
    if len({entry.name for entry in files}) != len(files):
        raise IntegrityError(f"{what}: key 'files': a name occurs twice; it was not used")
    return msgspec.structs.replace(manifest, files=files)


def released_manifest(split: str, version: str) -> Manifest | None:
    """Manifest of a released split that ships with oysterbench (`datasets/manifests`), a pin like a key; None where
    there is none."""
    return _shipped(split, version, "manifests")


def partial_manifest(split: str, version: str) -> Manifest | None:
    """Manifest of those sequences of a large split that have been read so far (`datasets/manifests/partial`), while its
    release is being made; None where there is none. Renders are compared with it, but nothing is published or
    downloaded by it."""
    return _shipped(split, version, f"manifests/{PARTIAL}")


def _shipped(split: str, version: str, folder: str) -> Manifest | None:
    if not (NAME.fullmatch(split) and VERSION_NAME.fullmatch(version)):
        return None
    entry = resources.files("oysterbench_datasets") / folder / f"{split}-{version}.json"
    what = f"{folder}/{split}-{version}.json of oysterbench"
    return read_manifest(entry.read_bytes(), what) if entry.is_file() else None
