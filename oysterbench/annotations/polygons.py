"""Polygons as masks; and data sets in YOLO form: images/ID.jpg, labels/ID.txt with a polygon a line."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from oysterbench.annotations.image import OYSTER, Entry, LabelledImage, LabelledSet, read_picture
from oysterbench.annotations.manifest import read_manifest, unlisted
from oysterbench.core.errors import LabelError

PICTURES = (".jpg", ".jpeg", ".png")
OUTSIDE = 1.0
"""Widths or heights by which a corner may lie outside, as after a crop; the mask ends where the image does."""


def rasterise(polygon: ArrayLike, height: int, width: int) -> NDArray[np.bool_]:
    """(H, W) mask of a polygon (N, 2), x and y in px, pixel (row, column) covering [column, column + 1) and so on.

    A pixel is inside where its centre is (even-odd rule), so that polygons along the borders of pixels, as
    `sequence.export.polygons` makes them, give back their mask, and polygons that touch share no pixel.
    """
    corners = np.asarray(polygon, dtype=float).reshape(-1, 2)
    mask = np.zeros((height, width), dtype=bool)
    # Only the box of the polygon is looked at: most are small.
    (left, top), (right, bottom) = np.floor(corners.min(axis=0)), np.ceil(corners.max(axis=0))
    left, top = int(np.clip(left, 0, width)), int(np.clip(top, 0, height))
    right, bottom = int(np.clip(right, 0, width)), int(np.clip(bottom, 0, height))
    if left >= right or top >= bottom:
        return mask
    flips = np.zeros((bottom - top, right - left + 1), dtype=np.uint8)
    for (x0, y0), (x1, y1) in zip(corners.tolist(), np.roll(corners, -1, axis=0).tolist(), strict=True):
        low, high = min(y0, y1), max(y0, y1)
        rows = np.arange(max(top, math.ceil(low - 0.5)), min(bottom, math.ceil(high - 0.5)))
        if len(rows):  # those whose centre line the edge crosses
            x = x0 + (rows + 0.5 - y0) * (x1 - x0) / (y1 - y0)
            flips[rows - top, np.clip(np.ceil(x - 0.5), left, right).astype(int) - left] ^= 1
    mask[top:bottom, left:right] = np.bitwise_xor.accumulate(flips[:, :-1], axis=1)
    return mask


def planes_of(
    masks: Sequence[NDArray[np.bool_]], height: int, width: int
) -> tuple[NDArray[np.uint8], NDArray[np.uint16]]:
    """Classes and instances (H, W) of masks of oysters, number k + 1 for masks[k]. Where several overlap, a pixel is of
    the smallest: what lies on top of another is usually seen whole and in front of it."""
    instances = np.zeros((height, width), dtype=np.uint16)
    for k in sorted(range(len(masks)), key=lambda k: -int(masks[k].sum())):
        instances[masks[k]] = k + 1
    return np.where(instances > 0, OYSTER, 0).astype(np.uint8), instances


def yolo_set(folder: Path, classes: Mapping[int, str] | None = None) -> LabelledSet:
    """A folder with images/, labels/ and, where clips and splits are known, manifest.csv.

    A line of a label file is `CLASS x1 y1 x2 y2 ...` in fractions of width and height. classes: names of the numbers,
    {0: "oyster"} by default; an image without a label file, a number without a name or a class that is no oyster is
    refused, by file and line.
    """
    names = dict(classes or {0: "oyster"})
    listed = read_manifest(folder)
    images = {path.stem: path for path in sorted((folder / "images").iterdir()) if path.suffix.lower() in PICTURES}
    labels = {path.stem: path for path in sorted((folder / "labels").glob("*.txt"))}
    unlisted(folder, listed, images)
    for stem in images:
        if stem not in labels:
            raise LabelError(f"{folder}: image {stem} has no labels/{stem}.txt; one without oysters has an empty file")
    for stem in labels:
        if stem not in images:
            raise LabelError(f"{folder}: labels/{stem}.txt has no image of that name in images/")
    entries = []
    for stem in listed or images:
        row = listed.get(stem)
        clip, split = (row.clip, row.split) if row else (stem, "")
        read = partial(_read, images[stem], labels[stem], names, stem, clip)
        entries.append(Entry(stem, clip, read, (images[stem], labels[stem]), split))
    return LabelledSet(folder.resolve().name, entries)


def _read(image: Path, label: Path, classes: Mapping[int, str], name: str, clip: str) -> LabelledImage:
    pixels = read_picture(image)
    height, width = pixels.shape[:2]
    masks = [rasterise(polygon * [width, height], height, width) for polygon in read_yolo(label, classes)]
    planes = planes_of(masks, height, width)
    return LabelledImage(name, clip, pixels, *planes, np.zeros((height, width), dtype=bool))


def read_yolo(path: Path, classes: Mapping[int, str]) -> list[NDArray[np.float64]]:
    """Polygons (N, 2) in fractions of width and height. Raises LabelError naming file and line."""
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
            raise LabelError(f"{where}: expected three corners x y or more, got {len(values)} numbers{hint}")
        corners = np.array(values).reshape(-1, 2)
        if not np.isfinite(corners).all() or corners.min() < -OUTSIDE or corners.max() > 1 + OUTSIDE:
            raise LabelError(f"{where}: expected corners in fractions of width and height, got {line[:60]!r}")
        polygons.append(corners)
    return polygons
