"""Verification of files on disk against a manifest."""

from __future__ import annotations

import contextlib
import hashlib
from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING

from oysterbench.core.errors import HubError, IntegrityError, SequenceError
from oysterbench.core.mcap import MAGIC
from oysterbench.core.names import did_you_mean, nearest
from oysterbench.core.places import home, models, released_models
from oysterbench.hub.canonical import decode, sha256
from oysterbench.hub.index import IndexBody, SignedIndex
from oysterbench.hub.manifest import (
    NAME,
    VERSION_NAME,
    FileEntry,
    Manifest,
    partial_manifest,
    read_manifest,
    released_manifest,
)
from oysterbench.hub.model import Model, read_model
from oysterbench.hub.release import made_with
from oysterbench.hub.trusted import is_trusted
from oysterbench.recipe import split_names

if TYPE_CHECKING:
    from oysterbench.hub.content import Content

MANIFEST = "manifest.json"
"""Name of the manifest next to the files of a split."""

SMALLER_FILES = "topics-*/*.mcap"
"""Pattern of smaller files in the folder of a split (`sequence.cut.topics_folder`)."""

ASIDE = ".{}.damaged"
"""Name under which a damaged file is set aside, by its own, while another is rendered in its place."""

FOLDERS = ("blobs", "cards", "croissant", "manifests", "models", "pictures")
"""Folders of a tree whose files are named by their hash."""

AGAIN = "publish its split or model again, or copy it from a mirror"
"""What repairs a file of a tree."""

RIGHT, REPACKED, SMALLER = "right", "same content, other bytes", "right, with some of the topics"
ALIKE, OTHER = "alike", "other content"
DAMAGED, ABSENT, UNKNOWN, FOREIGN = "damaged", "absent", "no manifest", "no sequence of oysterbench"


@dataclass(frozen=True)
class Check:
    """Outcome of checking a file: `state` is one of the words above, `detail` says more. named: whether it was to be
    checked by itself, not as one of a folder"""

    path: Path
    state: str
    detail: str = ""
    named: bool = True

    @property
    def good(self) -> bool:
        """Whether the data can be used, or is none that was asked for."""
        return self.state in (RIGHT, REPACKED, SMALLER, ALIKE, UNKNOWN) or (self.state == FOREIGN and not self.named)


def check_file(path: Path, entry: FileEntry, smaller: bool = False) -> Check:
    """Read a file and compare it with its entry: bytes first and, where they differ, the content; where that differs
    too, a sample of the pixels.

    A file is alike if its images are within one grey level on 99.9 % of these pixels, and it is the same otherwise.
    smaller: whether a file with only some of the topics is good too, judged by those that it has
    """
    if not path.is_file():
        return Check(path, ABSENT)
    whole, wrong, size = hashlib.sha256(), [], 0
    with open(path, "rb") as file:
        for number, data in enumerate(iter(lambda: file.read(entry.piece_size), b"")):
            whole.update(data)
            size += len(data)
            if number >= len(entry.pieces) or sha256(data) != entry.pieces[number]:
                wrong.append(number)
    if whole.hexdigest() == entry.sha256:
        return Check(path, RIGHT)
    from oysterbench.hub.content import content_of  # code that reads messages is loaded only when needed

    try:
        content = content_of(path)
    except SequenceError as error:
        if smaller:  # pieces and size are those of the complete one
            return Check(path, DAMAGED, str(error))
    else:
        return _check_content(path, content, entry, smaller)
    if size != entry.size:
        return Check(path, DAMAGED, f"expected {entry.size} bytes, got {size}")
    return Check(
        path,
        DAMAGED,
        f"{len(wrong)} of {len(entry.pieces)} pieces are wrong, the first at byte {wrong[0] * entry.piece_size}",
    )


def _check_content(path: Path, content: Content, entry: FileEntry, smaller: bool) -> Check:
    """Compare the content of an undamaged file with its entry."""
    wrong: list[str] = []
    alike: list[str] = []
    for topic, here in sorted(content.topics.items()):
        there = entry.content.get(topic)
        if there is None:
            wrong.append(f"{topic} is not expected")
        elif (here["type"], here["messages"]) != (there["type"], there["messages"]):
            wrong.append(f"{topic} has {here['messages']} messages, expected {there['messages']}")
        elif here["sha256"] != there["sha256"] and not ("pixels" in here and "pixels" in there):
            wrong.append(f"{topic} differs")
        elif here["sha256"] != there["sha256"]:
            from oysterbench.hub.pixels import SHARE, share_within

            share = share_within(topic, here["pixels"], there["pixels"])
            told = f"{topic} is within a grey level on {100.0 * share:.5g} % of the pixels checked"
            (alike if share >= SHARE else wrong).append(told)
    for name in sorted({*content.attachments, *entry.attachments}):
        if content.attachments.get(name) != entry.attachments.get(name):
            wrong.append(f"{name} differs")
    absent = sorted(entry.content.keys() - content.topics.keys())
    if not smaller or not content.topics:
        wrong += [f"{topic} is absent" for topic in absent]
    some = [f"{len(content.topics)} of {len(entry.content)} topics"] if absent and smaller else []
    if wrong:
        return Check(path, OTHER, ", ".join([*wrong, *alike, *some]))
    if alike:
        return Check(path, ALIKE, ", ".join([*alike, *some]))
    if some:
        return Check(path, SMALLER, some[0])
    return Check(path, REPACKED, "all messages and attachments are right, but packed differently")


def check_released(path: Path, manifest: Manifest) -> Check:
    """Check a sequence file against a released manifest; where it differs, state the possible cause.

    Raises SequenceError where the file is so damaged that it does not say which sequence it is.
    """
    known = _metadata(path)
    entry = manifest.find(f"{known.get('sequence')}.mcap")
    if entry is None:
        return check_unknown(path)
    check = check_file(path, entry, smaller=known.get("digest") == manifest.recipe_digest)
    if check.state not in (REPACKED, ALIKE, OTHER):
        return check
    if known.get("digest") != manifest.recipe_digest:
        cause = "made by another recipe or generation than the released one"
    else:
        here = made_with()
        there = (manifest.made_with or {}).items()
        other = [f"{what} {then} (here {here.get(what, 'none')})" for what, then in there if here.get(what) != then]
        cause = f"released with {', '.join(other)}" if other else ""
    return replace(check, detail="; ".join(filter(None, (check.detail, cause))))


def _metadata(path: Path) -> dict[str, str]:
    """What a file says about itself; empty for that of another program. Raises SequenceError where it is damaged."""
    from oysterbench.sequence.file import Reading, read_metadata
    from oysterbench.sequence.read import METADATA

    with Reading(path) as (file, summary):
        return read_metadata(file, summary).get(METADATA, {})


def claims(path: Path, split: str, version: str, digest: str | None) -> bool:
    """Whether a file, which may be damaged behind its beginning, says there that it is the sequence of its name, of
    this split, version and digest of the recipe (None: a hidden one). Any other may be somebody's own."""
    from oysterbench.sequence.file import first_metadata
    from oysterbench.sequence.read import METADATA

    known = first_metadata(path, METADATA)
    found = [known.get(key) for key in ("sequence", "split", "split_version", "digest")]
    return found == [path.stem, split, version, digest]


def _is_foreign(path: Path) -> bool:
    """Whether a file, which may be damaged or broken off later, says at its beginning that another program wrote it,
    and not that it is a sequence."""
    from oysterbench.sequence.file import LIBRARY, first_library, first_metadata
    from oysterbench.sequence.read import METADATA

    return first_library(path) not in ("", LIBRARY) and not first_metadata(path, METADATA)


def check_unknown(path: Path) -> Check:
    """Check a file without a manifest, using its own checksums."""
    from oysterbench.hub.content import content_of

    if not path.is_file():
        return Check(path, ABSENT)
    try:
        content_of(path)
    except SequenceError as error:
        return Check(path, DAMAGED, str(error))
    return Check(path, UNKNOWN, "its own checksums are right; whether it is the released file is unknown")


def kept_manifest(folder: Path) -> Manifest | None:
    """Read the manifest that a download left next to its files; None where there is none, it has been damaged, or it
    is another one than ships with oysterbench for this version: then it vouches for nothing, and files are read
    instead."""
    path = folder / MANIFEST
    if not path.is_file():
        return None
    try:
        manifest = read_manifest(path.read_bytes(), str(path))
    except IntegrityError:
        return None
    released = released_manifest(manifest.split, manifest.version)
    return manifest if released is None or released == manifest else None


def kept_card(path: Path) -> Model | None:
    """Read the card that a download left next to a weights file, which may since have been damaged or replaced; None
    where there is none, or it is damaged itself."""
    card = path.with_suffix(".json")
    try:
        return read_model(card.read_bytes(), str(card)) if card.is_file() else None
    except IntegrityError:
        return None


def check_weights(path: Path) -> Check:
    """Check a weights file against the card next to it."""
    card = kept_card(path)
    if not path.is_file():
        return Check(path, ABSENT)
    if card is None and path.with_suffix(".json").is_file():
        again = f"`oysterbench download {path.stem} --again` writes it anew"
        return Check(path.with_suffix(".json"), DAMAGED, f"not a card that can be read; {again}")
    if card is None:
        return Check(path, UNKNOWN, "trained here")
    with open(path, "rb") as file:
        digest = hashlib.file_digest(file, "sha256").hexdigest()
    if digest == card.file.sha256:
        return Check(path, RIGHT)
    if path.parent == released_models():
        again = "it is part of oysterbench: install that again"
    else:
        again = f"`oysterbench download {card.name} --again` downloads it again"
    return Check(path, DAMAGED, f"expected {card.name} {card.version}, SHA-256 {card.file.sha256[:12]}…; {again}")


def checks(name: str = "") -> Iterator[Check]:
    """Check a file, a hub's tree, the local splits of a name (NAME or NAME@VERSION), trained weights, a folder, or
    everything that is here.

    Raises HubError where nothing has that name, and IntegrityError where what has it holds nothing to check.
    """
    if name and (Path(name) / "index.json").is_file():
        yield from check_tree(Path(name))
        return
    if name.endswith(".pt"):
        yield check_weights(Path(name))
        return
    if name.endswith(".mcap"):
        yield check_alone(Path(name))
        return
    if Path(name).is_file():
        with open(name, "rb") as file:
            if file.read(len(MAGIC)) != MAGIC:
                raise IntegrityError(f"{name}: expected a sequence file (.mcap) or weights (.pt): it is neither")
        yield check_alone(Path(name))
        return
    if Path(name).is_dir() and name and not (NAME.fullmatch(name) and (home() / "splits" / name).is_dir()):
        found = False
        for check in _check_folder(Path(name)):
            found = found or check.state != FOREIGN
            yield check
        if not found:
            raise IntegrityError(
                f"{name}: expected sequence files (.mcap), or a published tree (index.json), found neither in this "
                "folder; exports and images have no manifest to be checked against"
            )
        return
    split, _, version = name.partition("@")
    if name and not (NAME.fullmatch(split) and VERSION_NAME.fullmatch(version or "0")):
        raise HubError(f"{name}: expected a split, a sequence file or a folder, got none of them")
    folders = sorted((home() / "splits").glob(f"{split or '*'}/{version}-*" if version else f"{split or '*'}/*"))
    here = (check for folder in folders if folder.is_dir() for check in _check_folder(folder))
    own = sorted(models().glob(f"{split or '*'}.pt"))
    shipped = [] if own or not split else sorted(released_models().glob(f"{split}.pt"))
    weights = (check_weights(path) for path in (*own, *shipped))
    found = False
    for check in chain(here, weights):
        found = True
        yield check
    if name and not found:
        known = {*split_names(), *(path.stem for path in released_models().glob("*.pt"))}
        if split in known:
            raise HubError(f"{name}: no data of it is here; `oysterbench download {name}` downloads it")
        meant = did_you_mean(nearest(split, known))
        raise HubError(f"{name}: no such file, folder, split or weights; {meant}`oysterbench splits` lists the splits")


def check_tree(tree: Path) -> Iterator[Check]:
    """Check that a published tree's index is signed with all keys that it names, that every file has the hash that is
    its name, and that no listed file is absent.

    Whether these keys are the right ones is for those to judge who know them: clients.
    """
    path = tree / "index.json"
    document = decode(path.read_bytes(), SignedIndex, str(path))
    keys = ", ".join(f"{one.key[:16]}…" for one in document.signatures) or "no key"
    if document.signatures and not document.unsigned():
        yield Check(path, RIGHT, f"signed with {keys}")
    else:
        yield Check(path, DAMAGED, f"not signed with what it names ({keys}): put back the one that was published")
    index = decode(document.signed_bytes, IndexBody, str(path))
    named = set()
    for release in index.splits:
        path = tree / "manifests" / f"{release.manifest}.json"
        named |= {path, tree / "croissant" / f"{release.croissant}.json"}
        named |= {tree / "pictures" / f"{digest}.jpg" for digest in release.pictures}
        if path.is_file():
            with contextlib.suppress(IntegrityError):  # its hash is wrong then, as is said below
                manifest = read_manifest(path.read_bytes(), str(path))
                named |= {tree / "blobs" / entry.sha256 for entry in manifest.files}
    for model in index.models:
        path = tree / "models" / f"{model.card}.json"
        named |= {path, tree / "cards" / f"{model.page}.html"}
        if path.is_file():
            with contextlib.suppress(IntegrityError):
                named.add(tree / "blobs" / read_model(path.read_bytes(), str(path)).file.sha256)
    found = {path for folder in FOLDERS for path in (tree / folder).glob("*")}
    for path in sorted(named | found):
        if not path.is_file():
            yield Check(path, ABSENT, f"the index names it: {AGAIN}")
            continue
        with open(path, "rb") as file:
            right = hashlib.file_digest(file, "sha256").hexdigest() == path.stem
        yield Check(path, RIGHT) if right else Check(path, DAMAGED, f"delete it; {AGAIN}")


def _check_folder(folder: Path) -> Iterator[Check]:
    """Check the files in a split's folder, also those not in its manifest, and report those that are absent, or that a
    killed `download --verify` left aside."""
    asides = ASIDE.format("*.mcap")
    for path in sorted([*folder.glob(asides), *folder.glob(f"topics-*/{asides}")]):
        yield Check(path, DAMAGED, "set aside by a repair that was interrupted: delete it")
    manifest = kept_manifest(folder)
    if manifest is not None:
        yield from (_check_beside(folder / entry.name, entry, manifest) for entry in manifest.files)
        others = [path for path in folder.glob("*.mcap") if manifest.find(path.name) is None]
        yield from map(_check_found, sorted([*others, *folder.glob(SMALLER_FILES)]))
        return
    if (folder / MANIFEST).is_file():
        again = "downloading the split again writes it anew"
        yield Check(folder / MANIFEST, DAMAGED, f"not a manifest, or not the released one; {again}")
    yield from map(_check_found, sorted([*folder.glob("*.mcap"), *folder.glob(SMALLER_FILES)]))


def _check_found(path: Path) -> Check:
    return replace(check_alone(path), named=False)


def _check_beside(path: Path, entry: FileEntry, manifest: Manifest, smaller: bool = False) -> Check:
    """Check a file against its entry in the manifest next to it, and say so where no key vouches for that manifest.

    smaller: as of `check_file`
    """
    check = check_file(path, entry, smaller)
    if not check.good or is_trusted(manifest):
        return check
    by = "by the manifest beside it, which was not checked against a key"
    return replace(check, detail="; ".join(filter(None, (check.detail, by))))


def check_alone(path: Path) -> Check:
    """Check one file against the manifest next to it, for a smaller one also that of the folder around its own, or that
    of the release to which it says it belongs."""
    if not path.is_file():
        return Check(path, ABSENT)
    own, *others = path.absolute().parents
    for folder in (own, *(others[:1] if path.absolute().match(SMALLER_FILES) else ())):
        manifest = kept_manifest(folder)
        entry = manifest.find(path.name) if manifest else None
        if manifest is not None and entry is not None:
            return _check_beside(path, entry, manifest, smaller=folder != own)
    try:
        known = _metadata(path)
        if not known:
            return Check(path, FOREIGN, "an MCAP file of another program")
        named = known.get("split", ""), known.get("split_version", "")
        manifest = released_manifest(*named) or partial_manifest(*named)
        return check_released(path, manifest) if manifest else check_unknown(path)
    except SequenceError as error:
        if _is_foreign(path):
            return Check(path, FOREIGN, "an MCAP file of another program, without an index or damaged")
        return Check(path, DAMAGED, str(error))
