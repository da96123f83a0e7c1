"""Panoptic quality (Kirillov et al. 2019) of the class oyster, and which estimates are scored at all."""

from __future__ import annotations

from dataclasses import astuple, dataclass
from operator import add

import numpy as np
from numpy.typing import NDArray

from oysterbench.evaluate.detection.instances import ImageInstances, Instance, mask_tools, numpy_2

OVERLAP = 0.5
"""IoU above which a pair is a match, which is then unique (Kirillov et al. 2019, section 4.1)."""


@dataclass(frozen=True)
class PanopticCounts:
    """Sums over images: number of matches, sum of their overlaps, number of unmatched estimates and truths."""

    matched: int = 0
    overlap: float = 0.0
    extra: int = 0
    missed: int = 0

    def __add__(self, other: PanopticCounts) -> PanopticCounts:
        return PanopticCounts(*map(add, astuple(self), astuple(other)))

    def __mul__(self, times: int) -> PanopticCounts:
        return PanopticCounts(*(times * value for value in astuple(self)))

    @property
    def quality(self) -> tuple[float, float, float]:
        """Panoptic, segmentation and recognition quality; NaN without any truth or estimate (the 2nd: any match)."""
        whole = self.matched + 0.5 * (self.extra + self.missed)
        return (
            self.overlap / whole if whole else np.nan,
            self.overlap / self.matched if self.matched else np.nan,
            self.matched / whole if whole else np.nan,
        )


def paint(image: ImageInstances, chosen: list[Instance]) -> NDArray[np.int32]:
    """Paint the chosen instances into a plane (H, W) by their number from 1; where they overlap, the last one wins.

    Each is painted only within the bounding box of its mask: the pixels outside would take most of the time.
    """
    tools = mask_tools()
    plane = np.zeros((image.height, image.width), dtype=np.int32)
    with numpy_2():
        for number, instance in enumerate(chosen, start=1):
            left, top, width, height = (int(value) for value in tools.toBbox(instance.mask))
            box = (slice(top, top + height), slice(left, left + width))
            plane[box][tools.decode(instance.mask)[box].view(bool)] = number
    return plane


@dataclass(frozen=True)
class Pairing:
    """Pairing of the N truths and M estimates of an image that are scored.

    truths (N,), estimates (M,): the instances; overlap (N, M): IoU of matches, else 0; missed (N,) and extra (M,) bool:
    unmatched, and an error for it
    """

    truths: tuple[Instance, ...]
    estimates: tuple[Instance, ...]
    overlap: NDArray[np.float64]
    missed: NDArray[np.bool_]
    extra: NDArray[np.bool_]

    @property
    def counts(self) -> PanopticCounts:
        """Counts of the image."""
        matches = self.overlap > 0
        total = float(self.overlap[matches].sum())
        return PanopticCounts(int(matches.sum()), total, int(self.extra.sum()), int(self.missed.sum()))


def pair(truth: ImageInstances, estimate: ImageInstances, threshold: float) -> Pairing:
    """Match the estimates of an image that score at least `threshold` to its truths.

    Segments must not overlap: a pixel belongs to the most confident estimate, and to the smallest truth. Pixels of
    crowd regions are void: excluded from the union, and an unmatched estimate with more than half of its pixels there
    is no error (section 4.2).
    """
    true = sorted((one for one in truth.instances if not one.crowd), key=lambda one: -one.area)
    detections = sorted((one for one in estimate.instances if one.score >= threshold), key=lambda one: one.score)
    truths, estimates = paint(truth, true), paint(estimate, detections)
    void = paint(truth, [one for one in truth.instances if one.crowd]) > 0
    void &= truths == 0
    n = len(detections) + 1
    pairs = np.bincount((truths * n + estimates).ravel(), minlength=(len(true) + 1) * n).reshape(-1, n)
    on_void = np.bincount(estimates[void], minlength=n)
    of_truth, of_estimate = pairs.sum(axis=1)[:, None], pairs.sum(axis=0)
    union = of_truth + of_estimate - pairs - on_void
    overlap = np.where(union > 0, pairs / np.maximum(union, 1), 0.0)[1:, 1:]
    overlap[overlap <= OVERLAP] = 0.0
    hidden = of_estimate[1:] == 0  # entirely behind more confident ones
    excused = (on_void[1:] > 0.5 * of_estimate[1:]) | hidden
    seen = of_truth[1:, 0] > 0
    matches = overlap > 0
    missed, extra = ~matches.any(axis=1) & seen, ~matches.any(axis=0) & ~excused
    return Pairing(tuple(true), tuple(detections), overlap, missed, extra)
