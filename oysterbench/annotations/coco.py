"""Data sets in COCO form: one JSON file with images, annotations and categories; polygons or run lengths."""

from __future__ import annotations

import json
from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from oysterbench.annotations.image import Entry, LabelledImage, LabelledSet, read_picture
from oysterbench.annotations.polygons import planes_of, rasterise
from oysterbench.core.errors import LabelError

CHARACTER_BITS, FIRST_CHARACTER = 5, 48
"""Of a compressed run length: what each character carries, and the one that stands for 0 (the COCO mask format)."""


def coco_set(path: Path) -> LabelledSet:
    """The images of a COCO file, found beside it, or in images/ beside it, by their file_name.

    Annotations of the category "oyster" are instances, those with iscrowd = 1 are ignored, and so are those of other
    categories: left alone. The keys clip and split of an image are taken where they are there; without, each image is a
    clip of its own. Raises LabelError naming the item that is wrong.
    """
    document = _load(path)
    oyster = _oyster_id(document, path)
    images: dict[Any, Mapping[str, Any]] = {}
    for k, image in enumerate(document["images"]):
        for key in ("id", "file_name", "width", "height"):
            if key not in image:
                raise LabelError(f"{path}: images[{k}]: key {key!r} is missing")
        if image["id"] in images:
            raise LabelError(f"{path}: images[{k}]: id {image['id']} is used a second time")
        images[image["id"]] = image
    known = {category["id"] for category in document["categories"]}
    found: dict[Any, list[Mapping[str, Any]]] = {key: [] for key in images}
    for k, annotation in enumerate(document["annotations"]):
        where = f"{path}: annotations[{k}]"
        if annotation.get("image_id") not in images:
            raise LabelError(f"{where}: image_id {annotation.get('image_id')!r} is of no image of the file")
        if annotation.get("category_id") not in known:
            raise LabelError(f"{where}: category_id {annotation.get('category_id')!r} is of no category of the file")
        if "segmentation" not in annotation:
            raise LabelError(f"{where}: key 'segmentation' is missing: a box alone is no mask")
        if annotation["category_id"] == oyster:
            found[annotation["image_id"]].append({"where": where, **annotation})
    entries = []
    for key, image in images.items():
        file = next(
            (f for f in (path.parent / image["file_name"], path.parent / "images" / image["file_name"]) if f.is_file()),
            None,
        )
        if file is None:
            raise LabelError(f"{path}: image {key}: no file {image['file_name']} beside it, nor in images/")
        name = str(Path(image["file_name"]).with_suffix(""))
        clip = str(image.get("clip", name))
        read = partial(_read, file, image, found[key], name, clip)
        entries.append(Entry(name, clip, read, (file, path), str(image.get("split", ""))))
    if not entries:
        raise LabelError(f"{path}: has no image")
    return LabelledSet(path.resolve().parent.name, entries)


def _load(path: Path) -> Mapping[str, Any]:
    try:
        document = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, json.JSONDecodeError) as error:
        raise LabelError(f"{path}: cannot be read as JSON: {error}") from None
    for key in ("images", "annotations", "categories"):
        if not isinstance(document, dict) or not isinstance(document.get(key), list):
            raise LabelError(f"{path}: expected a COCO file, an object with the list {key!r}")
    return document


def _oyster_id(document: Mapping[str, Any], path: Path) -> Any:
    names = {category.get("name"): category.get("id") for category in document["categories"]}
    if "oyster" not in names:
        raise LabelError(
            f"{path}: no category is named 'oyster'; its categories: {', '.join(map(str, names)) or 'none'}"
        )
    return names["oyster"]


def _read(
    file: Path, image: Mapping[str, Any], annotations: list[Mapping[str, Any]], name: str, clip: str
) -> LabelledImage:
    pixels = read_picture(file)
    height, width = pixels.shape[:2]
    if (image["width"], image["height"]) != (width, height):
        raise LabelError(
            f"{file}: expected {image['width']} x {image['height']} px, as the COCO file says, got {width} x {height}"
        )
    masks = []
    ignore = np.zeros((height, width), dtype=bool)
    for annotation in annotations:
        mask = segmentation_mask(annotation["segmentation"], height, width, annotation["where"])
        if annotation.get("iscrowd"):
            ignore |= mask
        else:
            masks.append(mask)
    classes, instances = planes_of(masks, height, width)
    return LabelledImage(name, clip, pixels, classes, instances, ignore & (instances == 0))


def segmentation_mask(segmentation: Any, height: int, width: int, where: str) -> NDArray[np.bool_]:
    """(H, W) of a list of polygons, of which it is the union, or of run lengths, compressed or not."""
    if isinstance(segmentation, list):
        mask = np.zeros((height, width), dtype=bool)
        for polygon in segmentation:
            if len(polygon) < 6 or len(polygon) % 2:
                raise LabelError(f"{where}: expected polygons of three corners x y or more, got {len(polygon)} numbers")
            mask |= rasterise(np.array(polygon, dtype=float).reshape(-1, 2), height, width)
        return mask
    if not isinstance(segmentation, dict) or list(segmentation.get("size", ())) != [height, width]:
        size = segmentation.get("size") if isinstance(segmentation, dict) else None
        raise LabelError(f"{where}: expected run lengths of the size [{height}, {width}], got {size}")
    counts = segmentation["counts"]
    runs = counts if isinstance(counts, list) else decode_runs(counts)
    if sum(runs) != height * width or min(runs, default=0) < 0:
        raise LabelError(f"{where}: expected run lengths that add up to {height * width} pixels, got {sum(runs)}")
    values = np.repeat(np.arange(len(runs)) % 2, runs)  # column by column, 0 first
    return values.reshape(width, height).T.astype(bool)


def decode_runs(text: str | bytes) -> list[int]:
    """Run lengths from their compressed form: numbers in groups of 5 bits, low ones first, a sixth bit where more
    follow; from the third number on, differences to the one two before."""
    data = text.encode() if isinstance(text, str) else text
    runs: list[int] = []
    at = 0
    while at < len(data):
        value, shift, more = 0, 0, True
        while more and at < len(data):
            group = data[at] - FIRST_CHARACTER
            value |= (group & 0x1F) << shift
            more = bool(group & 0x20)
            at += 1
            shift += CHARACTER_BITS
            if not more and group & 0x10:
                value -= 1 << shift
        runs.append(value + (runs[-2] if len(runs) > 2 else 0))
    return runs
