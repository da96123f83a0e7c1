"""Data sets as COCO annotations and images beside them."""

from __future__ import annotations

import os
import re
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from oysterbench.annotations.coco import CocoFile, CocoImage, read_coco
from oysterbench.annotations.image import Entry, LabelledImage, LabelledSet, planes_of, read_picture
from oysterbench.annotations.manifest import side_in
from oysterbench.core.errors import LabelError
from oysterbench.core.places import leads_out, shown

ANNOTATIONS = "annotations"
"""Folder beside those of images in which COCO itself and CVAT put the file."""
IMAGES = re.compile(rb'"images"\s*:\s*\[')
"""What is in a COCO document, told without parsing it: those of COCO itself have 450 MB."""


def coco_files(folder: Path) -> list[Path]:
    """Files of a folder that may be COCO annotations: JSON files in it or, without any, those in annotations/ there
    that have a list of images."""
    own = [path for path in shown(folder, "*.json") if path.is_file()]
    return own or [path for path in shown(folder / ANNOTATIONS, "*.json") if path.is_file() and _has_images(path)]


def _has_images(path: Path) -> bool:
    try:
        return IMAGES.search(path.read_bytes()) is not None
    except OSError:
        return True  # to be refused where it is read, with the reason


def coco_set(path: Path, whole: bool = False) -> LabelledSet:
    """Open the images of a COCO file, found by their file_name where programs put them (`picture_file`).

    It is named as the file; as its folder (`_root`) if this alone names a side (`side_in`), or if `whole`, where the
    folder was meant. Annotations of oysters (`categories_of`) are instances; those with iscrowd = 1 become pixels to be
    ignored; those of other categories are skipped. The keys clip and split of an image are used if present; without
    them, each image is a clip of its own. Raises LabelError naming the item that is wrong.
    """
    coco = read_coco(path)
    entries = []
    for key, image in coco.images.items():
        if leads_out(_name_inside(path, image)):
            raise LabelError(
                f"{path}: image {key}: expected a file_name relative to this folder or to images/ in it, got one that "
                f"leads out of it: {image.file_name!r:.80}; put the image there and correct its name"
            )
        file = picture_file(path, image)
        if file is None:
            looked = ", ".join(map(str, _folders(path)))
            raise LabelError(f"{path}: image {key}: no file {image.file_name} in any of {looked}")
        clip = image.clip or image.name
        entries.append(Entry(image.name, clip, partial(_read, coco, image, file, clip), (file, path), image.split))
    folder = _root(path).resolve().name
    # Roboflow calls each file _annotations.coco.json, in folders train/, valid/ and test/.
    named = folder if whole or (side_in(folder) and not side_in(path.stem)) else path.stem
    return LabelledSet(named, entries)


def picture_file(path: Path, image: CocoImage) -> Path | None:
    """File of an image of the COCO file at `path`, in one of `_folders`; None if there is none. Raises LabelError where
    there are several, other than links to one."""
    name = _name_inside(path, image)
    found = [] if leads_out(name) else [file for folder in _folders(path) if (file := folder / name).is_file()]
    for other in found[1:]:
        if not other.samefile(found[0]):
            raise LabelError(f"{path}: {name} could be {found[0]} or {other}: rename or remove one of them")
    return found[0] if found else None


def _folders(path: Path) -> list[Path]:
    """Folders in which the images of a COCO file may lie, relative to which their names are: that of the file, images/
    (Label Studio) or data/ (FiftyOne) there; of a file annotations/KIND_SUBSET.json also the folder above, and images/,
    images/SUBSET/ (CVAT) or SUBSET/ (COCO 2017) in it."""
    root, subset = _root(path), path.stem.partition("_")[2]
    found = [path.parent, path.parent / "images", path.parent / "data"]
    if root != path.parent:
        found += [root, root / "images"] + ([root / "images" / subset, root / subset] if subset else [])
    return found


def _root(path: Path) -> Path:
    """Folder of the data set of a COCO file."""
    folder = path.absolute().parent
    return folder.parent if folder.name == ANNOTATIONS else path.parent


def _name_inside(path: Path, image: CocoImage) -> str:
    """The file_name of an image, relative to the folder of the data set where it is an absolute path into it."""
    name, root = image.file_name, _root(path).absolute()
    inside = os.path.isabs(name) and Path(name).is_relative_to(root)
    return os.path.relpath(name, root) if inside else name


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
