"""What lies at the paths that somebody gives: pictures, videos, and what is neither."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from oysterbench.core.errors import LabelError

PICTURES = (".jpg", ".jpeg", ".jpe", ".png", ".tif", ".tiff", ".bmp", ".webp", ".jp2", ".ppm", ".pgm")
VIDEOS = (
    ".mp4",
    ".m4v",
    ".mov",
    ".avi",
    ".mkv",
    ".webm",
    ".mts",
    ".m2ts",
    ".ts",
    ".3gp",
    ".mpg",
    ".mpeg",
    ".wmv",
    ".gif",
)
CONVERT = (".heic", ".heif", ".avif", ".dng", ".gpr", ".raw", ".cr2", ".cr3", ".nef", ".arw", ".orf", ".rw2")
"""Pictures that OpenCV cannot decode: said apart from what is no picture, so that nobody misses them."""

RESULTS = ("finished", "overlays")
"""Folders in that of results (`store.Store`)."""
LABELS = ("masks", "instances", "ignore")
"""Folders beside images/ whose pictures are labels (`annotations.folders`)."""

LONGEST_NAME = 220
"""Bytes of a file's name: results have names a little longer, and file systems allow 255."""


@dataclass(frozen=True)
class Source:
    """A file of a picture or a video.

    name: unlike that of any other: its path below the folder that all have in common. Pictures go without their
    suffix, where that leaves them apart; a video keeps it, since its frames are named VIDEO/NUMBER.
    """

    name: str
    path: Path
    video: bool


@dataclass(frozen=True)
class Found:
    """What lies at some paths.

    root:       the folder that all have in common
    sources:    in the order of their names
    others:     files that are neither picture nor video
    to_convert: pictures in formats that cannot be read
    skipped:    folders of labels, or of results of another count
    copies:     such pictures beside a readable one of their name, as cameras keep raw ones
    misnamed:   pictures and videos whose names cannot be those of results
    closed:     folders that may not be looked into
    repeated:   other paths, and links, of files that are among the sources
    """

    root: Path
    sources: tuple[Source, ...]
    others: tuple[Path, ...] = ()
    to_convert: tuple[Path, ...] = ()
    skipped: tuple[Path, ...] = ()
    copies: tuple[Path, ...] = ()
    misnamed: tuple[Path, ...] = ()
    closed: tuple[Path, ...] = ()
    repeated: tuple[Path, ...] = ()

    def unreadable(self) -> dict[str, str]:
        """Name of what is to be converted, renamed or opened -> why it cannot be counted."""
        convert = "a format that cannot be read: save it as JPEG, PNG or TIFF"
        rename = f"expected a name in UTF-8 of at most {LONGEST_NAME} bytes: rename it"
        found = [(path, convert) for path in self.to_convert] + [(path, rename) for path in self.misnamed]
        found += [(path, "a folder that you may not look into: change its permissions") for path in self.closed]
        return {_shown(_name(path, self.root)): f"{_shown(str(path))}: {why}" for path, why in found}


def find_sources(paths: Sequence[Path], leave_out: Path | None = None) -> Found:
    """All pictures and videos at the paths: files, and folders with all that lies below them, by their suffix.

    leave_out: a folder that is not looked into, as that of the results; nor are links to folders, folders of labels
    beside images/, and of results of other counts, whose pictures would be counted as further ones. Raises LabelError
    where a path is not there or one of results, and where nothing is a picture or a video.
    """
    files: dict[Path, None] = {}  # in order, each once
    skipped: list[Path] = []
    closed: list[Path] = []
    roots = []
    for path in paths:
        if not path.exists():
            raise LabelError(f"{path}: no such file or folder; expected images, a folder of them, or a video")
        path = path.absolute()
        if leave_out is not None and path == leave_out.absolute():
            raise LabelError(f"{path}: expected another folder for the results than that of the images: give --out")
        if _holds_results(path):
            raise LabelError(f"{path}: expected images, got the results of a count: give the folder that was counted")
        roots.append(path if path.is_dir() else path.parent)
        files.update(dict.fromkeys(_below(path, leave_out, skipped, closed) if path.is_dir() else [path]))
    kinds: dict[str, list[Path]] = {"pictures": [], "videos": [], "convert": [], "others": [], "misnamed": []}
    first: dict[str, Path] = {}
    for file in files:
        first.setdefault(os.path.realpath(file), file)
    for file in first.values():
        kind = _kind(file)
        kinds["misnamed" if kind != "others" and _misnamed(file) else kind].append(file)
    if not kinds["pictures"] and not kinds["videos"]:
        raise LabelError(_nothing(paths, kinds["convert"], kinds["others"] + kinds["misnamed"]))
    root = Path(os.path.commonpath(roots))
    readable = {path.with_suffix("") for path in kinds["pictures"]}
    copies = tuple(path for path in kinds["convert"] if path.with_suffix("") in readable)
    to_convert = tuple(path for path in kinds["convert"] if path not in copies)
    sources = [*_pictures(kinds["pictures"], root), *(Source(_name(p, root), p, True) for p in kinds["videos"])]
    sources.sort(key=lambda source: source.name)
    return Found(
        root,
        tuple(sources),
        tuple(kinds["others"]),
        to_convert,
        tuple(skipped),
        copies,
        tuple(kinds["misnamed"]),
        tuple(closed),
        tuple(file for file in files if first[os.path.realpath(file)] is not file),
    )


def _below(folder: Path, leave_out: Path | None, skipped: list[Path], closed: list[Path]) -> list[Path]:
    found: list[Path] = []

    def stay_out(error: OSError) -> None:
        closed.append(Path(error.filename))

    results = None if leave_out is None else leave_out.absolute()
    for at, folders, names in os.walk(folder, onerror=stay_out):
        labels = LABELS if "images" in folders else ()
        own = [Path(at, name) for name in sorted(folders) if Path(at, name) != results]
        aside = [path for path in own if path.name in labels or _holds_results(path)]
        skipped += aside
        folders[:] = [path.name for path in own if path not in aside]
        found += [Path(at, name) for name in sorted(names)]
    return found


def _misnamed(path: Path) -> bool:
    """Whether results cannot be called so: its name or a folder's is too long, or no text, as from an old archive."""
    try:
        str(path).encode()
    except UnicodeEncodeError:
        return True
    return any(len(part.encode()) > LONGEST_NAME for part in path.parts)


def _shown(text: str) -> str:
    return os.fsencode(text).decode(errors="replace")


def _holds_results(path: Path) -> bool:
    return all(os.path.isdir(path / name) for name in RESULTS)


def _kind(path: Path) -> str:
    suffix = path.suffix.lower()
    if path.name.startswith("."):  # such as ._IMG.JPG, by which macOS keeps what other disks cannot
        return "others"
    if path.exists() and not path.is_file():  # a pipe, whose end never comes
        return "others"
    kinds = {"pictures": PICTURES, "videos": VIDEOS, "convert": CONVERT}
    return next((kind for kind, suffixes in kinds.items() if suffix in suffixes), "others")


def _name(path: Path, root: Path) -> str:
    return path.relative_to(root).as_posix()


def _pictures(files: Sequence[Path], root: Path) -> list[Source]:
    whole = {path: _name(path, root) for path in files}
    bare = {path: _name(path.with_suffix(""), root) for path in files}
    apart = Counter(bare.values())
    # A name without its suffix may also be that of another file with it: a.jpg.tif beside a.jpg and a.png.
    kept = {whole[path] for path in files if apart[bare[path]] > 1}
    named = ((path, whole[path] if apart[bare[path]] > 1 or bare[path] in kept else bare[path]) for path in files)
    return [Source(name, path, False) for path, name in named]


def _nothing(paths: Sequence[Path], to_convert: Sequence[Path], others: Sequence[Path]) -> str:
    where = ", ".join(map(str, paths))
    if to_convert:
        return (
            f"{where}: expected images or videos, got {listed(to_convert)}, of a format that cannot be read: save "
            "them as JPEG, PNG or TIFF first"
        )
    got = f"only {listed(others)}" if others else "an empty folder"
    return f"{where}: expected images ({' '.join(PICTURES[:6])} ...) or videos ({' '.join(VIDEOS[:5])} ...), got {got}"


def listed(paths: Sequence[Path], most: int = 3) -> str:
    """Names of some files, and how many more there are.

    >>> listed([Path("a.txt"), Path("b.txt")], most=1)
    'a.txt and 1 more'
    """
    names = ", ".join(_shown(path.name) for path in paths[:most])
    return names + (f" and {len(paths) - most} more" if len(paths) > most else "")
