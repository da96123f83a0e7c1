"""Instances of oysters from the mask and from the depth of each pixel inside an oyster: a watershed on the depth.

Soille 2003 (Morphological Image Analysis, ch. 6 and 9): a marker is a maximum of depth that rises by at least `rise`
above the saddle between it and any higher one; markers are grown downwards level by level, so that touching oysters are
separated along the valley between them.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from oysterbench_baselines.learning.samples import Floats, depths

SIDE = 320
"""Length of an image's longer side, px, to which the lengths and areas of a `Division` refer."""
LEVELS = 16
"""Number of depth levels by which markers are grown."""
LARGEST = 640
"""Length of an image's longer side, px: larger images are divided at this size, and the result is enlarged."""

Labels = NDArray[np.int32]


@dataclass(frozen=True)
class Division:
    """Parameters that separate oysters, with lengths for an image whose longer side is `SIDE` px. smooth: px, sigma of
    the smoothing of depth; rise, least: depth, 0 to 1, by which a marker must stand out, and that it must have; area:
    smallest area of an oyster, px; large: px, square root of the area above which size no longer lowers the score;
    sure: the score above which an oyster is counted, before it is mapped to 0.5."""

    smooth: float = 1.0
    rise: float = 0.1
    least: float = 0.3
    area: float = 12.0
    large: float = 15.0
    sure: float = 0.5

    def zoomed(self, zoom: float) -> Division:
        """Division for an image that was enlarged by `zoom` for the network, in which finer details are separated; or
        reduced, below 1, in which coarser ones are."""
        return replace(self, smooth=self.smooth / zoom, area=self.area / zoom**2)


@dataclass(frozen=True)
class Instances:
    """Instances of an image. labels: (H, W) int32, 0 for none; scores: (N,), 0 to 1, scores[k] for label k + 1."""

    labels: Labels
    scores: NDArray[np.float64]

    @property
    def areas(self) -> NDArray[np.int64]:
        """Area of each instance (N,), px."""
        return np.bincount(self.labels.ravel(), minlength=len(self.scores) + 1)[1:]


def find_instances(oyster: Floats, depth: Floats, division: Division | None = None) -> Instances:
    """Find instances from two maps (H, W) of probabilities. No two share a pixel, so no suppression is needed.

    Each pixel of the mask (above 0.5) goes to the marker whose hill it lies on. A piece of the mask without a marker is
    an instance with a low score. The score is the mean probability over the instance, times the square of the agreement
    of its depth with that of its outline (1 minus the mean difference), times the square root of its size over
    `division.large` where it is smaller; rescaled so that `division.sure` becomes 0.5.
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
    """Mean of values (H, W) over each instance (N,)."""
    sums = np.bincount(instances.labels.ravel(), weights=values.ravel(), minlength=len(instances.scores) + 1)
    return sums[1:] / np.maximum(instances.areas, 1)


def outstanding(levels: NDArray[np.uint8], rise: int) -> NDArray[np.bool_]:
    """Mask (H, W) of the maxima of levels (H, W) that stand out by `rise` (extended maxima; Soille 2003, 6.3.5)."""
    domes = _under(_lowered(levels, rise), levels)
    return np.asarray(domes > _under(_lowered(domes, 1), domes))


def _lowered(values: NDArray[np.uint8], by: int) -> NDArray[np.uint8]:
    """Subtract `by` from values, clipped at 0."""
    return np.asarray(cv2.subtract(values, np.full_like(values, by)), dtype=np.uint8)


def _under(values: NDArray[np.uint8], ceiling: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Spread values (H, W) as far as possible under a ceiling (H, W): morphological reconstruction by dilation."""
    square = np.ones((3, 3), np.uint8)
    while True:
        spread = np.minimum(cv2.dilate(values, square), ceiling)
        if np.array_equal(spread, values):
            return values
        values = np.asarray(spread, dtype=np.uint8)


def _flooded(mask: NDArray[np.bool_], markers: Labels) -> Labels:
    """Grow markers (H, W) pixel by pixel over the mask (H, W): each of its pixels gets the marker with the shortest
    path within the mask, or the greater number where two are equally near."""
    count = int(markers.max(initial=0))
    labels: Any = markers.astype(np.uint8 if count < 1 << 8 else np.uint16 if count < 1 << 16 else np.float32)
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
    """Renumber the instances that are large enough and compute their scores. unit: px of the image per px of `SIDE`."""
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
    """Map scores, 0 to 1, monotonically so that `sure` becomes 0.5: divide their odds by those of `sure`."""
    return np.asarray(scores * (1 - sure) / (scores * (1 - sure) + (1 - scores) * sure))


def _enlarged(labels: Labels, mask: NDArray[np.bool_]) -> Labels:
    """Enlarge labels (h, w) to fill a finer mask (H, W)."""
    height, width = mask.shape
    coarse = cv2.resize(labels.astype(np.float32), (width, height), interpolation=cv2.INTER_NEAREST)
    return _flooded(mask, np.where(mask, coarse, 0).astype(np.int32))
