"""Folders of labelled images: images/, a label file for each image, and manifest.csv, which assigns each to a clip and
a split."""

from __future__ import annotations

import csv
import io
import re
from collections import Counter
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

from oysterbench.core.errors import LabelError
from oysterbench.core.places import is_hidden, shown
from oysterbench.core.text import separator

FILE = "manifest.csv"
TRAIN, VAL, TEST = "train", "val", "test"
"""Sides on which images are put; where there is a test side, it alone is scored."""
SIDES = {TRAIN: TRAIN, VAL: VAL, "valid": VAL, "validation": VAL, TEST: TEST}
"""Side by what programs call it."""
SIDE_LAST = re.compile(rf"(?<![^\W_])({'|'.join(SIDES)})\d*$", re.IGNORECASE)
"""A side as the last word of a name, with or without a number."""
PICTURES = (".jpg", ".jpeg", ".png")


def side_in(name: str) -> str:
    """Side that the name of a set ends in, as a word of its own, in either case and with or without a number; empty if
    it ends in none.

    >>> side_in("reef-valid"), side_in("test2017"), side_in("contest")
    ('val', 'test', '')
    """
    found = SIDE_LAST.search(name)
    return SIDES[found[1].casefold()] if found else ""


@dataclass(frozen=True)
class ManifestRow:
    """Entry of an image; split: its side, in lower case; empty if none is given."""

    clip: str
    split: str


def read_manifest(folder: Path) -> dict[str, ManifestRow]:
    """Read the manifest of a folder, by id of an image, in the order of the file; empty if there is no manifest. The
    columns id and clip are required, split is optional, each in either case; others are ignored, and so are blanks
    around values. Separators are commas, semicolons or tabs, as spreadsheets write them. Raises LabelError naming the
    line."""
    path = folder / FILE
    if not path.is_file():
        return {}
    rows: dict[str, ManifestRow] = {}
    try:
        text = path.read_bytes().decode("utf-8-sig")
        lines = io.StringIO(text, newline="")
        reader = csv.DictReader(lines, delimiter=separator(text), skipinitialspace=True)
        columns = reader.fieldnames = [name.strip().casefold() for name in reader.fieldnames or ()]
        missing = {"id", "clip"} - set(columns)
        if missing:
            raise LabelError(f"{path}:1: expected the columns id, clip and split, missing: {', '.join(missing)}")
        for name in ("id", "clip", "split"):
            if columns.count(name) > 1:
                raise LabelError(f"{path}:1: expected one column {name}, got {columns.count(name)}: delete all but one")
        for values in reader:
            name, clip, split = ((values.get(key) or "").strip() for key in ("id", "clip", "split"))
            if not any(values.values()):  # what is left of a row that was cleared in a spreadsheet
                continue
            if not name or not clip:
                raise LabelError(f"{path}:{reader.line_num}: expected an id and a clip, got {name!r} and {clip!r}")
            if name in rows:
                raise LabelError(f"{path}:{reader.line_num}: {name!r} is listed twice")
            rows[name] = ManifestRow(clip, split.casefold())
    except UnicodeDecodeError:
        raise LabelError(f"{path}: expected a CSV table in UTF-8: in a spreadsheet, save it as 'CSV UTF-8'") from None
    except (OSError, csv.Error) as error:
        raise LabelError(f"{path}: cannot be read as CSV: {error}") from None
    _check_sides(path, rows)
    return rows


def _check_sides(path: Path, rows: Mapping[str, ManifestRow]) -> None:
    if not rows:
        raise LabelError(
            f"{path}: lists no image: expected one in each row; where writing the folder was interrupted, as of "
            "`oysterbench translate`, run that again"
        )
    if any(row.split for row in rows.values()) and not all(row.split for row in rows.values()):
        name = next(name for name, row in rows.items() if not row.split)
        raise LabelError(f"{path}: {name!r} has no split, but others do; expected one for every image or for none")


def scored_sides(side_of: Mapping[str, str]) -> tuple[frozenset[str], str]:
    """Names of the images that are not scored, as they are not on the side test where there is one, and a note on the
    sides. side_of: side of each image, by its name; empty where it has none."""
    counts = Counter(side or "no side" for side in side_of.values())
    if not counts or set(counts) in ({"no side"}, {TEST}):
        return frozenset(), ""
    if TEST not in counts:
        found = ", ".join(f"{count} of {side}" for side, count in counts.items())
        return (
            frozenset(),
            f"no image is on a side {TEST}, so all are scored, {found}: a method may have learnt from them",
        )
    others = ", ".join(f"{count} of {side}" for side, count in counts.items() if side != TEST)
    note = f"only images of the side {TEST} are scored, {counts[TEST]} in all, and not {others}"
    return frozenset(name for name, side in side_of.items() if side != TEST), note


def images_with(
    folder: Path,
    labels: str,
    suffix: str,
    hint: str = "",
    sides: Mapping[str, str] | None = None,
    imageless: str = "",
) -> Iterator[tuple[str, ManifestRow, Path, Path]]:
    """Yield name, manifest row, image file and label file (LABELS/NAME.suffix) of each image of a folder, in the order
    of the manifest if there is one; without it, each image is a clip of its own.

    Raises LabelError if the names of images, label files and manifest do not match. hint: added where a label file is
    missing. sides: where images lie in folders below images/, the side of each such folder, which only the manifest
    overrules; names are then FOLDER/NAME. imageless: stem of a file among the labels that is of no image.
    """
    listed = read_manifest(folder)
    images: dict[str, Path] = {}
    beside: dict[str, Path] = {}
    for part in sides or ("",):
        own = files_of(folder / "images" / part, *PICTURES)
        label_files = files_of(folder / labels / part, suffix, of=None if suffix in PICTURES else own)
        for found, files in ((images, own), (beside, label_files)):
            found |= {f"{part}/{name}" if part else name: path for name, path in files.items()}
    if not images:
        raise LabelError(f"{folder / 'images'}: no image (.jpg, .jpeg or .png)")
    for name in listed:
        if name not in images:
            raise LabelError(f"{folder / FILE}: lists {name!r}, but images/ has no such image")
    for name in images:
        if listed and name not in listed:
            raise LabelError(f"{folder / FILE}: does not list images/{name}; every image needs its clip")
        if name not in beside:
            raise LabelError(f"{folder}: image {name} has no {labels}/{name}{suffix}{hint}")
    for name in beside:
        if name not in images and name.rpartition("/")[2] != imageless:
            raise LabelError(f"{folder}: {labels}/{name}{suffix} has no image of that name in images/")
    for name in listed or images:
        row = listed.get(name) or ManifestRow(name, "")
        side = row.split or (sides or {}).get(name.partition("/")[0], "")
        yield name, ManifestRow(row.clip, side), images[name], beside[name]


def parts_of(folder: Path) -> list[str]:
    """Names of the folders with image files in a folder that has none itself."""

    def has_some(place: Path) -> bool:
        return any(path.suffix.lower() in PICTURES and path.is_file() for path in shown(place, "*"))

    return [] if has_some(folder) else [path.name for path in shown(folder, "*") if path.is_dir() and has_some(path)]


def files_of(folder: Path, *suffixes: str, of: Collection[str] | None = None) -> dict[str, Path]:
    """Files with one of the suffixes by their names without it, in order; empty if there is no folder. Hidden files are
    left out, such as the ._NAME.png that macOS writes beside each file on other file systems. Raises LabelError where
    two differ by their suffix alone, or some are in folders below; of: where given, only those named as these images
    are refused there, as others may be of anything."""
    found: dict[str, Path] = {}
    for path in shown(folder, "*"):
        if path.is_dir():
            below = (one for one in sorted(path.rglob("*")) if one.suffix.lower() in suffixes and one.is_file())
            ours = (one for one in below if not is_hidden(one, path) and (of is None or one.stem in of))
            if (one := next(ours, None)) is not None:
                raise LabelError(
                    f"{one}: expected {', '.join(suffixes)} files in {folder.name}/ itself, and none in folders below: "
                    "move them there, or to a data set of their own"
                )
        elif path.suffix.lower() in suffixes and found.setdefault(path.stem, path) != path:
            raise LabelError(
                f"{path}: expected one file named {path.stem} here, got {found[path.stem].name}, too: rename or delete "
                "one of them"
            )
    return found
