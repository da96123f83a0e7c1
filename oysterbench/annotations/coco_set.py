"""Data sets as COCO annotations and images beside them."""

from __future__ import annotations

import os
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from oysterbench.annotations.coco import CocoFile, CocoImage, read_coco
from oysterbench.annotations.image import Entry, LabelledImage, LabelledSet, planes_of, read_picture
from oysterbench.annotations.manifest import side_in
from oysterbench.core.errors import LabelError
from oysterbench.core.places import leads_out


def coco_set(path: Path, whole: bool = False) -> LabelledSet:
    """Open the images of a COCO file, found beside it, or in images/ beside it, by their file_name.

    It is named as the file; as its folder if this alone names a side (`side_in`), or if `whole`, where the folder was
    meant. Annotations of the category "oyster" are instances; those with iscrowd = 1 become pixels to be ignored; those
    of other categories are skipped. The keys clip and split of an image are used if present; without them, each image
    is a clip of its own. Raises LabelError naming the item that is wrong.
    """
    coco = read_coco(path)
    entries = []
    for key, image in coco.images.items():
        if leads_out(_name_beside(path, image)):
            raise LabelError(
                f"{path}: image {key}: expected a file_name relative to this folder or to images/ in it, got one that "
                f"leads out of it: {image.file_name!r:.80}; put the image there and correct its name"
            )
        file = picture_file(path, image)
        if file is None:
            raise LabelError(f"{path}: image {key}: no file {image.file_name} beside it, nor in images/")
        clip = image.clip or image.name
        entries.append(Entry(image.name, clip, partial(_read, coco, image, file, clip), (file, path), image.split))
    folder = path.resolve().parent.name
    # Roboflow calls each file _annotations.coco.json, in folders train/, valid/ and test/.
    named = folder if whole or (side_in(folder) and not side_in(path.stem)) else path.stem
    return LabelledSet(named, entries)


def picture_file(path: Path, image: CocoImage) -> Path | None:
    """File of an image of the COCO file at `path`, beside it or in images/ there; None if there is none."""
    name = _name_beside(path, image)
    places = () if leads_out(name) else (path.parent / name, path.parent / "images" / name)
    return next((place for place in places if place.is_file()), None)


def _name_beside(path: Path, image: CocoImage) -> str:
    """The file_name of an image, relative to the folder of the COCO file where it is an absolute path into it."""
    name, folder = image.file_name, path.parent.absolute()
    inside = os.path.isabs(name) and Path(name).is_relative_to(folder)
    return os.path.relpath(name, folder) if inside else name


def read_coco_picture(file: Path, image: CocoImage) -> NDArray[np.uint8]:
    """Read the pixels (H, W, 3) uint8 RGB of an image. Raises LabelError if they are not of the size that the COCO file
    states."""
    pixels = read_picture(file)
    height, width = pixels.shape[:2]
    if (image.width, image.height) != (width, height):
        raise LabelError(
            f"{file}: expected {image.width} x {image.height} px, as the COCO file says, got {width} x {height}"
        )
    return pixels


def _read(coco: CocoFile, image: CocoImage, file: Path, clip: str) -> LabelledImage:
    pixels = read_coco_picture(file, image)
    oysters, crowd = coco.truth(image.name)
    classes, instances = planes_of(oysters, image.height, image.width)
    return LabelledImage(
        image.name, clip, pixels, classes, instances, crowd & (instances == 0), living=coco.living(image.name)
    )
