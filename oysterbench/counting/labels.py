"""Labels that lie among images, as programs for annotation write them: they are images themselves, and not to count."""

from __future__ import annotations

import re
from collections.abc import Iterable
from functools import cache
from pathlib import Path

from oysterbench.core.pictures import decode_picture, has_few_colours

IMAGES = ("images", "image", "imgs", "img", "jpegimages")
"""Names of folders of images that have labels beside them; in any case, as those of labels."""
LABELS = re.compile(
    r"masks?([-_].+)?|instances?|ignore|labels?|annotations?|segmentation(class|object)\w*", re.IGNORECASE
)
"""Names of folders of labels: of `annotations.folders`, YOLO, Supervisely (masks_machine, masks_human), and Pascal VOC,
as CVAT and Labelme write it (SegmentationClass, SegmentationObject, SegmentationClassPNG)."""
MASK = "_mask"
"""What Roboflow puts after the name of an image to name its mask, which lies beside it."""
LOSSLESS = (".png", ".bmp", ".tif", ".tiff", ".webp", ".pgm", ".ppm")


def folders_of_labels(names: Iterable[str]) -> set[str]:
    """Select the folders of labels from all in a folder: there are none where no folder of images is among them.

    >>> sorted(folders_of_labels(["img", "masks_machine", "more"])), folders_of_labels(["masks", "more"])
    (['masks_machine'], set())
    """
    names = list(names)
    if not any(name.casefold() in IMAGES for name in names):
        return set()
    return {name for name in names if LABELS.fullmatch(name)}


def masks_beside(pictures: Iterable[Path]) -> list[Path]:
    """Select the images that are the mask of another in the same folder by their names."""
    pictures = list(pictures)
    bare = {path.with_suffix("") for path in pictures}
    named = [path for path in pictures if path.stem.endswith(MASK)]
    return [path for path in named if path.with_name(path.stem.removesuffix(MASK)) in bare]


def seeming_labels(pictures: Iterable[Path]) -> dict[Path, Path]:
    """Folders whose images seem to be labels of those of another, beside or above it -> that folder: all have the names
    of images there, and the first has few colours, as the one there has not."""
    folders: dict[Path, dict[str, Path]] = {}
    for path in pictures:
        folders.setdefault(path.parent, {})[path.stem] = path
    beside: dict[Path, list[Path]] = {}
    for folder in folders:
        beside.setdefault(folder.parent, []).append(folder)
    # Where the first images of many folders have few colours, as black frames of videos, each is compared with all.
    few = cache(_has_few_colours)
    found: dict[Path, Path] = {}
    for folder, own in folders.items():
        near = [one for one in (*beside[folder.parent], folder.parent) if one != folder and one in folders]
        alike = [one for one in near if own.keys() <= folders[one].keys()]
        first = min(own)
        if alike and few(own[first]):
            images = next((one for one in alike if not few(folders[one][first])), None)
            found |= {} if images is None else {folder: images}
    return found


def _has_few_colours(path: Path) -> bool:
    """Whether an image is stored without loss in few colours. False where it cannot be read."""
    import cv2

    if path.suffix.lower() not in LOSSLESS:
        return False
    try:
        pixels = decode_picture(path.read_bytes(), cv2.IMREAD_UNCHANGED)
    except OSError:
        return False
    return pixels is not None and has_few_colours(pixels)
