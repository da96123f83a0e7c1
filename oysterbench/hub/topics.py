"""Downloading some topics of a split: only the pieces that hold them are fetched, and a smaller file is cut from them.

Small topics have their own chunks, so that the IMU data of a long sequence takes a few pieces. The smaller file is made
on this machine: it is a sequence file like any other, but no hub knows its hash.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from mcap.summary import Summary

from oysterbench.core.errors import HubError, IntegrityError, SequenceError
from oysterbench.core.locks import locked_if_possible, scratch
from oysterbench.core.mcap import FOOTER, MAGIC
from oysterbench.hub.download import Hub, Progress, check_space, part_path, topics_mark
from oysterbench.hub.draft import remove_drafts
from oysterbench.hub.manifest import FileEntry
from oysterbench.hub.part import Part
from oysterbench.hub.transfer import Transfer
from oysterbench.hub.trusted import was_filled_here
from oysterbench.hub.verify import check_file, kept_manifest
from oysterbench.sequence.cut import chunks_with, cut_to, match_topics, topics_folder
from oysterbench.sequence.file import Reading, damaged
from oysterbench.sequence.read import McapSequence

Count = Callable[[int], None]
Span = tuple[int, int]
"""Bytes [start, end) of a file."""

Fetch = Callable[[Iterable[Span]], None]


def fetch_topics(
    hub: Hub,
    entries: Sequence[FileEntry],
    folder: Path,
    wanted: Sequence[str],
    out: Path | None = None,
    progress: Progress = lambda done, total: None,
    verify: bool = False,
) -> dict[str, Path]:
    """Make smaller files with the topics that match patterns such as `/imu` or `/cam_front/*`: sequence -> path.

    They go to `out`, by default a subfolder of the split's. A file that is here completely is not fetched, and a
    smaller one that is here with the same topics is taken once its content has been checked. Raises SequenceError where
    a pattern matches no topic, and HubError where a file is in the way. verify: read complete files before they are
    taken, and read back what was written; raises IntegrityError where that fails.
    """
    out = out or topics_folder(folder, wanted)
    total = sum(entry.size for entry in entries)
    files, done = {}, 0
    for entry in entries:
        names = match_topics(entry.content, wanted, entry.name)
        target = out / entry.name
        if _is_cut(target, entry, names):
            pass
        elif target.exists() and out.resolve() == folder.resolve():
            raise HubError(
                f"{target}: expected none, or a sound one with the same {len(names)} of {len(entry.content)} topics, "
                "got another file; it was left unchanged: delete it or choose another folder with --out"
            )
        elif _is_here(folder, entry, verify):
            cut_to(target, folder / entry.name, names)
        else:
            _fetch_and_cut(hub, entry, folder, target, names, lambda n, done=done: progress(done + n, total))  # type: ignore[misc]
        if verify and not _is_cut(target, entry, names):
            raise IntegrityError(
                f"{target}: read back from the disk, it is not what was written: the disk may be failing; delete it "
                "and choose a folder on another disk with --out"
            )
        done += entry.size
        progress(done, total)
        files[entry.sequence] = target
    return files


def plan_topics(
    hub: Hub, entries: Sequence[FileEntry], folder: Path, wanted: Sequence[str], out: Path | None = None
) -> dict[str, int]:
    """Sequence -> bytes that `fetch_topics` would fetch of its file: whole pieces; 0 where the file is here, or its
    smaller one.

    This is known from the index at the end of each file, which is fetched for it, into a folder that is removed again.
    Raises SequenceError where a pattern matches no topic.
    """
    out = out or topics_folder(folder, wanted)
    sizes = {}
    for entry in entries:
        names = match_topics(entry.content, wanted, entry.name)
        if _is_cut(out / entry.name, entry, names) or _is_here(folder, entry):
            sizes[entry.sequence] = 0
            continue
        with scratch() as draft, _part_of(hub, entry, draft, lambda n: None) as (path, fetch):
            summary, ends = _index(path, entry, fetch)
            pieces = _pieces([*_spans(summary, names), *ends], entry)
            sizes[entry.sequence] = sum(entry.length(piece) for piece in pieces)
    return sizes


def _fetch_and_cut(hub: Hub, entry: FileEntry, folder: Path, target: Path, names: Sequence[str], tell: Count) -> None:
    """Fetch the parts that the index of the file lists for some topics, then cut the smaller file from them."""
    check_space(folder, entry.size)
    with _part_of(hub, entry, folder, tell) as (path, fetch):
        summary, _ = _index(path, entry, fetch)
        fetch(_spans(summary, names))
        cut_to(target, path, names)


@contextmanager
def _part_of(hub: Hub, entry: FileEntry, folder: Path, tell: Count) -> Iterator[tuple[Path, Fetch]]:
    """Yield the part of a file, and a function that fetches bytes into it. A part of `download` is kept, so that it can
    grow later; otherwise it is removed afterwards. Other processes wait where the disk has locks."""
    path = part_path(folder, entry)
    with locked_if_possible(path.with_suffix(".lock")):  # `download` of the whole file holds it, too
        own = topics_mark(path)
        if not path.is_file():
            folder.mkdir(parents=True, exist_ok=True)
            own.touch()
        part = Part(path, entry)
        there: set[int] = set()

        def fetch(spans: Iterable[Span]) -> None:
            pieces = _pieces(spans, entry)
            Transfer(part, hub.mirrors, hub.connections, hub.patience, lambda n: None).fetch(sorted(pieces - there))
            there.update(pieces)
            tell(sum(entry.length(piece) for piece in there))

        try:
            yield path, fetch
        finally:
            part.close()
        if own.is_file():
            path.unlink(missing_ok=True)
            remove_drafts(path)
            own.unlink()


def _pieces(spans: Iterable[Span], entry: FileEntry) -> set[int]:
    return {piece for start, end in spans for piece in range(start // entry.piece_size, -(-end // entry.piece_size))}


def _index(path: Path, entry: FileEntry, fetch: Fetch) -> tuple[Summary, list[Span]]:
    """Fetch the index of a file; return it, and the spans that were fetched for it."""
    ends = [(0, len(MAGIC)), (entry.size - FOOTER.size - len(MAGIC), entry.size)]
    fetch(ends)
    ends.append((_summary_start(path, entry.size), entry.size))
    fetch(ends[-1:])
    with Reading(path) as (_, summary):
        return summary, ends


def _is_here(folder: Path, entry: FileEntry, read: bool = False) -> bool:
    """Whether a folder has the whole file. It is read if that is asked for, or unless the folder was filled here by a
    manifest that names it, as in `download.plan`."""
    path = folder / entry.name
    if not path.is_file() or path.stat().st_size != entry.size:
        return False
    kept = kept_manifest(folder)
    filled = not read and kept is not None and kept.find(entry.name) == entry and was_filled_here(folder, kept)
    return filled or check_file(path, entry).good


def _is_cut(target: Path, entry: FileEntry, names: Sequence[str]) -> bool:
    """Whether a smaller file is here with just these topics, all of which are right."""
    try:
        same = target.is_file() and {*McapSequence(target).types} == {*names}
    except SequenceError:  # damaged
        return False
    return same and check_file(target, entry, smaller=True).good


def _summary_start(path: Path, size: int) -> int:
    """Offset of the index of an MCAP file, from its footer. Raises HubError where it is outside the file."""
    with open(path, "rb") as file:
        file.seek(size - FOOTER.size - len(MAGIC))
        start = int(FOOTER.unpack(file.read(FOOTER.size))[2])
    if not len(MAGIC) <= start < size:
        raise HubError(damaged(path, "its index is outside it"))
    return start


def _spans(summary: Summary, names: Sequence[str]) -> list[Span]:
    """Spans [start, end) of everything from which a smaller file is made."""
    found = [(index.offset, index.length) for index in summary.attachment_indexes]
    found += [(index.offset, index.length) for index in summary.metadata_indexes]
    found += [(chunk.chunk_start_offset, chunk.chunk_length) for chunk in chunks_with(summary, names)]
    return [(start, start + length) for start, length in found]
