"""The index: the one mutable document of a hub, signed; it names the manifest of each version of each split, and the
card of each version of each model."""

from __future__ import annotations

import contextlib
import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal, TypeVar

import msgspec
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey

from oysterbench.core.atomic import write_atomically
from oysterbench.core.errors import IntegrityError
from oysterbench.core.locks import locked
from oysterbench.core.places import home
from oysterbench.hub.canonical import Sha256, canonical, decode, sha256
from oysterbench.hub.manifest import SplitName, SplitVersion
from oysterbench.hub.model import ModelName, ModelVersion
from oysterbench.hub.sign import is_signed, public_hex, sign

LARGEST = 8 << 20
"""Size limit of an index that a client reads, bytes."""


class Release(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A version of a split, as listed in the index; `size` is that of all files, `manifest_size` its manifest's."""

    split: SplitName
    version: SplitVersion
    manifest: Sha256
    manifest_size: int
    size: int
    sequences: int
    track: str
    summary: str
    hidden: bool
    published: str  # date, UTC
    croissant: Sha256
    pictures: tuple[Sha256, ...] = ()


class ModelRelease(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A version of a model, as listed in the index; `size` is that of its weights, `card_size` its card's.

    page: the card for people, HTML
    """

    model: ModelName
    version: ModelVersion
    card: Sha256
    card_size: int
    size: int
    methods: tuple[str, ...]
    summary: str
    published: str  # date, UTC
    page: Sha256


class IndexBody(msgspec.Struct, kw_only=True, omit_defaults=True):
    """The signed part of an index. Lists, because the order of versions matters, and that of keys is not kept."""

    format: Literal["oysterbench-index/1"]
    counter: int
    splits: list[Release]
    models: list[ModelRelease] = []


class Signature(msgspec.Struct):
    """A signature of an index; `is_signed` tells whether it is valid."""

    key: str = ""
    signature: str = ""


class SignedIndex(msgspec.Struct):
    """The index document. signed: an `IndexBody`, decoded only once its signature has been verified."""

    signed: dict[str, Any]
    signatures: list[Signature]

    @property
    def signed_bytes(self) -> bytes:
        """Bytes that the signatures cover: what was read, written again, so that there is no second way to read it.
        Empty where it cannot be written again."""
        try:
            return canonical(self.signed)
        except (ValueError, RecursionError):
            return b""

    def unsigned(self) -> list[str]:
        """Keys that the index names but whose signatures are not valid."""
        return [one.key for one in self.signatures if not is_signed(one.key, self.signed_bytes, one.signature)]


class SeenIndex(msgspec.Struct):
    """The newest index of a key, as a client remembers it; sha256: of its body."""

    counter: int = -1
    sha256: str = ""


R = TypeVar("R", Release, ModelRelease)


@dataclass(frozen=True)
class Index:
    """Content of an index. counter: increased by each change, so that an older index can be recognised.

    splits, models: name -> version -> release, versions in the order of their release.
    """

    counter: int = 0
    splits: dict[str, dict[str, Release]] = field(default_factory=dict)
    models: dict[str, dict[str, ModelRelease]] = field(default_factory=dict)

    def with_release(self, release: Release) -> Index:
        """The next index: this one with one more release of a split."""
        return Index(self.counter + 1, _with(self.splits, release.split, release), self.models)

    def with_model(self, release: ModelRelease) -> Index:
        """The next index: this one with one more release of a model."""
        return Index(self.counter + 1, self.splits, _with(self.models, release.model, release))

    def signed_with(self, *keys: Ed25519PrivateKey) -> bytes:
        """Encode the index as a document with its signatures: by one key or, while users change keys, by several."""
        body = msgspec.to_builtins(
            IndexBody(
                format="oysterbench-index/1",
                counter=self.counter,
                splits=in_order(self.splits),
                models=in_order(self.models),
            )
        )
        signatures = [{"key": public_hex(key), "signature": sign(key, canonical(body))} for key in keys]
        return json.dumps({"signed": body, "signatures": signatures}, indent=1).encode() + b"\n"


def in_order(releases: Mapping[str, Mapping[str, R]]) -> list[R]:
    """All releases, sorted by name, with versions in the order of their release."""
    return [release for _, versions in sorted(releases.items()) for release in versions.values()]


def _with(releases: Mapping[str, Mapping[str, R]], name: str, release: R) -> dict[str, dict[str, R]]:
    """Copy of the releases with one more."""
    found = {known: dict(versions) for known, versions in releases.items()}
    found.setdefault(name, {})[release.version] = release
    return found


def read_index(data: bytes, public: str, what: str) -> Index:
    """Read an index. Raises IntegrityError unless the key signed it, whatever else is in it."""
    document = decode(data, SignedIndex, what)
    signed = document.signed_bytes
    if not any(is_signed(public, signed, one.signature) for one in document.signatures):
        if any(one.key == public for one in document.signatures):
            raise IntegrityError(
                f"{what}: not signed with the key {public[:16]}… that it names and that is trusted here: the signature "
                "is wrong, so it was altered on the way, at the mirror or since; nothing of it was used: use another "
                "mirror, or tell the hub's owner"
            )
        raise IntegrityError(
            f"{what}: not signed with the key {public[:16]}… that is trusted here (it names "
            f"{', '.join(one.key[:16] + '…' for one in document.signatures) or 'no key'}); nothing of it was used: ask "
            "the hub's owner for its key and give it with --key, or use another mirror"
        )
    body = decode(signed, IndexBody, f"{what}: well signed, but not readable")
    splits: dict[str, dict[str, Release]] = {}
    for release in body.splits:
        splits.setdefault(release.split, {})[release.version] = release
    models: dict[str, dict[str, ModelRelease]] = {}
    for one in body.models:
        models.setdefault(one.model, {})[one.version] = one
    return Index(body.counter, splits, models)


def check_not_older(index: Index, data: bytes, public: str, what: str) -> None:
    """Remember the newest index of a key, and refuse an older one, or a different one of the same age.

    It is remembered in `hub/<public key>.json` in the home folder. A mirror that serves old, validly signed indexes
    could otherwise withhold a corrected split for ever. Raises IntegrityError.
    """
    path = home() / "hub" / f"{public}.json"
    known = SeenIndex(index.counter, sha256(canonical(decode(data, SignedIndex, what).signed)))
    with locked(path.with_suffix(".lock")):
        seen = decode(path.read_bytes(), SeenIndex, str(path)) if path.is_file() else SeenIndex()
        if known.counter < seen.counter:
            raise IntegrityError(
                f"{what}: index number {known.counter} is older than number {seen.counter}, which was seen before: "
                f"the mirror is out of date or hostile; nothing was used: try another one (or delete {path} if the hub "
                "was set up anew)"
            )
        if known.counter == seen.counter and known.sha256 != seen.sha256:
            raise IntegrityError(
                f"{what}: there are two indexes with number {known.counter}; nothing was used: ask the hub's owner, "
                f"and delete {path} if the hub was set up anew"
            )
        if known.counter > seen.counter:
            write_atomically(path, canonical(msgspec.to_builtins(known)))


def read_own_index(folder: Path, *keys: Ed25519PrivateKey) -> Index:
    """Read the index of a tree to publish to, or an empty one where there is none yet.

    Raises IntegrityError where none of the keys signed it.
    """
    path = folder / "index.json"
    if not path.is_file():
        return Index()
    first, *others = (public_hex(key) for key in keys)
    for public in others:
        with contextlib.suppress(IntegrityError):
            return read_index(path.read_bytes(), public, str(path))
    return read_index(path.read_bytes(), first, str(path))
