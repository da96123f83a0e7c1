"""Data sets as folders of masks: images/NAME.png or .jpg, masks/NAME.png, and optional further files.

masks/NAME.png      8 bits: 0 and one other value for oysters (1 or 255, as you like)
instances/NAME.png  16 or 8 bits, for all images or none: a number for each oyster; without it, each part
                    connected by edges or corners is one, as in a mask that is scored
ignore/NAME.png     8 bits, optional: non-zero for pixels to be ignored
manifest.csv        optional: id, clip, split
"""

from __future__ import annotations

import csv
import io
from collections.abc import Callable, Iterable
from functools import partial
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from oysterbench.annotations.image import Entry, LabelledImage, LabelledSet, read_picture, read_plane
from oysterbench.annotations.manifest import FILE, files_of, images_with
from oysterbench.annotations.parts import connected_parts
from oysterbench.core.atomic import write_atomically
from oysterbench.core.errors import LabelError
from oysterbench.core.places import shown
from oysterbench.recipe import OYSTER

LAYERS = ("images", "masks", "instances", "ignore")
"""Folders of such a data set, with one file for each image."""


def mask_set(folder: Path) -> LabelledSet:
    """Open the images of such a folder. Raises LabelError for an image without its mask, or without a file in
    instances/ where others have one, and for a file in any of the folders that belongs to no image."""
    extra = {kind: _further(folder / kind) for kind in ("instances", "ignore")}
    entries = []
    for name, row, image, mask in images_with(folder, "masks", ".png"):
        if extra["instances"] and name not in extra["instances"]:
            raise LabelError(f"{folder}: image {name} has no instances/{name}.png, but others do; expected all or none")
        further = {kind: files[name] for kind, files in extra.items() if name in files}
        read = partial(_read, image, mask, further, name, row.clip)
        entries.append(Entry(name, row.clip, read, (image, mask, *further.values()), row.split))
    for kind, files in extra.items():
        for name in files.keys() - {entry.name for entry in entries}:
            raise LabelError(
                f"{files[name]}: no image {name} in images/: name {kind}/NAME.png as its image, or delete it"
            )
    return LabelledSet(folder.resolve().name, entries)


def _further(folder: Path) -> dict[str, Path]:
    """Files of a folder that need not be there, by name of the image. Raises LabelError for one that is no .png."""
    found = files_of(folder, ".png")
    for path in shown(folder, "*"):
        if found.get(path.stem) != path and not path.is_dir():
            raise LabelError(f"{path}: expected .png files alone, named as the images: save it as one, or delete it")
    return found


def _read(image: Path, mask: Path, further: dict[str, Path], name: str, clip: str) -> LabelledImage:
    pixels, values = read_picture(image), read_plane(mask)
    known = [int(value) for value in np.unique(values) if value]
    if len(known) > 1:
        raise LabelError(
            f"{mask}: expected 0 and one other value, got {known[:6]}; put numbers of oysters in instances/, beside "
            "masks of 0 and 255 here, or in COCO annotations, and pixels to be ignored in ignore/"
        )
    oysters = values > 0
    if "instances" in further:
        instances = read_plane(further["instances"]).astype(np.uint16)
        if instances.shape == oysters.shape and (instances[~oysters] > 0).any():
            raise LabelError(f"{further['instances']}: has instances outside the mask {mask}")
    else:
        instances = connected_parts(oysters)[0].astype(np.uint16)
    ignore = read_plane(further["ignore"]) > 0 if "ignore" in further else np.zeros(oysters.shape, dtype=bool)
    classes = np.where(oysters, OYSTER, 0).astype(np.uint8)
    return LabelledImage(name, clip, pixels, classes, instances, ignore)


def write_folder(
    images: Iterable[LabelledImage],
    folder: Path,
    splits: dict[str, str] | None = None,
    progress: Callable[[int], None] = lambda done: None,
) -> int:
    """Write images as such a folder, which may exist already; return their number. Only oysters are written: the format
    has no other classes. Slashes in names become dashes. splits: by name of an image. A folder that is not complete has
    a manifest.csv without images, with which it is refused."""
    rows: list[tuple[str, str, str]] = []
    for image in images:
        if not rows:
            _write_manifest(folder, rows)
        name = image.name.replace("/", "-")
        instances = np.where(image.oysters, image.instances, 0).astype(np.uint16)
        write_picture(folder / "images" / f"{name}.png", image.pixels)
        write_picture(folder / "masks" / f"{name}.png", np.where(image.oysters, 255, 0).astype(np.uint8))
        write_picture(folder / "instances" / f"{name}.png", instances)
        write_picture(folder / "ignore" / f"{name}.png", np.where(image.ignore, 255, 0).astype(np.uint8))
        rows.append((name, image.clip.replace("/", "-"), (splits or {}).get(image.name, "")))
        progress(len(rows))
    _write_manifest(folder, rows)
    return len(rows)


def _write_manifest(folder: Path, rows: list[tuple[str, str, str]]) -> None:
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows([("id", "clip", "split"), *rows])
    write_atomically(folder / FILE, text.getvalue().encode())


def remove_image(folder: Path, name: str) -> None:
    """Remove an image that `write_folder` wrote, if it exists; manifest.csv is only updated by the next writing."""
    for layer in LAYERS:
        (folder / layer / f"{name.replace('/', '-')}.png").unlink(missing_ok=True)


def write_picture(path: Path, pixels: NDArray[Any]) -> None:
    """Write (H, W, 3) uint8 RGB, or (H, W) uint8 or uint16, as PNG, atomically."""
    done, data = cv2.imencode(".png", pixels[..., ::-1] if pixels.ndim == 3 else pixels)
    if not done:
        raise LabelError(f"{path}: could not be encoded as PNG")
    write_atomically(path, data.tobytes())
