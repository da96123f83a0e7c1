"""The cheap controls: give an image the colours of a real one, which needs no training and moves no edge."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace

import cv2
import numpy as np
from numpy.typing import NDArray

from oysterbench.annotations import LabelledImage, LabelledSet
from oysterbench.core.errors import LabelError
from oysterbench.core.streams import Streams
from oysterbench_baselines.cut.pictures import Picture

LEAST_SPREAD = 0.5
"""Lower limit of an image's standard deviation in L, a or b: without contrast, nothing is amplified to noise."""


def match_histograms(picture: Picture, model: Picture) -> Picture:
    """Return an image (H, W, 3) uint8 whose channels are distributed like those of `model`, of any size.

    Each level is mapped to the one at which the model's distribution function equals the image's in the middle of that
    level (Gonzalez & Woods, histogram specification).
    """
    found = np.empty_like(picture)
    for channel in range(3):
        counts = np.bincount(picture[..., channel].ravel(), minlength=256)
        wanted = np.bincount(model[..., channel].ravel(), minlength=256)
        place = (np.cumsum(counts) - counts / 2) / counts.sum()
        aim = (np.cumsum(wanted) - wanted / 2) / wanted.sum()
        held = wanted > 0
        levels = np.interp(place, aim[held], np.flatnonzero(held))
        found[..., channel] = np.round(levels).astype(np.uint8)[picture[..., channel]]
    return found


def match_reinhard(picture: Picture, model: Picture) -> Picture:
    """Return an image (H, W, 3) uint8 with the model's mean and standard deviation of L, a and b (Reinhard et al. 2001,
    in CIELAB)."""
    values, aims = lab(picture), lab(model)
    mean, spread = values.mean(axis=(0, 1)), np.maximum(values.std(axis=(0, 1)), LEAST_SPREAD)
    moved = (values - mean) / spread * aims.std(axis=(0, 1)) + aims.mean(axis=(0, 1))
    pixels = cv2.cvtColor(moved.astype(np.float32), cv2.COLOR_LAB2RGB)
    return np.asarray(np.clip(np.round(pixels * 255), 0, 255), dtype=np.uint8)


def lab(picture: Picture) -> NDArray[np.float32]:
    """Convert sRGB uint8 to CIELAB (H, W, 3) float32, L from 0 to 100."""
    return np.asarray(cv2.cvtColor(picture.astype(np.float32) / 255, cv2.COLOR_RGB2Lab), dtype=np.float32)


Transfer = Callable[[Picture, Picture], Picture]

TRANSFERS: dict[str, Transfer] = {"histogram": match_histograms, "reinhard": match_reinhard}


def recoloured(
    images: Iterable[LabelledImage], models: LabelledSet, transfer: Transfer, seed: int = 0
) -> Iterator[LabelledImage]:
    """Give labelled images the colours of real ones: for each, a clip and then one of its images is drawn, seeded by
    the image's name.

    In this way each clip of `models` gives its water to equally many, whatever its number of images. Raises LabelError
    without models.
    """
    if not len(models):
        raise LabelError(f"{models.name}: expected at least one image to take colours from, got none")
    clips = {clip: [k for k, entry in enumerate(models.entries) if entry.clip == clip] for clip in models.clips}
    streams = Streams(seed).at("recolour")
    for image in images:
        rng = streams.generator(image.name)
        clip = clips[models.clips[int(rng.integers(len(models.clips)))]]
        model = models[clip[int(rng.integers(len(clip)))]]
        yield replace(image, pixels=transfer(image.pixels, model.pixels))
