"""Images of sets prepared for export: divided into parts, with file names, and their image files as stored."""

from __future__ import annotations

import json
import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from oysterbench.annotations.image import Entry, LabelledImage, LabelledSet, apart, read_picture
from oysterbench.annotations.manifest import SIDES, TEST, TRAIN, VAL, side_in
from oysterbench.core.errors import LabelError
from oysterbench.core.pictures import decode_picture
from oysterbench.recipe import CLASSES, OYSTER
from oysterbench.sequence import Sequence as OpenSequence
from oysterbench.sequence import open_sequence
from oysterbench.sequence.pictures import encoded_pictures, png_bytes

Parts = dict[str, list[Entry]]
"""Part -> its images, in order; only parts that have some."""

SUFFIXES = {"jpeg": "jpg", "png": "png"}


@dataclass(frozen=True)
class Example:
    """An image to be written. key: its name for files; suffix, data: suffix and content of its image file."""

    key: str
    image: LabelledImage
    suffix: str
    data: bytes

    def objects(self) -> list[dict[str, Any]]:
        """Objects that are labelled individually: number, class, box [x, y, width, height] px, area in px, and state:
        live or dead for oysters, unknown for others and where it is not known."""
        instances, classes = self.image.instances, self.image.classes
        found = []
        for number in np.unique(instances[instances > 0]).tolist():
            mask = instances == number
            rows, columns = np.nonzero(mask.any(axis=1))[0], np.nonzero(mask.any(axis=0))[0]
            left, top = int(columns[0]), int(rows[0])
            kind = int(np.bincount(classes[mask]).argmax())
            alive = self.image.living.get(number) if kind == OYSTER else None
            found.append(
                {
                    "id": int(number),
                    "category": CLASSES[kind],
                    "bbox": [left, top, int(columns[-1]) - left + 1, int(rows[-1]) - top + 1],
                    "area": int(mask.sum()),
                    "state": "unknown" if alive is None else "live" if alive else "dead",
                }
            )
        return found

    def conditions(self) -> str:
        """Conditions in which the image was taken, as a JSON object."""
        return json.dumps(dict(self.image.conditions), sort_keys=True)

    def planes(self) -> dict[str, NDArray[Any]]:
        """Planes (H, W): classes uint8, instances uint16, and ignore uint8, 255 for pixels to be ignored."""
        ignore = np.where(self.image.ignore, 255, 0).astype(np.uint8)
        return {"class": self.image.classes, "instance": self.image.instances, "ignore": ignore}


def parted(sets: Sequence[LabelledSet]) -> Parts:
    """Divide the images into parts, train, val and test first: by the sides that sets state, else by their names
    (`side_in`), else train. Names of parts, from sides that may be any text, are what Hugging Face allows for a split:
    letters, digits and `_`. Where sets have images of one name, such as frames of several videos, all are named after
    their sets (`image.apart`). Raises LabelError if two images have the same file name all the same, as sets overlap,
    or two sides the same name as parts."""
    found: Parts = {TRAIN: [], VAL: [], TEST: []}
    sides: dict[str, str] = {}
    for one in _told_apart(sets):
        own = side_in(one.name) or TRAIN
        for entry in one.entries:
            side = SIDES.get(entry.split, entry.split) or own
            part = re.sub(r"\W", "_", side)
            if sides.setdefault(part, side) != side:
                raise LabelError(f"the sides {sides[part]!r} and {side!r} are both named {part} in files: rename one")
            found.setdefault(part, []).append(entry)
    names: dict[str, str] = {}
    for entry in (entry for entries in found.values() for entry in entries):
        key = key_of(entry.name)
        if key in names:
            raise LabelError(
                f"two images have the same name, {names[key]} and {entry.name}: expected names that differ as file "
                "names; were overlapping sets given?"
            )
        names[key] = entry.name
    return {part: entries for part, entries in found.items() if entries}


def _told_apart(sets: Sequence[LabelledSet]) -> Sequence[LabelledSet]:
    files: dict[str, list[Path]] = {}
    for one in sets:
        for key, file in {key_of(entry.name): entry.files[0].resolve() for entry in one.entries}.items():
            files.setdefault(key, []).append(file)
    shared = [of for of in files.values() if len(of) > 1]
    overlapping = any(len(set(of)) < len(of) for of in shared)
    return apart(sets, "+".join(one.name for one in sets)) if shared and not overlapping else sets


def key_of(name: str) -> str:
    """File name of an image: without folders, and without dots, at which WebDataset splits names.

    >>> key_of("mini-01/cam_front/1767225600000000000")
    'mini-01_cam_front_1767225600000000000'
    """
    return re.sub(r"(?=[\0-\x7f])[^\w-]|[\s\ud800-\udfff]", "-", name.replace("/", "_"))


def examples(entries: Sequence[Entry], suffix: str | None = None) -> Iterator[Example]:
    """Read each image, with its image file: the stored bytes if they decode to the same pixels, else a PNG. suffix: the
    only one of stored bytes to be used."""
    for entry in entries:
        image = entry.read()
        stored = _stored(entry, image.pixels)
        if stored is None or suffix not in (None, stored[0]):
            stored = "png", png_bytes(image.pixels)
        yield Example(key_of(entry.name), image, *stored)


def common_suffix(entries: Iterable[Entry]) -> str:
    """Return the suffix with which all images can be written: jpg if each is stored as a JPEG that decodes to its
    pixels, else png."""
    stored = (_stored(entry, None if _in_sequence(entry) else read_picture(entry.files[0])) for entry in entries)
    return "jpg" if all(found is not None and found[0] == "jpg" for found in stored) else "png"


def _in_sequence(entry: Entry) -> bool:
    return entry.files[0].suffix == ".mcap"


def _stored(entry: Entry, expected: NDArray[np.uint8] | None) -> tuple[str, bytes] | None:
    """Suffix and bytes of the image file in its set; None if it decodes to other pixels than expected, as when EXIF
    asks the viewer to rotate it. expected: not needed of an image in a sequence."""
    file = entry.files[0]
    if _in_sequence(entry):
        camera, stamp = entry.name.rsplit("/", 2)[1:]
        found = next(encoded_pictures(_opened(file), camera, int(stamp), int(stamp) + 1), None)
        return None if found is None else (SUFFIXES[found.form], found.data)
    suffix = {".jpg": "jpg", ".jpeg": "jpg", ".png": "png"}.get(file.suffix.lower())
    if suffix is None:
        return None
    data = file.read_bytes()
    pixels = decode_picture(data, cv2.IMREAD_COLOR_RGB | cv2.IMREAD_IGNORE_ORIENTATION)
    same = pixels is not None and expected is not None and np.array_equal(pixels, expected)
    return (suffix, data) if same else None


@lru_cache(maxsize=4)
def _opened(file: Path) -> OpenSequence:
    return open_sequence(file)


def rendered(parts: Parts) -> bool:
    """Whether all images come from sequences, and none are photographs."""
    return all(_in_sequence(entry) for entries in parts.values() for entry in entries)
