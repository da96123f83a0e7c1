"""Data sets in YOLO format: images/ID.jpg, labels/ID.txt with one polygon per line, or images/SIDE/ID.jpg and
labels/SIDE/ID.txt."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from oysterbench.annotations.categories import may_be_oysters
from oysterbench.annotations.image import Entry, LabelledImage, LabelledSet, planes_of, read_picture
from oysterbench.annotations.manifest import ManifestRow, images_with, parts_of
from oysterbench.annotations.yolo_classes import FILES, classes_of, listed_names, side_of, that_may_be_oysters
from oysterbench.core.errors import LabelError
from oysterbench.core.places import shown
from oysterbench.core.polygons import rasterise
from oysterbench.evaluate.detection.instances import OUTSIDE

LAYERS = ("images", "labels")
SEGMENT, DETECT = "segment", "detect"
"""Folders of our own export, of polygons and of boxes."""


class YoloImage(NamedTuple):
    """An image of a data set and its label file; row: its clip and side."""

    name: str
    row: ManifestRow
    image: Path
    label: Path


class Outline(NamedTuple):
    """An oyster of a label file, and where it is there. corners (N, 2): fractions of width and height, of a polygon or
    of a box."""

    where: str
    corners: NDArray[np.float64]
    box: bool


def yolo_root(folder: Path) -> Path | None:
    """Folder with images/ and labels/: this one or, of our own export of the same oysters as polygons and boxes, that
    of the polygons; None if it is neither."""
    if all((folder / name).is_dir() for name in LAYERS):
        return folder
    ours = all((folder / task / name).is_dir() for task in (SEGMENT, DETECT) for name in LAYERS)
    return folder / SEGMENT if ours else None


def yolo_set(folder: Path) -> LabelledSet:
    """Open a folder with images/, labels/ and, if clips and splits are known, manifest.csv.

    A line of a label file is `CLASS x1 y1 x2 y2 ...` in fractions of width and height. Classes have the names that
    data.yaml or a file like it gives them (`classes_of`); without one, 0 is oyster. An image without a label file or a
    number without a name, or of a class that may be of oysters or not, is refused, by file and line; objects of other
    classes are skipped. Polygons are
    clipped to the image. Where images/ and labels/ have folders alone, each is a side (`side_of`), and images are named
    FOLDER/NAME.
    """
    images, names, source = yolo_images(folder)
    entries = []
    for name, row, image, label in images:
        read = partial(_read, image, label, names, name, row.clip)
        entries.append(Entry(name, row.clip, read, (image, label, *source), row.split))
    return LabelledSet(folder.resolve().name, entries)


def yolo_images(folder: Path) -> tuple[list[YoloImage], dict[int, str], tuple[Path, ...]]:
    """Images of a data set, names of its classes by number, and the file that gives these, if it must be known."""
    root = yolo_root(folder) or folder
    names, source = classes_of(root)
    hint = "; one without oysters has an empty file"
    sides = {part: side_of(root, part) for part in parts_of(root / "images")}
    for listed in _lists(root, sides):
        if listed.is_file() and listed not in source:
            _check_list(listed, names, root)
    found = images_with(root, "labels", ".txt", hint, sides, Path(FILES[-1]).stem)
    return [YoloImage(*one) for one in found], names, source


def _lists(root: Path, sides: Iterable[str]) -> Iterator[Path]:
    """Where a list of names may be, as labelImg writes it, besides the file that gives them: beside images/ and
    labels/, among the images, and among the labels unless an image is called so."""
    yield root / FILES[-1]
    for part in ("", *sides):
        images = root / "images" / part
        yield images / FILES[-1]
        if all(path.suffix == ".txt" for path in shown(images, f"{Path(FILES[-1]).stem}.*")):
            yield root / "labels" / part / FILES[-1]


def _check_list(listed: Path, names: Mapping[int, str], root: Path) -> None:
    """Refuse a list of names by which oysters have other numbers than in the data set. Among the labels, it also has
    to name oysters, and no more classes than there are; elsewhere, what cannot be read or names none is of another use.
    """
    among = listed.is_relative_to(root / "labels")
    try:
        found = {number: name for number, name in listed_names(listed).items() if name}
    except LabelError:
        if among:
            raise
        return
    known, others = that_may_be_oysters(names), that_may_be_oysters(found)
    if not among:
        known, others = known & found.keys(), others & names.keys()
    named = among or any("oyster" in name.casefold() for name in found.values())
    if found and named and (known != others or (among and not found.keys() <= names.keys())):
        there = next((name for name in FILES if (root / name).is_file() and root / name != listed), "")
        so = (
            f"name the classes so in {there} beside images/ and labels/"
            if there
            else "move it beside images/ and labels/"
        )
        raise LabelError(
            f"{listed}: expected {_classes(names)}, as in the data set, got {_classes(found)}, as labelImg lists them: "
            f"if the labels are by this list, {so}; else delete it"
        )


def _classes(names: Mapping[int, str]) -> str:
    return f"{', '.join(f'{number} = {name}' for number, name in names.items()):.80}"


def _read(image: Path, label: Path, classes: Mapping[int, str], name: str, clip: str) -> LabelledImage:
    pixels = read_picture(image)
    height, width = pixels.shape[:2]
    masks = [rasterise(polygon * [width, height], height, width) for polygon in read_yolo(label, classes)]
    planes = planes_of(masks, height, width)
    return LabelledImage(name, clip, pixels, *planes, np.zeros((height, width), dtype=bool))


def read_yolo(path: Path, classes: Mapping[int, str]) -> list[NDArray[np.float64]]:
    """Read the oysters' polygons (N, 2), in fractions of width and height. Raises LabelError naming file and line, also
    of a box."""
    found = read_outlines(path, classes)
    for one in found:
        if one.box:
            raise LabelError(
                f"{one.where}: expected at least three corners x y, got 4 numbers: a box, not a polygon; boxes alone "
                "can be scored against, with `--track detection`, and not learnt from"
            )
    return [one.corners for one in found]


def label_lines(path: Path) -> list[str]:
    """Lines of a label file. Raises LabelError if it cannot be read as text."""
    try:
        return path.read_text(encoding="utf-8-sig").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise LabelError(f"{path}: cannot be read as text: {error}") from None


def read_outlines(path: Path, classes: Mapping[int, str]) -> list[Outline]:
    """Read the oysters of a label file, polygons and boxes (centre x y, width, height); other classes with a name are
    skipped, as in COCO files. Raises LabelError naming file and line."""
    found = []
    for number, line in enumerate(label_lines(path), start=1):
        if not line.strip():
            continue
        where = f"{path}:{number}"
        try:
            kind, *values = [float(word) for word in line.split()]
        except ValueError:
            raise LabelError(f"{where}: expected numbers, got {line[:60]!r}") from None
        if kind not in classes:
            known = ", ".join(f"{k} = {v}" for k, v in classes.items())
            raise LabelError(f"{where}: class {kind:g} is not an oyster; known classes: {known}")
        if (name := classes[int(kind)]) != "oyster":
            if may_be_oysters(name):
                raise LabelError(
                    f"{where}: class {kind:g} is called {name!r}, which could be of oysters or not: where the classes "
                    "are named, call it oyster, live oyster or dead oyster, or what else it is"
                )
            continue
        box = len(values) == 4
        if not box and (len(values) < 6 or len(values) % 2):
            raise LabelError(f"{where}: expected at least three corners x y, got {len(values)} numbers")
        corners = np.array(values).reshape(-1, 2)
        if box:
            corners = corners[0] + corners[1] / 2 * [[-1, -1], [1, -1], [1, 1], [-1, 1]]
        if not np.isfinite(corners).all() or corners.min() < -OUTSIDE or corners.max() > 1 + OUTSIDE:
            raise LabelError(f"{where}: expected corners as fractions of width and height, got {line[:60]!r}")
        if box and min(values[2:]) < 0:
            raise LabelError(f"{where}: expected a box of centre, width and height, got {line[:60]!r}")
        found.append(Outline(where, corners, box))
    return found
