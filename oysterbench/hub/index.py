"""The index: the one mutable document of a hub, signed; it names the manifest of each version of each split."""

from __future__ import annotations

import contextlib
import json
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey

from oysterbench.core.errors import IntegrityError
from oysterbench.core.files import home, locked, write_atomically
from oysterbench.hub.canonical import SHA256, canonical, parse, sha256
from oysterbench.hub.manifest import NAME, VERSION_NAME
from oysterbench.hub.sign import is_signed, public_hex, sign

FORMAT = "oysterbench-index/1"
LARGEST = 8 << 20
"""Bytes of an index or manifest that a client reads at most."""


@dataclass(frozen=True)
class Release:
    """A version of a split, as the index names it; `size` is that of all files, `manifest_size` its manifest's."""

    manifest: str
    manifest_size: int
    size: int
    sequences: int
    track: str
    summary: str
    hidden: bool
    published: str  # date, UTC
    croissant: str  # SHA-256
    pictures: tuple[str, ...] = ()  # SHA-256 of each


@dataclass(frozen=True)
class Index:
    """counter: raised by each change, so that an older index is known for one.

    splits: name -> version -> release, versions in the order of their release.
    """

    counter: int = 0
    splits: dict[str, dict[str, Release]] = field(default_factory=dict)

    def with_release(self, split: str, version: str, release: Release) -> Index:
        """The next index: this one with a release more."""
        splits = {name: dict(versions) for name, versions in self.splits.items()}
        splits.setdefault(split, {})[version] = release
        return Index(self.counter + 1, splits)

    def signed_with(self, *keys: Ed25519PrivateKey) -> bytes:
        """The index as a document with its signatures: of one key or, while users change keys, of several."""
        body = {
            "format": FORMAT,
            "counter": self.counter,
            # A list, because the order of the versions matters and that of a table's keys does not.
            "splits": [
                {"split": name, "version": version, **vars(release), "pictures": list(release.pictures)}
                for name, versions in sorted(self.splits.items())
                for version, release in versions.items()
            ],
        }
        signatures = [{"key": public_hex(key), "signature": sign(key, canonical(body))} for key in keys]
        return json.dumps({"signed": body, "signatures": signatures}, indent=1).encode() + b"\n"


def read_index(data: bytes, public: str, what: str) -> Index:
    """An index that the key signed. Raises IntegrityError where it is not, whatever else is in it."""
    document = parse(data, what)
    body, signatures = document.get("signed"), document.get("signatures")
    found = signatures if isinstance(signatures, list) else []
    try:
        signed = canonical(body)  # of what was read, so that there is no second way to read it
    except (ValueError, UnicodeEncodeError):
        signed = b""
    known = [str(entry.get("key")) for entry in found if isinstance(entry, dict)]
    if not any(
        isinstance(entry, dict) and is_signed(public, signed, str(entry.get("signature", ""))) for entry in found
    ):
        raise IntegrityError(
            f"{what}: not signed with the key {public[:16]}… that is trusted here (it names "
            f"{', '.join(key[:16] + '…' for key in known) or 'no key'}); nothing of it was used: ask the hub's owner "
            "for its key and give it with --key, or use another mirror"
        )
    if not isinstance(body, dict) or body.get("format") != FORMAT:
        raise IntegrityError(f"{what}: expected the format {FORMAT}; another version of oysterbench is needed")
    splits: dict[str, dict[str, Release]] = {}
    try:
        counter = int(body["counter"])
        for entry in body["splits"]:
            values: dict[str, Any] = dict(entry)
            name, version = values.pop("split"), values.pop("version")
            release = Release(**{**values, "pictures": tuple(values["pictures"])})
            hashes = (release.manifest, release.croissant, *release.pictures)
            if not (NAME.fullmatch(name) and VERSION_NAME.fullmatch(version)):
                raise ValueError(f"the name {name!r} {version!r}")
            if not all(SHA256.fullmatch(value) for value in hashes):
                raise ValueError("a hash that is none")
            splits.setdefault(name, {})[version] = release
    except (KeyError, TypeError, ValueError) as error:
        raise IntegrityError(f"{what}: well signed, but not readable ({error}); it was not used") from None
    return Index(counter, splits)


def check_not_older(index: Index, data: bytes, public: str, what: str) -> None:
    """Remember the newest index of a key, and refuse one that is older, or another one of the same age.

    The memory is `hub/<public key>.json` in the home folder. A mirror that serves old, well signed indexes could
    otherwise keep back a corrected split for ever.
    """
    path = home() / "hub" / f"{public}.json"
    known = {"counter": index.counter, "sha256": sha256(canonical(json.loads(data)["signed"]))}
    with locked(path.with_suffix(".lock")):
        seen: dict[str, Any] = {"counter": -1, "sha256": ""}
        if path.is_file():
            seen |= parse(path.read_bytes(), str(path))
        if index.counter < int(seen["counter"]):
            raise IntegrityError(
                f"{what}: index number {index.counter} is older than number {seen['counter']}, which was seen before: "
                f"the mirror is out of date or hostile; nothing was used: try another one (or delete {path} if the hub "
                "was set up anew)"
            )
        if index.counter == int(seen["counter"]) and known["sha256"] != seen["sha256"]:
            raise IntegrityError(
                f"{what}: there are two indexes with number {index.counter}; nothing was used: ask the hub's owner, "
                f"and delete {path} if the hub was set up anew"
            )
        if index.counter > int(seen["counter"]):
            write_atomically(path, canonical(known))


def read_own_index(folder: Path, *keys: Ed25519PrivateKey) -> Index:
    """The index of a tree that is published to, or an empty one where there is none yet.

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
