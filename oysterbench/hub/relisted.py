"""What a tree lists, published once more: the manifest or card by which it was released, also where that was lost."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path

from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
from msgspec.structs import replace

from oysterbench.core.errors import IntegrityError
from oysterbench.hub.canonical import sha256
from oysterbench.hub.index import ModelRelease, Release, read_own_index
from oysterbench.hub.manifest import Manifest, build_manifest, read_manifest, released_manifest
from oysterbench.hub.model import Model
from oysterbench.hub.pieces import hashed
from oysterbench.sequence.read import McapSequence
from oysterbench.version import VERSION

SAID = re.compile(rb'"oysterbench":"([\w.+!-]{1,40})"|Rendered by oysterbench ([\w.+!-]{1,40}) for the track')
"""Where manifests, cards and Croissant files, whole or damaged, name the version of oysterbench that wrote them."""


def is_listed(
    tree: Path, keys: Sequence[Ed25519PrivateKey], facts: Mapping[str, str], files: Mapping[str, Path]
) -> bool:
    """Whether a tree has this version of a split, and it has these very files (name -> path)."""
    release = read_own_index(tree, *keys).splits.get(facts["split"], {}).get(facts["version"])
    if release is None or not all(path.is_file() for path in files.values()):
        return False
    return listed_manifest(tree, release, facts, files) is not None


def listed_manifest(
    tree: Path, release: Release, facts: Mapping[str, str], files: Mapping[str, Path]
) -> Manifest | None:
    """Return the manifest of a version in a tree where these are its files, byte for byte, whatever its recipe says by
    now; None otherwise. One that was lost is made anew from the files."""
    manifest = kept_manifest_of(tree, release)
    if manifest is not None:
        there = {entry.sequence: (entry.size, entry.sha256) for entry in manifest.files}
        same = there == {name: hashed(path, manifest.piece_size)[:2] for name, path in files.items()}
        return manifest if same else None
    known = {**facts, "summary": release.summary, "track": release.track}
    # What is published in the open says itself which recipe made it (`check_made_by`).
    made_by = next((McapSequence(path).metadata.get("digest") for path in files.values()), None)
    made = build_manifest(known, files, made_by)
    candidates = (replace(made, oysterbench=version) for version in versions_said(tree))
    return next((found for found in candidates if found.sha256 == release.manifest), None)


def kept_manifest_of(tree: Path, release: Release) -> Manifest | None:
    """Read the manifest of a version from its tree, or the same one that ships with oysterbench; None where it was
    lost or damaged."""
    path = tree / "manifests" / f"{release.manifest}.json"
    with suppress(FileNotFoundError, IntegrityError):
        data = path.read_bytes()
        if sha256(data) == release.manifest:
            return read_manifest(data, str(path))
    shipped = released_manifest(release.split, release.version)
    return shipped if shipped is not None and shipped.sha256 == release.manifest else None


def hidden_manifests(
    tree: Path,
    release: Release | None,
    package: Path,
    facts: Mapping[str, str],
    shown: Mapping[str, Path],
    kept: Mapping[str, Path],
) -> tuple[Manifest, Manifest]:
    """Build the public manifest of a hidden split and that of its truth package: where the tree has this version or
    the package is there, with the version of oysterbench that made them those; otherwise, with this one.

    package: path of the package's manifest, which may be absent; shown, kept: files without the truth, and the truth
    """
    if release is not None:
        earlier = kept_manifest_of(tree, release)
        facts = {**facts, "summary": release.summary, "track": release.track}
        facts |= {"rig": earlier.rig} if earlier else {}
    truth, public = build_manifest(facts, kept), build_manifest(facts, shown)
    there = sha256(package.read_bytes()) if package.is_file() else ""
    pairs = []
    for version in (truth.oysterbench, *versions_said(tree, package)):
        secret = replace(truth, oysterbench=version)
        pairs.append((replace(public, oysterbench=version, commitment=secret.sha256), secret))
    wanted = [pair for pair in pairs if release is not None and pair[0].sha256 == release.manifest]
    wanted += [pair for pair in pairs if pair[1].sha256 == there]
    return (wanted or pairs)[0]


def listed_card(tree: Path, release: ModelRelease, model: Model) -> Model:
    """Return a model by the card that a tree lists, where only the version of oysterbench in it is another."""
    candidates = (replace(model, oysterbench=version) for version in versions_said(tree))
    return next((found for found in candidates if found.sha256 == release.card), model)


def versions_said(tree: Path, *more: Path) -> list[str]:
    """Versions of oysterbench that the documents of a tree, and `more`, name, and this one."""
    documents = [path for kind in ("manifests", "models", "croissant") for path in sorted(tree.glob(f"{kind}/*.json"))]
    found = {VERSION: None}
    for path in (*more, *documents):
        if path.is_file():
            found |= {(one or other).decode(): None for one, other in SAID.findall(path.read_bytes())}
    return list(found)
