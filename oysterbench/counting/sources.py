"""Files at the paths that a user gives: images, videos, and others."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from oysterbench.core.errors import LabelError
from oysterbench.core.names import natural_key
from oysterbench.core.places import is_hidden
from oysterbench.counting.labels import folders_of_labels, masks_beside

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
"""Suffixes of images that OpenCV cannot decode: reported separately from other files, so that nobody misses them."""

RESULTS = ("finished", "overlays")
"""Folders that mark a folder of results (`store.Store`)."""

LONGEST_NAME = 220
"""Maximum length of a file name in bytes: results have slightly longer names, and file systems allow 255."""


@dataclass(frozen=True)
class Source:
    """An image or video file.

    name: unique: its path relative to the folder that all have in common. Images lose their suffix if they remain
    unique; a video keeps it, since its frames are named VIDEO/NUMBER.
    """

    name: str
    path: Path
    video: bool


@dataclass(frozen=True)
class Found:
    """Files found at some paths.

    root:       the folder that all have in common
    sources:    in the order of their names
    others:     files that are neither image nor video
    to_convert: images in formats that cannot be read
    skipped:    folders of labels, masks beside their images, folders of results of another count, and hidden ones
    copies:     images in such formats beside a readable one of the same name, as cameras store raw images
    misnamed:   images and videos whose names cannot be used for results
    closed:     folders that may not be read
    repeated:   other paths and links to files that are among the sources
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
        """Name of each file or folder that must be converted, renamed or opened -> why it cannot be counted."""
        convert = "a format that cannot be read: save it as JPEG, PNG or TIFF"
        rename = f"expected a name in UTF-8 of at most {LONGEST_NAME} bytes: rename it"
        found = [(path, convert) for path in self.to_convert] + [(path, rename) for path in self.misnamed]
        found += [(path, "a folder that you may not look into: change its permissions") for path in self.closed]
        return {_shown(_name(path, self.root)): f"{_shown(str(path))}: {why}" for path, why in found}


def find_sources(paths: Sequence[Path], leave_out: Path | None = None) -> Found:
    """Find all images and videos at the paths, by their suffix: files, and folders with everything below them.

    leave_out: a folder that is not searched, such as that of the results; nor are links to folders, folders of labels
    beside images/, results of other counts, and hidden folders, whose images would be counted as well, as would masks
    beside their images. Raises LabelError if a path does not exist or is one of results, and if there is neither an
    image nor a video.
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
    first: dict[Any, Path] = {}
    for file in files:
        first.setdefault(_identity(file), file)
    for file in first.values():
        kind = _kind(file)
        kinds["misnamed" if kind != "others" and _misnamed(file) else kind].append(file)
    masks = set(masks_beside(kinds["pictures"]))
    kinds["pictures"] = [path for path in kinds["pictures"] if path not in masks]
    skipped += sorted(masks)
    if not kinds["pictures"] and not kinds["videos"]:
        raise LabelError(_nothing(paths, kinds["convert"], kinds["others"] + kinds["misnamed"], skipped))
    root = Path(os.path.commonpath(roots))
    readable = {path.with_suffix("") for path in kinds["pictures"]}
    copies = tuple(path for path in kinds["convert"] if path.with_suffix("") in readable)
    to_convert = tuple(path for path in kinds["convert"] if path not in copies)
    videos = [Source(_name(path, root), path, True) for path in kinds["videos"]]
    sources = [*_pictures(kinds["pictures"], root, [video.name for video in videos]), *videos]
    sources.sort(key=lambda source: (natural_key(source.name), source.name))
    return Found(
        root,
        tuple(sources),
        tuple(kinds["others"]),
        to_convert,
        tuple(skipped),
        copies,
        tuple(kinds["misnamed"]),
        tuple(closed),
        tuple(file for file in files if first[_identity(file)] is not file),
    )


def _below(folder: Path, leave_out: Path | None, skipped: list[Path], closed: list[Path]) -> list[Path]:
    found: list[Path] = []

    def stay_out(error: OSError) -> None:
        closed.append(Path(error.filename))

    results = None if leave_out is None else leave_out.absolute()
    for at, folders, names in os.walk(folder, onerror=stay_out):
        labels = folders_of_labels(folders)
        own = [Path(at, name) for name in sorted(folders) if Path(at, name) != results]
        aside = [path for path in own if path.name in labels or is_hidden(path, folder) or _holds_results(path)]
        skipped += aside
        folders[:] = [path.name for path in own if path not in aside]
        found += [Path(at, name) for name in sorted(names)]
    return found


def _identity(file: Path) -> Any:
    """What paths to the same file have in common, be they links, or one file under two names, as in a YOLO export."""
    try:
        found = file.stat()
    except OSError:
        return os.path.realpath(file)
    return (found.st_dev, found.st_ino) if found.st_nlink > 1 else os.path.realpath(file)


def _misnamed(path: Path) -> bool:
    """Whether results cannot have this name: a part of the path is too long, or no text, as from an old archive."""
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
    if path.name.startswith("."):  # such as ._IMG.JPG, in which macOS stores metadata on other file systems
        return "others"
    if path.exists() and not path.is_file():  # such as a pipe, which may never end
        return "others"
    kinds = {"pictures": PICTURES, "videos": VIDEOS, "convert": CONVERT}
    return next((kind for kind, suffixes in kinds.items() if suffix in suffixes), "others")


def _name(path: Path, root: Path) -> str:
    return path.relative_to(root).as_posix()


def _pictures(files: Sequence[Path], root: Path, videos: Iterable[str]) -> list[Source]:
    whole = {path: _name(path, root) for path in files}
    bare = {path: _name(path.with_suffix(""), root) for path in files}
    apart = Counter(bare.values())
    # A name without suffix may equal another file's name with suffix: a.jpg.tif beside a.jpg and a.png, a.mp4.jpg.
    kept = {whole[path] for path in files if apart[bare[path]] > 1} | {*videos}
    named = ((path, whole[path] if apart[bare[path]] > 1 or bare[path] in kept else bare[path]) for path in files)
    return [Source(name, path, False) for path, name in named]


def _nothing(paths: Sequence[Path], to_convert: Sequence[Path], others: Sequence[Path], skipped: Sequence[Path]) -> str:
    where = ", ".join(map(str, paths))
    if to_convert:
        return (
            f"{where}: expected images or videos, got {listed(to_convert)}, of a format that cannot be read: save "
            "them as JPEG, PNG or TIFF first"
        )
    got = f"only {listed(others)}" if others else "" if skipped else "an empty folder"
    if skipped:
        aside = f"{listed(skipped)}, left out as labels, as results of another count, or as hidden"
        got = f"{got}, and {aside}" if got else f"only {aside}"
    return f"{where}: expected images ({' '.join(PICTURES[:6])} ...) or videos ({' '.join(VIDEOS[:5])} ...), got {got}"


def listed(paths: Sequence[Path], most: int = 3) -> str:
    """List the names of some files, and how many more there are.

    >>> listed([Path("a.txt"), Path("b.txt")], most=1)
    'a.txt and 1 more'
    """
    names = ", ".join(_shown(path.name) for path in paths[:most])
    return names + (f" and {len(paths) - most} more" if len(paths) > most else "")
