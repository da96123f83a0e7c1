"""State of the files of a sequence of the user's own: whether they are still those that an earlier run was given."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Iterator
from pathlib import Path

TEXTS = (".csv", ".yaml", ".yml", ".txt")
"""Endings of the small files, which are read whole. Of images, of which there may be 100 000, nothing is read."""


def sensor_folders(folder: Path) -> list[Path]:
    """Folders with the measurements in a folder in EuRoC layout: mav0/imu0, then cam0, cam1, ... by their numbers."""
    root = folder / "mav0"
    cameras = [path for path in root.glob("cam[0-9]*") if path.name[3:].isdigit()]
    return [root / "imu0", *sorted(cameras, key=lambda path: int(path.name[3:]))]


def file_digests(path: Path) -> dict[str, str]:
    """Digest of each file with measurements or calibrations, by its name; all images in a folder have one together.

    Tables and calibrations go by their contents, images and sequence files by their names, sizes and modification
    times. The ground truth is left out: a run does not depend on it.
    """
    if path.is_file():
        state = path.stat()
        return {path.name: _digest(f"{state.st_size} {state.st_mtime_ns}".encode())}
    found: dict[str, str] = {}
    for sensor in sensor_folders(path):
        for folder, entries in _folders(sensor):
            name = folder.relative_to(path / "mav0").as_posix()
            texts = [entry for entry in entries if entry.name.endswith(TEXTS) and entry.is_file()]
            found |= {f"{name}/{entry.name}": _digest(Path(entry.path).read_bytes()) for entry in texts}
            if states := [_state(entry) for entry in entries if entry not in texts]:
                found[f"{name}/"] = _digest("\n".join(states).encode())
    return found


def _folders(folder: Path) -> Iterator[tuple[Path, list[os.DirEntry[str]]]]:
    """Yield a folder and those within it, links followed, each with its files by name."""
    with os.scandir(folder) as listing:
        entries = sorted(listing, key=lambda entry: entry.name)
    yield folder, [entry for entry in entries if not entry.is_dir()]
    for entry in entries:
        if entry.is_dir():
            yield from _folders(folder / entry.name)


def _state(entry: os.DirEntry[str]) -> str:
    try:
        state = entry.stat()
    except FileNotFoundError:  # a link that leads nowhere
        state = entry.stat(follow_symlinks=False)
    return f"{entry.name} {state.st_size} {state.st_mtime_ns}"


def _digest(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()[:16]
