"""YOLO labels with boxes, as the ground truth that a COCO file with boxes is."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from oysterbench.annotations.categories import Categories
from oysterbench.annotations.coco import CocoFile, CocoImage
from oysterbench.annotations.coco_item import CocoItem
from oysterbench.annotations.image import read_picture
from oysterbench.annotations.manifest import scored_sides
from oysterbench.annotations.yolo import Outline, YoloImage, label_lines, read_outlines, yolo_images

CATEGORIES = Categories({0: "oyster"}, {0: "unknown"}, frozenset())


def boxes_at(folder: Path) -> tuple[CocoFile, dict[str, Path], list[Path]] | None:
    """Annotations, image files by the names of the images, and label files of a YOLO data set in which some oyster has
    a box alone; None if all have polygons. Only labels of images that are scored are read (`scored_sides`). Raises
    LabelError where one is wrong, naming file and line."""
    images, classes, source = yolo_images(folder)
    unscored, _ = scored_sides({one.name: one.row.split for one in images})
    scored = [one for one in images if one.name not in unscored]
    if not any(_may_have_box(one.label) for one in scored):
        return None
    found = {one.name: read_outlines(one.label, classes) for one in scored}
    if not any(outline.box for outlines in found.values() for outline in outlines):
        return None
    known = {one.name: _image(one) for one in images}
    items = {name: tuple(_item(one, known[name]) for one in outlines) for name, outlines in found.items()}
    file = CocoFile(folder, known, items, CATEGORIES)
    return file, {one.name: one.image for one in images}, [*(one.label for one in scored), *source]


def _may_have_box(label: Path) -> bool:
    """Whether some line has a class and four numbers: told at once, where polygons take long to read."""
    return any(len(line.split(maxsplit=5)) == 5 for line in label_lines(label))


def _image(one: YoloImage) -> CocoImage:
    height, width = read_picture(one.image).shape[:2]
    clip = "" if one.row.clip == one.name else one.row.clip  # without a manifest, each image is a clip of its own
    return CocoImage(one.name, height, width, one.image.name, clip, one.row.split)


def _item(outline: Outline, image: CocoImage) -> CocoItem:
    corners = outline.corners * [image.width, image.height]
    (left, top), (right, bottom) = np.min(corners, axis=0).tolist(), np.max(corners, axis=0).tolist()
    masks = {} if outline.box else {"segmentation": [corners.ravel().tolist()]}
    return CocoItem(outline.where, {"bbox": [left, top, right - left, bottom - top], **masks})
