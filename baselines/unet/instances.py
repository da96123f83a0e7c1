"""Oysters one by one, from where oysters are and where their cores are."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from oysterbench_baselines.learning.samples import Floats

LEAST_AREA = 30
"""px, of an instance: what is smaller is noise at any size at which an oyster can be told from a pebble."""


@dataclass(frozen=True)
class Instances:
    """labels (H, W) int32, 0 for none, instance k + 1 of score scores[k]; scores (N,) 0 to 1."""

    labels: NDArray[np.int32]
    scores: NDArray[np.float64]


def find_instances(oyster: Floats, core: Floats, least_area: int = LEAST_AREA) -> Instances:
    """Instances from two (H, W) probabilities: watershed from markers.

    Markers are what hangs together of the cores; each pixel of the mask goes to the marker that is nearest within its
    piece. A piece without a marker is an instance. The score is the mean probability over the instance.
    """
    mask = oyster > 0.5
    count, pieces = cv2.connectedComponents(mask.astype(np.uint8), connectivity=4)
    seeds = mask & (core > 0.5)
    found, markers = cv2.connectedComponents(seeds.astype(np.uint8), connectivity=4)
    labels = _flooded(mask, np.asarray(markers, np.int32))
    # Pieces that no marker lies in come after the markers.
    marked = np.zeros(count, dtype=bool)
    marked[np.unique(pieces[seeds])] = True
    bare = mask & ~marked[pieces]
    labels = np.where(bare, found - 1 + pieces, labels)
    areas = np.bincount(labels.ravel())
    sums = np.bincount(labels.ravel(), weights=oyster.ravel())
    kept = np.nonzero(areas >= least_area)[0]
    kept = kept[kept > 0]
    dense = np.zeros(len(areas), dtype=np.int32)
    dense[kept] = np.arange(1, len(kept) + 1)
    return Instances(dense[labels], sums[kept] / areas[kept])


def _flooded(mask: NDArray[np.bool_], markers: NDArray[np.int32]) -> NDArray[np.int32]:
    """(H, W) markers, grown a pixel at a time over the mask: each pixel of it gets the marker whose way within the mask
    is shortest, the greater number where two are as short."""
    labels = np.where(mask, markers, 0).astype(np.float32)
    cross = cv2.getStructuringElement(cv2.MORPH_CROSS, (3, 3))
    while True:
        grown = np.where(mask & (labels == 0), cv2.dilate(labels, cross), labels)
        if np.array_equal(grown, labels):
            return labels.astype(np.int32)
        labels = grown
