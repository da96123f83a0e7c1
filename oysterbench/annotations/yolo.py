"""Data sets in YOLO format: images/ID.jpg, labels/ID.txt with one polygon per line."""

from __future__ import annotations

import re
from collections.abc import Mapping
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from oysterbench.annotations.image import Entry, LabelledImage, LabelledSet, planes_of, read_picture
from oysterbench.annotations.manifest import SIDES, images_with
from oysterbench.core.errors import LabelError
from oysterbench.core.polygons import rasterise
from oysterbench.evaluate.detection.instances import OUTSIDE

FILES = ("data.yaml", "data.yml", "classes.txt")
"""Files that may name the classes; the first that does is read. classes.txt has a name per line."""
NAMES = re.compile(rb"^[\"']?names[\"']?\s*:", re.MULTILINE)
"""What is in a YAML file that names classes."""
USUAL = {0: "oyster"}
"""Names of the classes where no file gives them."""
OYSTERS = ("oyster", "oysters")
"""Names of the class to be found, in any case."""


def yolo_set(folder: Path) -> LabelledSet:
    """Open a folder with images/, labels/ and, if clips and splits are known, manifest.csv.

    A line of a label file is `CLASS x1 y1 x2 y2 ...` in fractions of width and height. Classes have the names that
    data.yaml (or another of `FILES`) in the folder gives them, or in the one above, which train/, valid/ and test/
    (`SIDES`) share; without one, 0 is oyster. An image without a label file or a number without a name is refused, by
    file and line, and so is a YAML file of another name that names further classes; objects of other classes than
    oyster are skipped. Polygons are clipped to the image.
    """
    names, source = _classes(folder)
    entries = []
    for name, row, image, label in images_with(folder, "labels", ".txt", "; one without oysters has an empty file"):
        read = partial(_read, image, label, names, name, row.clip)
        entries.append(Entry(name, row.clip, read, (image, label, *source), row.split))
    return LabelledSet(folder.resolve().name, entries)


def _classes(folder: Path) -> tuple[dict[int, str], tuple[Path, ...]]:
    """Names of the classes by number, and the file that gives them, if they are others than without one. Raises
    LabelError where that is a YAML file of another name; above, only where it names oysters."""
    whole = folder.resolve()
    above = [whole.parent] if whole.name.casefold() in SIDES else []
    for path in (place / name for place in (folder, *above) for name in FILES):
        if path.is_file() and (names := read_classes(path)):
            return names, () if names == USUAL else (path,)
    for place in (folder, *above):
        for path in sorted(place.glob("*.y*ml")):
            if path.is_file() and _names_others(path, place in above):
                raise LabelError(f"{path}: expected the names of the classes in {FILES[0]}, got them here: rename it")
    return USUAL, ()


def _names_others(path: Path, shared: bool) -> bool:
    """Whether a YAML file names other classes than there are without one. shared: it may be of something else, such as
    another data set, and is where it names no oysters. Raises LabelError where a file that is not shared names none."""
    if not NAMES.search(path.read_bytes()):
        return False
    try:
        return read_classes(path) != USUAL
    except LabelError:
        if shared:
            return False
        raise


def _read(image: Path, label: Path, classes: Mapping[int, str], name: str, clip: str) -> LabelledImage:
    pixels = read_picture(image)
    height, width = pixels.shape[:2]
    masks = [rasterise(polygon * [width, height], height, width) for polygon in read_yolo(label, classes)]
    planes = planes_of(masks, height, width)
    return LabelledImage(name, clip, pixels, *planes, np.zeros((height, width), dtype=bool))


def read_classes(path: Path) -> dict[int, str]:
    """Read the names of the classes from a file of `FILES`, by number; empty if it names none. Raises LabelError if it
    cannot be read, or none of them is oyster."""
    names = _lines(path) if path.suffix == ".txt" else _names(path)
    if names is None:
        return {}
    found = {number: "oyster" if name.lower() in OYSTERS else name for number, name in names.items()}
    if "oyster" not in found.values():
        known = ", ".join(f"{number} = {name}" for number, name in found.items())
        raise LabelError(f"{path}: no class is named 'oyster'; its classes: {known or 'none'}: rename the one meant")
    return found


def _lines(path: Path) -> dict[int, str] | None:
    try:
        lines = path.read_text(encoding="utf-8-sig").rstrip().splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise LabelError(f"{path}: cannot be read as text: {error}") from None
    return dict(enumerate(line.strip() for line in lines)) or None


def _names(path: Path) -> dict[int, str] | None:
    from ruamel.yaml import YAML
    from ruamel.yaml.error import YAMLError

    try:
        content = YAML(typ="safe", pure=True).load(path.read_text(encoding="utf-8-sig"))
    except (OSError, UnicodeDecodeError, YAMLError, ValueError) as error:
        why = error.strerror if isinstance(error, OSError) else "not YAML"
        raise LabelError(f"{path}: {why}; expected the names of the classes under 'names'") from None
    names = content.get("names") if isinstance(content, Mapping) else None
    if names is None:
        return None
    found = dict(enumerate(names)) if isinstance(names, list) else names
    if not isinstance(found, Mapping) or not all(type(number) is int for number in found):
        raise LabelError(f"{path}: names: expected a list, or number: name, got {str(names)[:60]!r}")
    return {number: str(name) for number, name in found.items()}


def read_yolo(path: Path, classes: Mapping[int, str]) -> list[NDArray[np.float64]]:
    """Read the oysters' polygons (N, 2), in fractions of width and height; other classes with a name are skipped, as in
    COCO files. Raises LabelError naming file and line."""
    polygons = []
    try:
        lines = path.read_text(encoding="utf-8-sig").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise LabelError(f"{path}: cannot be read as text: {error}") from None
    for number, line in enumerate(lines, start=1):
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
        if classes[int(kind)] != "oyster":
            continue
        if len(values) < 6 or len(values) % 2:
            hint = ": a box, not a polygon" if len(values) == 4 else ""
            raise LabelError(f"{where}: expected at least three corners x y, got {len(values)} numbers{hint}")
        corners = np.array(values).reshape(-1, 2)
        if not np.isfinite(corners).all() or corners.min() < -OUTSIDE or corners.max() > 1 + OUTSIDE:
            raise LabelError(f"{where}: expected corners as fractions of width and height, got {line[:60]!r}")
        polygons.append(corners)
    return polygons
