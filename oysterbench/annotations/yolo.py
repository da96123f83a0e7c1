"""Data sets in YOLO format: images/ID.jpg, labels/ID.txt with one polygon per line."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from oysterbench.annotations.image import Entry, LabelledImage, LabelledSet, planes_of, read_picture
from oysterbench.annotations.manifest import images_with
from oysterbench.core.errors import LabelError
from oysterbench.core.polygons import rasterise
from oysterbench.evaluate.detection.instances import OUTSIDE


def yolo_set(folder: Path, classes: Mapping[int, str] | None = None) -> LabelledSet:
    """Open a folder with images/, labels/ and, if clips and splits are known, manifest.csv.

    A line of a label file is `CLASS x1 y1 x2 y2 ...` in fractions of width and height. classes: names of the numbers,
    {0: "oyster"} by default; an image without a label file, a number without a name or a class other than oyster is
    refused, by file and line. Polygons are clipped to the image.
    """
    names = dict(classes or {0: "oyster"})
    entries = []
    for name, row, image, label in images_with(folder, "labels", ".txt", "; one without oysters has an empty file"):
        read = partial(_read, image, label, names, name, row.clip)
        entries.append(Entry(name, row.clip, read, (image, label), row.split))
    return LabelledSet(folder.resolve().name, entries)


def _read(image: Path, label: Path, classes: Mapping[int, str], name: str, clip: str) -> LabelledImage:
    pixels = read_picture(image)
    height, width = pixels.shape[:2]
    masks = [rasterise(polygon * [width, height], height, width) for polygon in read_yolo(label, classes)]
    planes = planes_of(masks, height, width)
    return LabelledImage(name, clip, pixels, *planes, np.zeros((height, width), dtype=bool))


def read_yolo(path: Path, classes: Mapping[int, str]) -> list[NDArray[np.float64]]:
    """Read polygons (N, 2) in fractions of width and height. Raises LabelError naming file and line."""
    polygons = []
    try:
        lines = path.read_text(encoding="utf-8").splitlines()
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
        if classes.get(int(kind)) != "oyster" or kind != int(kind):
            known = ", ".join(f"{k} = {v}" for k, v in classes.items())
            raise LabelError(f"{where}: class {kind:g} is not an oyster; known classes: {known}")
        if len(values) < 6 or len(values) % 2:
            hint = ": a box, not a polygon" if len(values) == 4 else ""
            raise LabelError(f"{where}: expected at least three corners x y, got {len(values)} numbers{hint}")
        corners = np.array(values).reshape(-1, 2)
        if not np.isfinite(corners).all() or corners.min() < -OUTSIDE or corners.max() > 1 + OUTSIDE:
            raise LabelError(f"{where}: expected corners as fractions of width and height, got {line[:60]!r}")
        polygons.append(corners)
    return polygons
