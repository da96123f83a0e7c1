"""Label images among those of a COCO set: a folder that has both could be one of masks, too."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from pathlib import Path, PurePosixPath
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from oysterbench.core.errors import LabelError
from oysterbench.core.pictures import decode_picture
from oysterbench.core.places import is_hidden

FLAT = 0.9
"""Of pixels and those to the right of them, more are equal in label images, from 0.97 on in rendered ones, and
fewer in photographs, 0.25 at most in rendered ones, 0.85 in smooth ones that were strongly compressed."""
OTHERS = re.compile(
    r"panoptic|pixelmaps|stuffthingmaps|(?<![^-_./])(?:depth|disparity)s?(?![-_]?\d+m)(?=[-_./])", re.IGNORECASE
)
"""In paths of maps that have the names of images and are no masks of oysters: those of COCO, and depths, but not sites
named by theirs, such as depth_03m, nor where a word of `MASKS` follows."""
MASKS = re.compile(
    r"(?:segmentation|label|mask|(?<![a-z])(?:gt|seg|ground[-_ ]?truth))s?(?:[-_]?(?:png|class|object|mask)s?)?(?=/)"
    r"|(?<![a-z])masks?(?![a-z])|label[-_]?\d|(?<![^/])label(?=\.png$)|task-\d+-annotation",
    re.IGNORECASE,
)
"""In paths of label images whose names need not be those of images: folders such as trainmasks/ or SegmentationClass/,
the word mask, and what programs call them: label0001, JsonToDataset/label.png, task-1-annotation-1 of Label Studio."""
PALETTE = b"\x03"
"""Colour type of a PNG with a palette, at byte 25: numbers, with a colour for each."""
SHARE = 4
"""Of pictures of a COCO set, more than one in so many are label images where masks stand in their place, and fewer
where frames are dark, overexposed, or title cards."""
MOST = 50
"""So many files, evenly spaced, are decoded to find label images among them."""


def check_no_masks(place: Path, path: Path, names: Iterable[str], pictures: Iterable[Path]) -> None:
    """Refuse a folder with a COCO file at `path` that could be one of masks, too: where pictures of the file are label
    images, or PNG files that are named after its images, as a.png or a-mask.png beside a.jpg, or after masks, or of any
    name where none of its pictures is there. names: of the files of its images; pictures: those of them that are
    there."""
    known = {picture.resolve() for picture in pictures}
    stems = {PurePosixPath(name).stem.casefold() for name in names}
    files = png_files(place)
    own = _some([file for file in files if file.resolve() in known])
    others = [file for file in files if file.resolve() not in known]
    called = {file for file in others if _last(MASKS, _below(place, file)) > _last(OTHERS, _below(place, file))}
    rest = [file for file in others if file in called or not OTHERS.search(_below(place, file))]
    named = [file for file in rest if file in called or _is_named_after(file, stems)]
    found = next((file for file in _some(named if known else rest) if is_label_image(file)), None)
    alike = [file for file in own if is_label_image(file)]
    if found is None and SHARE * len(alike) > len(own):
        # A photograph may be all black, as at the end of a video, and a mask too, where there is no oyster.
        whole = alike if len(alike) == len(own) else [file for file in alike if is_label_image(file, blank=False)]
        found = next(iter(whole), None)
    if found is not None:
        raise LabelError(
            f"{place}: expected masks or COCO annotations, got both, such as {found} and {path}: give the COCO file "
            "itself if it is meant, else move it elsewhere"
        )


def _last(words: re.Pattern[str], path: str) -> int:
    """Where the last of these words begins in a path; -1 where there is none."""
    return max((found.start() for found in words.finditer(path)), default=-1)


def is_label_image(path: Path, blank: bool = True) -> bool:
    """Whether an image file is grey, or has a palette, and has two values or large areas of one, as masks and numbers
    of oysters have; one in other colours, such as a plot, is never read as a mask. blank: what to say of one value
    alone. False for a file that cannot be read."""
    try:
        data = path.read_bytes()
    except OSError:
        return False
    pixels = decode_picture(data, cv2.IMREAD_UNCHANGED)
    if pixels is None:
        return False
    if pixels.ndim == 3:
        if (pixels[..., :3] != pixels[..., :1]).any():
            return data[25:26] == PALETTE and bool(_same(pixels).mean() > FLAT)
        pixels = pixels[..., 0]
    least, most = pixels.min(), pixels.max()
    if least == most:
        return blank
    same = _same(pixels[..., None])
    return bool(np.count_nonzero(same) > FLAT * same.size or ((pixels == least) | (pixels == most)).all())


def _same(pixels: NDArray[Any]) -> NDArray[np.bool_]:
    """Which pixels (H, W, C) are equal to those to the right of them, (H, W - 1)."""
    return np.asarray((pixels[:, 1:] == pixels[:, :-1]).all(axis=-1))


def png_files(place: Path) -> list[Path]:
    """PNG files in a folder and those below, in order, but for hidden ones."""
    return sorted(path for path in place.rglob("*") if path.suffix.lower() == ".png" and not is_hidden(path, place))


def _is_named_after(file: Path, stems: set[str]) -> bool:
    """Whether the name of a file is one of some, or has one before or after a mark, as in a-mask and mask_a."""
    stem = file.stem.casefold()
    marks = list(re.finditer(r"[-_. ]+", stem))
    return bool(stems & {stem, *(stem[: mark.start()] for mark in marks), *(stem[mark.end() :] for mark in marks)})


def _below(place: Path, file: Path) -> str:
    return file.relative_to(place).as_posix()


def _some(files: Sequence[Path]) -> Sequence[Path]:
    return files[:: 1 + len(files) // MOST]
