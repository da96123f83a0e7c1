"""Publishing a split's files into a static tree. Every write is atomic, and publishing twice adds nothing."""

from __future__ import annotations

import hashlib
import os
import tempfile
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager
from datetime import UTC, datetime
from functools import lru_cache
from pathlib import Path

from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey

from oysterbench.core.atomic import appearing, write_atomically
from oysterbench.core.errors import HubError, IntegrityError
from oysterbench.core.locks import locked
from oysterbench.core.names import listed
from oysterbench.hub.canonical import sha256
from oysterbench.hub.croissant import croissant
from oysterbench.hub.index import Index, Release, read_own_index
from oysterbench.hub.manifest import Manifest, build_manifest, read_manifest, released_manifest
from oysterbench.hub.pages import index_page, pictures_of
from oysterbench.hub.pieces import hashed
from oysterbench.hub.relisted import hidden_manifests, kept_manifest_of, listed_manifest
from oysterbench.hub.sign import public_hex
from oysterbench.hub.verify import MANIFEST
from oysterbench.sequence.cut import cut_public, cut_truth, is_scorable
from oysterbench.sequence.read import McapSequence

TEMPORARY = ".publishing-"
COPY = 1 << 20

Announce = Callable[[str], None]
"""Called with a sentence on what is being done."""


def publish(
    tree: Path,
    facts: Mapping[str, str],
    files: Mapping[str, Path],
    key: Ed25519PrivateKey,
    recipe_digest: str | None = None,
    url: str = "",
    announce: Announce = lambda text: None,
    old_keys: Sequence[Ed25519PrivateKey] = (),
    truth: Path | None = None,
) -> Manifest:
    """Publish the sequence files (name -> path) of a split; facts: split, version, track, rig and summary.

    Blobs go first, the signed index last: whoever reads the tree in between sees the old one. Earlier keys sign the
    index too, so that it still works for those who pin them. truth: for a hidden split, the folder for its truth
    package; only what may be seen is published. Raises HubError where the version was released with other bytes, and
    then leaves tree and truth as they were.
    """
    keys = (key, *old_keys)
    with writing(tree, *keys) as index, tempfile.TemporaryDirectory(dir=tree, prefix=TEMPORARY) as scratch:
        known = index.splits.get(facts["split"], {}).get(facts["version"])
        package = None if truth is None else _package(tree, truth, facts)
        if truth is None or package is None:
            announce(f"hashing {len(files)} sequences")
            listed = listed_manifest(tree, known, facts, files) if known else None
            manifest = _as_released(listed or build_manifest(facts, files, recipe_digest))
            _check_unchanged(tree, index, manifest)
        else:
            with tempfile.TemporaryDirectory(dir=truth, prefix=TEMPORARY) as draft:
                files, kept = _without_truth(files, Path(scratch), Path(draft), announce)
                announce(f"hashing {len(files)} sequences")
                manifest, secret = hidden_manifests(tree, known, package / MANIFEST, facts, files, kept)
                _check_unchanged(tree, index, manifest)
                _keep_truth(Path(draft), secret, package, known is not None)
        _release(tree, keys, index, manifest, files, url, announce)
    return manifest


def _as_released(manifest: Manifest) -> Manifest:
    """Return the manifest that ships with oysterbench, where there is one. Raises HubError where its files differ, as
    clients accept no others under its name."""
    released = released_manifest(manifest.split, manifest.version)
    if released is None:
        return manifest
    differing = [entry.name for entry in manifest.files if entry != released.find(entry.name)]
    if differing or len(manifest.files) != len(released.files):
        raise HubError(
            f"{manifest.split} {manifest.version} was released with other files ({', '.join(differing[:5])}), and "
            f"clients accept only those; nothing was published: `oysterbench verify {manifest.split}` says what differs"
        )
    return released


def _package(tree: Path, truth: Path, facts: Mapping[str, str]) -> Path:
    """Folder of a hidden split's truth package, `<truth>/<split>-<version>/`, within `truth`, which is made. Raises
    HubError where it is in the tree."""
    package = truth / f"{facts['split']}-{facts['version']}"
    if tree.resolve() in (package.resolve(), *package.resolve().parents):
        raise HubError(f"{truth}: expected a folder outside the tree {tree}, which is public")
    truth.mkdir(parents=True, exist_ok=True)
    return package


def _without_truth(
    files: Mapping[str, Path], scratch: Path, draft: Path, announce: Announce
) -> tuple[dict[str, Path], dict[str, Path]]:
    """Split off the ground truth: public files of a hidden split, in `scratch`, and those of its truth package, in
    `draft`, with what was withheld of each.

    The SHA-256 of the package's manifest is the commitment in the public manifest. So nobody can replace the truth
    later.
    """
    shown, kept = {}, {}
    for name, path in files.items():
        announce(f"removing the ground truth from {name}")
        shown[name], kept[name] = scratch / f"{name}.mcap", draft / f"{name}.mcap"
        with open(shown[name], "wb") as file:
            cut_public(path, file)
        with appearing(kept[name], TEMPORARY) as hidden:
            cut_truth(path, hidden)
    return shown, kept


def _keep_truth(draft: Path, secret: Manifest, package: Path, released: bool) -> None:
    """Move a truth package to its place, its `manifest.json` last. Raises HubError where another one is there, which a
    released split may be committed to. released: whether it is to this one, so that a damaged one is written again"""
    known = package / MANIFEST
    there = sha256(known.read_bytes()) if known.is_file() else secret.sha256
    if there != secret.sha256 and not (released and _is_damaged(package, secret)):
        raise HubError(
            f"{known}: the truth of another render of {secret.split} {secret.version} is there (SHA-256 {there[:12]}…, "
            f"now {secret.sha256[:12]}…); it was left unchanged and nothing was published: raise the version in the "
            "split's recipe, or delete that package if it was never released"
        )
    package.mkdir(exist_ok=True)
    for entry in secret.files:
        os.replace(draft / entry.name, package / entry.name)
    write_atomically(known, secret.data)


def _is_damaged(package: Path, secret: Manifest) -> bool:
    """Whether the manifest of a truth package cannot be read, or lies beside the very files of the right one."""
    try:
        read_manifest((package / MANIFEST).read_bytes(), str(package))
    except IntegrityError:
        return True
    paths = [(package / entry.name, entry) for entry in secret.files]
    return all(path.is_file() and hashed(path)[1] == entry.sha256 for path, entry in paths)


def check_made_by(
    files: Mapping[str, Path],
    split: str,
    version: str,
    digest: str,
    hidden: bool,
    topics: Mapping[str, Collection[str]] | None = None,
    texts: Mapping[str, bytes] | None = None,
) -> None:
    """Raise HubError unless the files are of this split and version, made with the recipe's own digest; if hidden, with
    another one, which only a salt gives, as without a salt anybody could render the ground truth, and with the ground
    truth to commit to.

    topics: sequence -> all topics of its rig, none of which may be missing: a release never changes. texts: of recipe
    and rig (`SplitRecipe.texts`), which the files, unless hidden, have to keep: or nobody's render would be the same
    """
    for name, path in files.items():
        if not path.is_file():
            raise HubError(
                f"{path}: does not exist yet; `oysterbench render {split}` makes it, or --data names its folder"
            )
        sequence = McapSequence(path)
        known = sequence.metadata
        if (known.get("sequence"), known.get("split"), known.get("split_version")) != (name, split, version):
            raise HubError(
                f"{path}: expected {name} of {split} {version}, got {known.get('sequence')} of {known.get('split')} "
                f"{known.get('split_version')}; nothing was published"
            )
        made_with = known.get("digest")
        if hidden and made_with == digest:
            raise HubError(
                f"{path}: rendered without a salt, so anyone can render its ground truth; nothing was published: "
                "render a hidden split with its salt"
            )
        if hidden and (made_with is None or not is_scorable(sequence)):
            raise HubError(
                f"{path}: has no ground truth to withhold: it is as teams get it, or was rendered with --topics; "
                "nothing was published: --data names the folder of the files as rendered with the salt"
            )
        if not hidden and made_with != digest:
            raise HubError(
                f"{path}: made by another recipe of {split}, with a salt, or by another version of oysterbench; "
                f"nothing was published: `oysterbench render {split}` makes what the recipe says, and --hidden "
                "publishes what was rendered with a salt"
            )
        for text, data in (texts or {}).items():
            if not hidden and sequence.attachments.get(text) != data:
                raise HubError(
                    f"{path}: made from another text of {text} than the recipe has now (a comment counts); nothing was "
                    "published: put that text back, or delete the file and render it again"
                )
        if absent := sorted({*(topics or {}).get(name, ())} - {*sequence.types}):
            raise HubError(
                f"{path}: expected all topics of its rig, got none of {listed(absent)}; nothing was published: render "
                "it without --topics, or name the folder of the whole files with --data"
            )


@contextmanager
def writing(tree: Path, *keys: Ed25519PrivateKey) -> Iterator[Index]:
    """Hold exclusive write access to a tree, remove what an interrupted publisher left, and yield the index."""
    tree.mkdir(parents=True, exist_ok=True)
    with locked(tree / ".lock"):
        for left in (*tree.glob(f"{TEMPORARY}*"), *tree.glob(f"*/{TEMPORARY}*")):
            if left.is_dir():
                for file in left.iterdir():
                    file.unlink()
                left.rmdir()
            else:
                left.unlink()
        yield read_own_index(tree, *keys)


def _check_unchanged(tree: Path, index: Index, manifest: Manifest) -> None:
    """Raise HubError where the index has a model of the split's name, or this version with another manifest."""
    if manifest.split in index.models:
        raise HubError(f"{manifest.split}: a model in {tree} has this name, and `download` finds both by name")
    known = index.splits.get(manifest.split, {}).get(manifest.version)
    if known is None or known.manifest == manifest.sha256:
        return
    if kept_manifest_of(tree, known) is None:
        raise HubError(
            f"{tree / 'manifests' / known.manifest}.json: damaged or missing, and these files cannot make it again "
            "(others than were released, or described otherwise by this version of oysterbench); the tree was left "
            "unchanged: copy it from a mirror of the tree"
        )
    raise HubError(
        f"{manifest.split} {manifest.version} was released with other bytes (manifest {known.manifest[:12]}…, now "
        f"{manifest.sha256[:12]}…) and a release never changes; the tree was left unchanged: raise the version in "
        "the split's recipe"
    )


def _release(
    tree: Path,
    keys: Sequence[Ed25519PrivateKey],
    index: Index,
    manifest: Manifest,
    files: Mapping[str, Path],
    url: str,
    announce: Announce,
) -> None:
    """Put everything that is not there yet into the tree, and list it in the index. What was lost of an earlier
    release is made again where that gives the same bytes."""
    for entry in manifest.files:
        new = put_blob(tree, files[entry.sequence], entry.sha256)
        announce(f"{entry.name}, {entry.size / 1e6:.1f} MB: {'published' if new else 'already there'}")
    put(tree / "manifests" / f"{manifest.sha256}.json", manifest.data)
    known = index.splits.get(manifest.split, {}).get(manifest.version)
    published = known.published if known else datetime.now(UTC).date().isoformat()
    described = croissant(manifest, published, url)
    if known is not None:
        put_again(tree / "croissant" / f"{known.croissant}.json", lambda: [described], announce)
        pictures = lru_cache(lambda: pictures_of(list(files.values())))
        for digest in known.pictures:
            put_again(tree / "pictures" / f"{digest}.jpg", pictures, announce)
    else:
        put(tree / "croissant" / f"{sha256(described)}.json", described)
        drawn = pictures_of(list(files.values()))
        for picture in drawn:
            put(tree / "pictures" / f"{sha256(picture)}.jpg", picture)
        release = Release(
            split=manifest.split,
            version=manifest.version,
            manifest=manifest.sha256,
            manifest_size=len(manifest.data),
            size=manifest.size,
            sequences=len(manifest.files),
            track=manifest.track,
            summary=manifest.summary,
            hidden=manifest.hidden,
            published=published,
            croissant=sha256(described),
            pictures=tuple(sha256(picture) for picture in drawn),
        )
        index = index.with_release(release)
    put_index(tree, index, keys)


def put_index(tree: Path, index: Index, keys: Sequence[Ed25519PrivateKey]) -> None:
    """Sign and write the index, which makes everything put before visible, and its page."""
    put(tree / "index.json", index.signed_with(*keys))
    put(tree / "index.html", index_page(index, public_hex(keys[0])).encode())


def put_blob(tree: Path, source: Path, digest: str) -> bool:
    """Copy a file into `blobs/` under its hash, which is checked while copying. Return False if it was there already.

    A blob that is there already is trusted by its size: it appeared complete. `oysterbench verify` reads it again.
    """
    path = tree / "blobs" / digest
    if path.is_file() and path.stat().st_size == source.stat().st_size:
        return False
    whole = hashlib.sha256()
    with open(source, "rb") as original, appearing(path, TEMPORARY) as copy:
        while data := original.read(COPY):
            whole.update(data)
            copy.write(data)
        if whole.hexdigest() != digest:
            raise HubError(f"{source} changed while it was published; nothing was released: run the same command again")
    return True


def put(path: Path, data: bytes) -> None:
    """Write a file unless it already has this content."""
    if not path.is_file() or path.read_bytes() != data:
        write_atomically(path, data)


def put_again(path: Path, candidates: Callable[[], Sequence[bytes]], announce: Announce) -> None:
    """Write a file that the index names by its SHA-256 again, where it is damaged or missing and one of the candidates
    has that hash. Otherwise announce that only a copy helps."""
    if path.is_file() and sha256(path.read_bytes()) == path.stem:
        return
    found = next((data for data in candidates() if sha256(data) == path.stem), None)
    if found is not None:
        put(path, found)
        announce(f"{path}: written again")
    else:
        announce(
            f"{path}: damaged or missing, and made otherwise by this version of oysterbench or with this --url: copy "
            "it from a mirror of the tree"
        )
