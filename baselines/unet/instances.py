"""Oysters one by one, from where oysters are and how deep in one each pixel lies: a watershed from the hills of depth.

Soille 2003 (Morphological Image Analysis, ch. 6 and 9): a marker is a maximum of depth that stands out by `rise` at
least over the ground between it and any higher one; markers are grown level by level, down the hills, so that oysters
that touch part along the valley between them.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from oysterbench_baselines.learning.samples import Floats, depths

SIDE = 320
"""px of a picture's longer side, in which lengths and areas of a `Division` are."""
LEVELS = 16
"""Of depth, by which markers are grown."""
LARGEST = 640
"""px of a picture's longer side: larger ones are divided at this size, and what is found is enlarged."""

Labels = NDArray[np.int32]


@dataclass(frozen=True)
class Division:
    """How oysters are told apart, lengths being those of a picture whose longer side has `SIDE` px. smooth: px, the
    deviation by which depth is smoothed; rise, least: of depth, 0 to 1, by which a marker stands out, and that it has;
    area: px that an oyster has at least; large: px, the root of the area from which on size speaks no more against an
    oyster; sure: the score from which on an oyster is counted, before it is moved to 0.5."""

    smooth: float = 1.0
    rise: float = 0.1
    least: float = 0.3
    area: float = 12.0
    large: float = 15.0
    sure: float = 0.5

    def closer(self, zoom: float) -> Division:
        """That of a picture that was looked at enlarged, in which finer things are told apart."""
        return replace(self, smooth=self.smooth / zoom, area=self.area / zoom**2)


@dataclass(frozen=True)
class Instances:
    """labels (H, W) int32, 0 for none, instance k + 1 of score scores[k]; scores (N,) 0 to 1."""

    labels: Labels
    scores: NDArray[np.float64]

    @property
    def areas(self) -> NDArray[np.int64]:
        """(N,) px of each."""
        return np.bincount(self.labels.ravel(), minlength=len(self.scores) + 1)[1:]


def find_instances(oyster: Floats, depth: Floats, division: Division | None = None) -> Instances:
    """Instances from two (H, W) probabilities, of which no two share a pixel: nothing is left to suppress.

    Each pixel of the mask (from 0.5 on) goes to the marker whose hill it lies on. A piece of the mask without a marker
    is one of low score. The score is the mean probability over the instance, times the square of how well the depth
    within it is that of its outline (1 less the mean difference), times the root of its size over `division.large`
    where it is smaller; moved so that 0.5 is where `division.sure` is.
    """
    division = division or Division()
    height, width = oyster.shape
    scale = min(1.0, LARGEST / max(height, width))
    if scale < 1.0:
        size = (max(1, round(width * scale)), max(1, round(height * scale)))
        small = [np.asarray(cv2.resize(one, size, interpolation=cv2.INTER_AREA), np.float32) for one in (oyster, depth)]
        found = find_instances(small[0], small[1], division)
        return Instances(_enlarged(found.labels, oyster > 0.5), found.scores)
    unit = max(height, width) / SIDE
    mask = oyster > 0.5
    hills = np.where(mask, cv2.GaussianBlur(depth, (0, 0), max(division.smooth * unit, 0.1)), 0)
    levels = np.round(255 * np.clip(hills, 0, 1)).astype(np.uint8)
    tops = outstanding(levels, max(1, round(255 * division.rise))) & (levels >= 255 * division.least) & mask
    count, markers = cv2.connectedComponents(tops.astype(np.uint8), connectivity=8)
    labels = np.asarray(markers, np.int32)
    for level in range(LEVELS - 1, -1, -1):
        labels = _flooded(mask & (levels >= level * 256 // LEVELS), labels)
    _, pieces = cv2.connectedComponents((mask & (labels == 0)).astype(np.uint8), connectivity=4)
    labels = np.where(pieces > 0, count - 1 + pieces, labels)
    return _scored(labels, oyster, depth, division, unit)


def means(instances: Instances, values: Floats | NDArray[np.bool_]) -> NDArray[np.float64]:
    """(N,) of values (H, W), over each instance."""
    sums = np.bincount(instances.labels.ravel(), weights=values.ravel(), minlength=len(instances.scores) + 1)
    return sums[1:] / np.maximum(instances.areas, 1)


def outstanding(levels: NDArray[np.uint8], rise: int) -> NDArray[np.bool_]:
    """(H, W) where the maxima of levels (H, W) are that stand out by `rise` (extended maxima; Soille 2003, 6.3.5)."""
    domes = _under(_lowered(levels, rise), levels)
    return np.asarray(domes > _under(_lowered(domes, 1), domes))


def _lowered(values: NDArray[np.uint8], by: int) -> NDArray[np.uint8]:
    """Not below 0."""
    return np.asarray(cv2.subtract(values, np.full_like(values, by)), dtype=np.uint8)


def _under(values: NDArray[np.uint8], ceiling: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """(H, W) values, spread as far as they get under a ceiling: reconstruction by dilation."""
    square = np.ones((3, 3), np.uint8)
    while True:
        spread = np.minimum(cv2.dilate(values, square), ceiling)
        if np.array_equal(spread, values):
            return values
        values = np.asarray(spread, dtype=np.uint8)


def _flooded(mask: NDArray[np.bool_], markers: Labels) -> Labels:
    """(H, W) markers, grown a pixel at a time over the mask: each pixel of it gets the marker whose way within the mask
    is shortest, the greater number where two are as short."""
    labels: Any = markers.astype(np.uint16 if markers.max(initial=0) < 1 << 16 else np.float32)
    room = mask.astype(np.uint8)
    cross = cv2.getStructuringElement(cv2.MORPH_CROSS, (3, 3))
    reached = cv2.countNonZero(labels)
    while True:
        free = cv2.bitwise_and(np.asarray(labels == 0, np.uint8), room)
        cv2.copyTo(cv2.dilate(labels, cross), free, labels)
        before, reached = reached, cv2.countNonZero(labels)
        if reached == before:
            return np.asarray(labels, dtype=np.int32)


def _scored(labels: Labels, oyster: Floats, depth: Floats, division: Division, unit: float) -> Instances:
    """Instances that are large enough, numbered anew, with their scores. unit: px of the picture per px of `SIDE`"""
    areas = np.bincount(labels.ravel())
    kept = np.nonzero(areas >= division.area * unit**2)[0]
    kept = kept[kept > 0]
    dense = np.zeros(len(areas), dtype=np.int32)
    dense[kept] = np.arange(1, len(kept) + 1)
    found = Instances(dense[labels], np.zeros(len(kept)))
    misfit = np.abs(depths(found.labels.astype(np.uint16)) / np.float32(255) - depth)
    sizes = np.minimum(np.sqrt(areas[kept]) / (division.large * unit), 1.0)
    scores = means(found, oyster) * (1.0 - means(found, misfit)) ** 2 * np.sqrt(sizes)
    return replace(found, scores=moved(scores, division.sure))


def moved(scores: NDArray[np.float64], sure: float) -> NDArray[np.float64]:
    """Scores 0 to 1 in the same order, of which 0.5 is where `sure` was: their odds divided by its own."""
    return np.asarray(scores * (1 - sure) / (scores * (1 - sure) + (1 - scores) * sure))


def _enlarged(labels: Labels, mask: NDArray[np.bool_]) -> Labels:
    """Labels (h, w) on a finer mask (H, W)."""
    height, width = mask.shape
    coarse = cv2.resize(labels.astype(np.float32), (width, height), interpolation=cv2.INTER_NEAREST)
    return _flooded(mask, np.where(mask, coarse, 0).astype(np.int32))
