"""Labelled images, and sets of them that are read one image at a time."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from itertools import count
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from oysterbench.core.errors import LabelError
from oysterbench.core.pictures import decode_picture, jpeg_end, upper_bits
from oysterbench.recipe import OYSTER


@dataclass(frozen=True, repr=False)
class LabelledImage:
    """An image with labels for each pixel.

    name:       unique in its set
    clip:       the recording it belongs to: images of a clip resemble each other, and go to one side of a split
    pixels:     (H, W, 3) uint8 RGB
    classes:    (H, W) uint8, numbers of `recipe.CLASSES`; if only oysters are labelled, 0 is everything else
    instances:  (H, W) uint16, 0 for none; one number per oyster, and per other object that is labelled individually
    ignore:     (H, W) bool, pixels to be ignored: neither trained on nor scored
    conditions: in which the image was taken, by keys of `evaluate.conditions.CONDITIONS` and "camera"
    living:     whether oysters are alive, by their numbers in `instances`; unknown ones are left out
    """

    name: str
    clip: str
    pixels: NDArray[np.uint8]
    classes: NDArray[np.uint8]
    instances: NDArray[np.uint16]
    ignore: NDArray[np.bool_]
    conditions: Mapping[str, float | str] = field(default_factory=dict)
    living: Mapping[int, bool] = field(default_factory=dict)

    def __post_init__(self) -> None:
        height, width = self.pixels.shape[:2]
        for what in ("classes", "instances", "ignore"):
            found = getattr(self, what).shape
            if found != (height, width):
                raise LabelError(
                    f"{self.name}: {what}: expected the size of the image, {width} x {height}, got "
                    f"{' x '.join(str(n) for n in found[::-1])}"
                )

    def __repr__(self) -> str:
        height, width = self.pixels.shape[:2]
        numbers = np.unique(self.instances[self.oysters])
        return f"<LabelledImage {self.name}: {width} x {height}, {np.count_nonzero(numbers)} oysters>"

    def _repr_png_(self) -> bytes:
        from oysterbench.core.display import marked, png

        return png(marked(self.pixels, self.oysters))

    @property
    def oysters(self) -> NDArray[np.bool_]:
        """Mask (H, W) bool of the oysters."""
        return np.asarray(self.classes == OYSTER)


@dataclass(frozen=True)
class Entry:
    """An image of a set that is not read yet. split: "train", "test" or as its set states; empty if it states none."""

    name: str
    clip: str
    read: Callable[[], LabelledImage]
    files: tuple[Path, ...]
    split: str = ""


class LabelledSet:
    """Images in a fixed order, each read on access."""

    def __init__(self, name: str, entries: Iterable[Entry]) -> None:
        self.name = name
        self.entries = tuple(entries)
        seen: set[str] = set()
        for entry in self.entries:
            if entry.name in seen:
                raise LabelError(f"{name}: two images are named {entry.name!r}; expected a unique name for each")
            seen.add(entry.name)

    def __repr__(self) -> str:
        return f"<LabelledSet {self.name}: {len(self)} images of {len(self.clips)} clips>"

    def __len__(self) -> int:
        return len(self.entries)

    def __getitem__(self, index: int) -> LabelledImage:
        return self.entries[index].read()

    def __iter__(self) -> Iterator[LabelledImage]:
        return (entry.read() for entry in self.entries)

    @property
    def clips(self) -> tuple[str, ...]:
        """Names of the clips, in order of their first images."""
        return tuple(dict.fromkeys(entry.clip for entry in self.entries))

    @property
    def splits(self) -> tuple[str, ...]:
        """Names of the splits into which the set itself is divided; empty if it is not."""
        return tuple(dict.fromkeys(entry.split for entry in self.entries if entry.split))

    def where(self, keep: Callable[[Entry], Any], name: str = "") -> LabelledSet:
        """Return the set of the images for which `keep` is true, in the same order."""
        return LabelledSet(name or self.name, [entry for entry in self.entries if keep(entry)])

    def of_split(self, split: str) -> LabelledSet:
        """Return the set of the images of a split, in either case. Raises LabelError if there are none."""
        found = self.where(lambda entry: entry.split == split.casefold(), f"{self.name} {split.casefold()}")
        if not len(found):
            raise LabelError(
                f"{self.name}: no image of split {split!r}; its splits: {', '.join(self.splits) or 'none'}; a "
                "manifest.csv with the columns id, clip and split assigns them"
            )
        return found

    def digest(self) -> str:
        """SHA-256 of names, clips, splits, and the content of every file of the set."""
        sums: dict[Path, str] = {}
        text = hashlib.sha256()
        for entry in self.entries:
            for path in entry.files:
                if path not in sums:
                    sums[path] = file_digest(path)
            parts = (entry.name, entry.clip, entry.split, *(sums[path] for path in entry.files))
            text.update("\0".join(parts).encode() + b"\n")
        return text.hexdigest()


def planes_of(
    masks: Iterable[NDArray[np.bool_]], height: int, width: int
) -> tuple[NDArray[np.uint8], NDArray[np.uint16]]:
    """Class and instance planes (H, W) of oyster masks (H, W), which are numbered from 1. Where several overlap, a
    pixel belongs to the smallest: an oyster on top of another is usually seen whole, in front of it."""
    instances = np.zeros((height, width), dtype=np.uint16)
    areas = np.full((height, width), height * width, dtype=np.int32)
    for number, mask in enumerate(masks, start=1):
        area = np.count_nonzero(mask)
        on_top = mask & (area <= areas)
        instances[on_top], areas[on_top] = number, area
    return np.where(instances > 0, OYSTER, 0).astype(np.uint8), instances


def joined(sets: Iterable[LabelledSet], name: str) -> LabelledSet:
    """Join several sets into one, with the names of `apart`. Raises LabelError where sets of one name have an image
    file in common."""
    return LabelledSet(name, [entry for one in apart(sets, name) for entry in one.entries])


def apart(sets: Iterable[LabelledSet], name: str) -> list[LabelledSet]:
    """Name images and clips of several sets SET/NAME, or SET-2/NAME in the second set of one name, as COCO files of
    several folders may have, by the first number that leads to the name of no other. name: of all together. Raises
    LabelError where sets of one name have an image file in common."""

    def renamed(entry: Entry, part: str) -> Entry:
        own, clip = f"{part}/{entry.name}", f"{part}/{entry.clip}"
        return Entry(own, clip, lambda: replace(entry.read(), name=own, clip=clip), entry.files, entry.split)

    sets = list(sets)
    names = {one.name for one in sets}
    found: list[LabelledSet] = []
    files: dict[str, set[Path]] = {}
    for one in sets:
        own = {path.resolve(): entry.name for entry in one.entries for path in entry.files[:1]}
        if common := own.keys() & files.get(one.name, set()):
            file = min(common)
            raise LabelError(f"{name}: two images are named '{one.name}/{own[file]}', both of {file}: give it once")
        numbered = (f"{one.name}-{number}" for number in count(2))
        part = next(free for free in numbered if free not in names) if one.name in files else one.name
        names.add(part)
        files.setdefault(one.name, set()).update(own)
        found.append(LabelledSet(one.name, [renamed(entry, part) for entry in one.entries]))
    return found


def file_digest(path: Path) -> str:
    """SHA-256 of a file. Raises LabelError if it cannot be read."""
    try:
        with open(path, "rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except OSError as error:
        raise LabelError(f"{path}: cannot be read: {error.strerror or error}") from None


def read_picture(path: Path) -> NDArray[np.uint8]:
    """Read an image file as (H, W, 3) uint8 RGB; of more than 8 bits the upper 8 that are used are kept
    (`upper_bits`), as where oysters are counted. Raises LabelError naming the file."""
    pixels = _decoded(path, cv2.IMREAD_COLOR | cv2.IMREAD_ANYDEPTH)
    if pixels.dtype == np.uint16:
        pixels = upper_bits(pixels)
    if pixels.dtype != np.uint8:
        raise LabelError(f"{path}: expected an image of 8 or 16 bits, got {pixels.dtype}: save it as one of these")
    return np.ascontiguousarray(pixels[..., ::-1])


def read_plane(path: Path) -> NDArray[Any]:
    """Read an image file with one channel, or three equal ones, as (H, W) uint8 or uint16. Raises LabelError naming the
    file, also where its transparency is not opaque: painting programs put masks there, on a ground of any colour."""
    values = _decoded(path, cv2.IMREAD_UNCHANGED)
    if values.ndim == 3 and values.shape[2] == 4 and values.dtype in (np.uint8, np.uint16):
        opacity = values[..., 3]
        if (opacity < np.iinfo(values.dtype).max).any() and ((opacity > 0) != (values[..., 0] > 0)).any():
            raise LabelError(
                f"{path}: expected one channel, got transparency that differs from it: put a black ground under the "
                "mask, flatten the image, and save it as grey without an alpha channel"
            )
    if values.ndim == 3 and (values[..., :3] == values[..., :1]).all():
        values = values[..., 0]
    if values.ndim != 2 or values.dtype not in (np.uint8, np.uint16):
        raise LabelError(f"{path}: expected one channel of 8 or 16 bits, got {values.dtype} of shape {values.shape}")
    return values


def is_colour(path: Path) -> bool:
    """Whether an image file has several channels that are not equal. False for a file that cannot be read."""
    try:
        pixels = decode_picture(path.read_bytes(), cv2.IMREAD_UNCHANGED)
    except OSError:
        return False
    return pixels is not None and pixels.ndim == 3 and bool((pixels[..., :3] != pixels[..., :1]).any())


def _decoded(path: Path, flags: int) -> NDArray[Any]:
    try:
        data = path.read_bytes()
    except OSError as error:
        raise LabelError(f"{path}: cannot be read: {error.strerror or error}") from None
    values = decode_picture(data, flags)
    if values is None:
        raise LabelError(f"{path}: not an image that can be decoded ({len(data)} bytes); get the file again")
    if data.startswith(b"\xff\xd8") and jpeg_end(data) < 0:
        # A truncated JPEG is silently decoded, with the rest filled in grey.
        raise LabelError(f"{path}: the JPEG ends before its end marker: the file is truncated; get it again")
    return values
