"""Images of the source and the target: read once, checked, cropped at random."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np
import torch
from numpy.typing import NDArray

from oysterbench.annotations import LabelledSet
from oysterbench.core.errors import LabelError

LEAST_PICTURES = 20
"""Minimum number of images of source and target: with fewer, the discriminator memorises them."""

Picture = NDArray[np.uint8]


def read_pictures(labelled: LabelledSet, crop: int, scale: float) -> list[Picture]:
    """Read the images of a set, (h, w, 3) uint8 RGB, reduced to `scale` by averaging over areas.

    Raises LabelError for fewer than `LEAST_PICTURES`, for one that is smaller than a crop, and for one of a single grey
    level, which has no statistics.
    """
    if len(labelled) < LEAST_PICTURES:
        raise LabelError(
            f"{labelled.name}: expected at least {LEAST_PICTURES} images to learn a translation from, got "
            f"{len(labelled)}; for fewer, `oysterbench translate reinhard` needs no training"
        )
    found = []
    for image in labelled:
        pixels = shrunk(image.pixels, scale)
        if min(pixels.shape[:2]) < crop:
            height, width = image.pixels.shape[:2]
            raise LabelError(
                f"{labelled.name}: {image.name}: expected at least {round(crop / scale)} px of width and height for "
                f"crops of {crop} px at scale {scale:g}, got {width} x {height}"
            )
        if pixels.min() == pixels.max():
            raise LabelError(f"{labelled.name}: {image.name}: every pixel is {int(pixels.min())}: the image is empty")
        found.append(pixels)
    return found


def shrunk(pixels: Picture, scale: float) -> Picture:
    """Reduce (H, W, 3) to a scale of at most 1, averaging over areas."""
    if scale == 1.0:
        return pixels
    size = (round(pixels.shape[1] * scale), round(pixels.shape[0] * scale))
    return np.asarray(cv2.resize(pixels, size, interpolation=cv2.INTER_AREA), dtype=np.uint8)


def draw_crop(pictures: Sequence[Picture], size: int, rng: np.random.Generator) -> torch.Tensor:
    """Draw a random crop (1, 3, size, size) in [-1, 1] of a random image, mirrored half the time."""
    picture = pictures[int(rng.integers(len(pictures)))]
    top = int(rng.integers(picture.shape[0] - size + 1))
    left = int(rng.integers(picture.shape[1] - size + 1))
    crop = picture[top : top + size, left : left + size]
    return as_tensor(crop[:, ::-1] if rng.random() < 0.5 else crop)


def as_tensor(picture: Picture) -> torch.Tensor:
    """Convert (h, w, 3) uint8 to (1, 3, h, w) float32 in [-1, 1]."""
    values = torch.from_numpy(np.ascontiguousarray(picture.transpose(2, 0, 1)))
    return values[None].float() / 127.5 - 1


def as_picture(values: torch.Tensor) -> Picture:
    """Convert (1, 3, h, w) in [-1, 1] to (h, w, 3) uint8."""
    pixels = ((values[0].detach().cpu().numpy() + 1) * 127.5).transpose(1, 2, 0)
    return np.ascontiguousarray(np.clip(np.round(pixels), 0, 255), dtype=np.uint8)
