"""Pictures as a network that has learnt on ImageNet sees them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
import torch
from numpy.typing import NDArray

from oysterbench.annotations import LabelledSet
from oysterbench.core.geometry import Array
from oysterbench_baselines.learning.efficientnet import pretrained, scaled

SIDE = 288
"""px, of the square in the middle that is looked at, the shorter side brought to it."""
BLOCK = 10
"""Pictures of a clip, one after the other, that count as one where it is told how sure a distance is."""
BATCH = 8

Picture = NDArray[np.uint8]


@dataclass(frozen=True)
class FeatureSet:
    """Some pictures: names; thumbnails (SIDE, SIDE, 3) uint8 RGB; features (N, d); blocks (N,), see `BLOCK`."""

    name: str
    names: tuple[str, ...]
    pictures: tuple[Picture, ...]
    features: Array
    blocks: Array


def feature_set(
    labelled: LabelledSet, name: str, most: int, progress: Callable[[int, int], None] = lambda done, total: None
) -> FeatureSet:
    """Of a set, evenly over its images where it has more than `most`."""
    chosen = np.unique(np.linspace(0, len(labelled) - 1, min(most, len(labelled))).round().astype(int)).tolist()
    pictures, features, network = [], [], pretrained()
    torch.set_num_threads(1)  # sums in one order; and for batches as small as these, the fastest
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
    """(SIDE, SIDE, 3): the middle of a picture (H, W, 3), its shorter side brought to SIDE by areas."""
    height, width = pixels.shape[:2]
    side = min(height, width)
    top, left = (height - side) // 2, (width - side) // 2
    middle = pixels[top : top + side, left : left + side]
    how = cv2.INTER_AREA if side > SIDE else cv2.INTER_LINEAR
    return np.asarray(cv2.resize(middle, (SIDE, SIDE), interpolation=how), dtype=np.uint8)


def blocks_of(clips: Sequence[str]) -> Array:
    """(N,) numbers: a new one with each clip, and after every `BLOCK` pictures of it."""
    numbers: dict[tuple[str, int], int] = {}
    seen: dict[str, int] = {}
    found = []
    for clip in clips:
        seen[clip] = seen.get(clip, -1) + 1
        found.append(numbers.setdefault((clip, seen[clip] // BLOCK), len(numbers)))
    return np.array(found)
