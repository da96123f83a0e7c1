"""Features of images in a network pretrained on ImageNet."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
import torch
from numpy.typing import NDArray

from oysterbench.annotations import LabelledSet
from oysterbench.core.geometry import Array
from oysterbench_baselines.learning.efficientnet import pretrained, scaled

SIDE = 288
"""Side of the central square of an image, px, to which the shorter side is resized."""
BLOCK = 10
"""Number of consecutive images of a clip that count as one in the confidence interval of a distance."""
BATCH = 8

Picture = NDArray[np.uint8]


@dataclass(frozen=True)
class FeatureSet:
    """A set of N images: names; pictures, thumbnails (SIDE, SIDE, 3) uint8 RGB; features (N, d); blocks (N,), see
    `BLOCK`."""

    name: str
    names: tuple[str, ...]
    pictures: tuple[Picture, ...]
    features: Array
    blocks: Array


def sets_of(labelled: LabelledSet) -> dict[str, LabelledSet]:
    """Divide images into sets by clip: name of a clip -> its images. All are one set where no clips are known, which
    makes each image a clip of its own."""
    if len(labelled.clips) == len(labelled):
        whole = LabelledSet(labelled.name, (replace(entry, clip=labelled.name) for entry in labelled.entries))
        return {labelled.name: whole}
    return {clip: LabelledSet(clip, (e for e in labelled.entries if e.clip == clip)) for clip in labelled.clips}


def feature_set(
    labelled: LabelledSet, name: str, most: int, progress: Callable[[int, int], None] = lambda done, total: None
) -> FeatureSet:
    """Compute the features of a set, of evenly spaced images where it has more than `most`."""
    chosen = np.unique(np.linspace(0, len(labelled) - 1, min(most, len(labelled))).round().astype(int)).tolist()
    pictures, features, network = [], [], pretrained()
    torch.set_num_threads(1)  # fixed order of summation, and the fastest for batches as small as these
    for start in range(0, len(chosen), BATCH):
        some = [square(labelled[k].pixels) for k in chosen[start : start + BATCH]]
        pictures += some
        with torch.inference_mode():
            batch = torch.from_numpy(np.stack(some).transpose(0, 3, 1, 2).copy())
            features.append(network(scaled(batch)).numpy())
        progress(len(pictures), len(chosen))
    entries = [labelled.entries[k] for k in chosen]
    found = np.concatenate(features).astype(float)
    return FeatureSet(
        name, tuple(e.name for e in entries), tuple(pictures), found, blocks_of([e.clip for e in entries])
    )


def square(pixels: Picture) -> Picture:
    """Crop the central square of an image (H, W, 3), and resize it to (SIDE, SIDE, 3): reduced by areas, enlarged
    linearly."""
    height, width = pixels.shape[:2]
    side = min(height, width)
    top, left = (height - side) // 2, (width - side) // 2
    middle = pixels[top : top + side, left : left + side]
    how = cv2.INTER_AREA if side > SIDE else cv2.INTER_LINEAR
    return np.asarray(cv2.resize(middle, (SIDE, SIDE), interpolation=how), dtype=np.uint8)


def blocks_of(clips: Sequence[str]) -> Array:
    """Block numbers (N,) of images: a new one with each clip, and after every `BLOCK` images of it."""
    numbers: dict[tuple[str, int], int] = {}
    seen: dict[str, int] = {}
    found = []
    for clip in clips:
        seen[clip] = seen.get(clip, -1) + 1
        found.append(numbers.setdefault((clip, seen[clip] // BLOCK), len(numbers)))
    return np.array(found)
