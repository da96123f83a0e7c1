"""The manifest of a split's version: every file with its size, hashes and content. Immutable once released."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from importlib import resources
from pathlib import Path
from typing import Any

from oysterbench.core.errors import IntegrityError
from oysterbench.hub.canonical import SHA256, canonical, parse, sha256
from oysterbench.version import VERSION

FORMAT = "oysterbench-manifest/1"
LICENCE = "https://creativecommons.org/licenses/by/4.0/"
PIECE = 4 * 1024 * 1024
"""Bytes of a piece, the unit of verification, resumption and parallel transfer (the last of a file is shorter)."""

NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_-]*")
VERSION_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]*")
FILE_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_-]*\.mcap")


@dataclass(frozen=True)
class FileEntry:
    """One file: its name in the split's folder, size in bytes, SHA-256 of the whole and of each piece.

    content, attachments: what the file says, however it is compressed; see `content_of`.
    """

    name: str
    size: int
    sha256: str
    piece_size: int
    pieces: tuple[str, ...]
    content: Mapping[str, Mapping[str, Any]]
    attachments: Mapping[str, str]
    duration_ns: int

    @property
    def sequence(self) -> str:
        """Name of the sequence that the file holds."""
        return self.name.removesuffix(".mcap")

    def span(self, piece: int) -> tuple[int, int]:
        """First byte of a piece, and the byte behind its last."""
        return piece * self.piece_size, min((piece + 1) * self.piece_size, self.size)

    def length(self, piece: int) -> int:
        """Bytes of a piece."""
        start, end = self.span(piece)
        return end - start


@dataclass(frozen=True)
class Manifest:
    """A split's version. `recipe_digest` is absent (None) from a hidden split, whose `commitment` stands for its
    truth: the SHA-256 of the truth package's manifest."""

    split: str
    version: str
    track: str
    rig: str
    summary: str
    oysterbench: str
    files: tuple[FileEntry, ...]
    recipe_digest: str | None = None
    commitment: str | None = None

    @property
    def hidden(self) -> bool:
        """Whether the truth is kept back."""
        return self.commitment is not None

    @property
    def size(self) -> int:
        """Bytes of all files."""
        return sum(entry.size for entry in self.files)

    @cached_property
    def data(self) -> bytes:
        """The manifest as canonical JSON."""
        shared = {key: getattr(self, key) for key in ("split", "version", "track", "rig", "summary", "oysterbench")}
        optional = {key: getattr(self, key) for key in ("recipe_digest", "commitment")}
        files = [
            {
                "name": entry.name,
                "size": entry.size,
                "sha256": entry.sha256,
                "pieces": list(entry.pieces),
                "content": {topic: dict(facts) for topic, facts in entry.content.items()},
                "attachments": dict(entry.attachments),
                "duration_ns": entry.duration_ns,
            }
            for entry in self.files
        ]
        sizes = {entry.piece_size for entry in self.files}
        (piece_size,) = sizes or {PIECE}
        document = {"format": FORMAT, "licence": LICENCE, "piece_size": piece_size, "files": files}
        return canonical(document | shared | {key: value for key, value in optional.items() if value is not None})

    @cached_property
    def sha256(self) -> str:
        """The manifest's own hash, which is its name."""
        return sha256(self.data)

    def find(self, name: str) -> FileEntry | None:
        """The file of that name."""
        return next((entry for entry in self.files if entry.name == name), None)


def describe_file(path: Path, name: str | None = None, piece_size: int = PIECE) -> FileEntry:
    """Hash a sequence file: the whole, its pieces and its content."""
    from oysterbench.hub.content import content_of  # what reads messages is loaded only when needed

    whole = hashlib.sha256()
    pieces = []
    with open(path, "rb") as file:
        while piece := file.read(piece_size):
            whole.update(piece)
            pieces.append(sha256(piece))
        size = file.tell()
    content = content_of(path)
    return FileEntry(
        name=name or path.name,
        size=size,
        sha256=whole.hexdigest(),
        piece_size=piece_size,
        pieces=tuple(pieces),
        content=content.topics,
        attachments=content.attachments,
        duration_ns=content.duration_ns,
    )


def build_manifest(
    facts: Mapping[str, str],
    files: Mapping[str, Path],
    recipe_digest: str | None = None,
    commitment: str | None = None,
    piece_size: int = PIECE,
) -> Manifest:
    """The manifest of sequence files, sequence name -> path; facts: split, version, track, rig and summary."""
    entries = tuple(describe_file(path, f"{name}.mcap", piece_size) for name, path in sorted(files.items()))
    return Manifest(**facts, oysterbench=VERSION, files=entries, recipe_digest=recipe_digest, commitment=commitment)


def read_manifest(data: bytes, what: str) -> Manifest:
    """A manifest from its bytes, checked so that no name in it leads out of a folder and every number fits.

    Raises IntegrityError that names `what` and the first key that is wrong.
    """
    document = parse(data, what)

    def take(table: Mapping[str, Any], key: str, kind: type, where: str = "") -> Any:
        value = table.get(key)
        if type(value) is not kind:
            wanted = {"str": "text", "int": "a whole number", "list": "a list", "dict": "a table"}[kind.__name__]
            raise IntegrityError(f"{what}: key '{where}{key}': expected {wanted}, got {value!r}; it was not used")
        return value

    def match(pattern: re.Pattern[str], value: str, key: str) -> str:
        if not pattern.fullmatch(value):
            raise IntegrityError(
                f"{what}: key '{key}': expected {pattern.pattern}, got {value[:80]!r}; it was not used"
            )
        return value

    if document.get("format") != FORMAT:
        raise IntegrityError(
            f"{what}: expected the format {FORMAT}, got {document.get('format')!r}; another version of oysterbench is "
            "needed to read it"
        )
    piece_size = take(document, "piece_size", int)
    if not 1 << 10 <= piece_size <= 1 << 26:
        raise IntegrityError(f"{what}: key 'piece_size': expected 1 KiB to 64 MiB, got {piece_size}; it was not used")
    entries = []
    for table in take(document, "files", list):
        if not isinstance(table, dict):
            raise IntegrityError(f"{what}: key 'files': expected tables, got {table!r}; it was not used")
        name = match(FILE_NAME, take(table, "name", str, "files."), "files.name")
        size = take(table, "size", int, "files.")
        pieces = take(table, "pieces", list, "files.")
        if size < 1 or len(pieces) != -(-size // piece_size):
            raise IntegrityError(f"{what}: {name}: {len(pieces)} pieces do not make {size} bytes; it was not used")
        for piece in pieces:
            match(SHA256, str(piece), "files.pieces")
        entries.append(
            FileEntry(
                name,
                size,
                match(SHA256, take(table, "sha256", str, "files."), "files.sha256"),
                piece_size,
                tuple(pieces),
                take(table, "content", dict, "files."),
                take(table, "attachments", dict, "files."),
                take(table, "duration_ns", int, "files."),
            )
        )
    if len({entry.name for entry in entries}) != len(entries):
        raise IntegrityError(f"{what}: key 'files': a name occurs twice; it was not used")
    return Manifest(
        split=match(NAME, take(document, "split", str), "split"),
        version=match(VERSION_NAME, take(document, "version", str), "version"),
        **{key: take(document, key, str) for key in ("track", "rig", "summary", "oysterbench")},
        files=tuple(entries),
        **{key: match(SHA256, take(document, key, str), key) for key in OPTIONAL if key in document},
    )


OPTIONAL = ("recipe_digest", "commitment")


def released_manifest(split: str, version: str) -> Manifest | None:
    """The manifest of a released split that comes with oysterbench (`datasets/manifests`): a pin like a key."""
    if not (NAME.fullmatch(split) and VERSION_NAME.fullmatch(version)):
        return None
    entry = resources.files("oysterbench_datasets") / "manifests" / f"{split}-{version}.json"
    return read_manifest(entry.read_bytes(), f"{split}-{version}.json of oysterbench") if entry.is_file() else None
