"""manifest.csv of a folder of labelled images: which clip each is of, and on which side of the split."""

from __future__ import annotations

import csv
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from pathlib import Path

from oysterbench.core.errors import LabelError

FILE = "manifest.csv"


@dataclass(frozen=True)
class Row:
    """What is said of an image."""

    clip: str
    split: str


def read_manifest(folder: Path) -> dict[str, Row]:
    """By id of an image, in the order of the file; empty where there is none. The columns id and clip are needed, split
    where there is one; others are left alone. Raises LabelError naming the line."""
    path = folder / FILE
    if not path.is_file():
        return {}
    rows: dict[str, Row] = {}
    try:
        with open(path, newline="", encoding="utf-8") as file:
            reader = csv.DictReader(file)
            missing = {"id", "clip"} - set(reader.fieldnames or ())
            if missing:
                raise LabelError(f"{path}:1: expected the columns id, clip and split, missing: {', '.join(missing)}")
            for values in reader:
                name, clip = values["id"], values["clip"]
                if not name or not clip:
                    raise LabelError(f"{path}:{reader.line_num}: expected an id and a clip, got {name!r} and {clip!r}")
                if name in rows:
                    raise LabelError(f"{path}:{reader.line_num}: {name!r} is listed a second time")
                rows[name] = Row(clip, values.get("split") or "")
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise LabelError(f"{path}: cannot be read as CSV: {error}") from None
    _check_sides(path, rows)
    return rows


def _check_sides(path: Path, rows: Mapping[str, Row]) -> None:
    if not rows:
        raise LabelError(f"{path}: lists no image")
    if any(row.split for row in rows.values()) and not all(row.split for row in rows.values()):
        name = next(name for name, row in rows.items() if not row.split)
        raise LabelError(f"{path}: {name!r} has no split, but others have; expected one for each image or for none")


def unlisted(folder: Path, rows: Mapping[str, Row], images: Collection[str]) -> None:
    """Refuse a manifest that does not list just the images that are there."""
    if not images:
        raise LabelError(f"{folder / 'images'}: no image (.jpg, .jpeg or .png)")
    if rows:
        for name in rows:
            if name not in images:
                raise LabelError(f"{folder / FILE}: lists {name!r}, but images/ has no such image")
        for name in images:
            if name not in rows:
                raise LabelError(f"{folder / FILE}: does not list images/{name}; every image needs its clip")
