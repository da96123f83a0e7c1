"""Panoptic quality (Kirillov et al. 2019) of the class oyster, and which estimates are asked about at all."""

from __future__ import annotations

from dataclasses import astuple, dataclass
from operator import add

import numpy as np
from numpy.typing import NDArray

from oysterbench.evaluate.detection.instances import ImageInstances, Instance, mask_tools, numpy_2

OVERLAP = 0.5
"""More than this, and a pair is a match; it is then the only one (Kirillov et al. 2019, section 4.1)."""


@dataclass(frozen=True)
class PanopticCounts:
    """Sums over images: matches, their overlaps added, estimates and truths without a match."""

    matched: int = 0
    overlap: float = 0.0
    extra: int = 0
    missed: int = 0

    def __add__(self, other: PanopticCounts) -> PanopticCounts:
        return PanopticCounts(*map(add, astuple(self), astuple(other)))

    @property
    def quality(self) -> tuple[float, float, float]:
        """Panoptic, segmentation and recognition quality; NaN without any truth or estimate (or match, for the 2nd)."""
        whole = self.matched + 0.5 * (self.extra + self.missed)
        return (
            self.overlap / whole if whole else np.nan,
            self.overlap / self.matched if self.matched else np.nan,
            self.matched / whole if whole else np.nan,
        )


def paint(image: ImageInstances, chosen: list[Instance]) -> NDArray[np.int32]:
    """(H, W) numbers from 1 of the chosen instances; where several lie on a pixel it is of the last.

    Each is painted within the box of its mask: its other pixels, by far the most, take most of the time.
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
    """Which estimates of an image are which truths, of N and M that are asked about.

    truths (N,), estimates (M,): the instances; overlap (N, M): where they match, else 0; missed (N,) and extra (M,)
    bool: without a match, and wrong for it
    """

    truths: tuple[Instance, ...]
    estimates: tuple[Instance, ...]
    overlap: NDArray[np.float64]
    missed: NDArray[np.bool_]
    extra: NDArray[np.bool_]

    @property
    def counts(self) -> PanopticCounts:
        """Summed up."""
        matches = self.overlap > 0
        total = float(self.overlap[matches].sum())
        return PanopticCounts(int(matches.sum()), total, int(self.extra.sum()), int(self.missed.sum()))


def pair(truth: ImageInstances, estimate: ImageInstances, threshold: float) -> Pairing:
    """Matches of an image. Segments may not overlap: a pixel is of the surest estimate, and of the smallest truth.

    Pixels of crowd regions are void: out of the union, and an unmatched estimate that lies on them by more than half
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
    hidden = of_estimate[1:] == 0  # behind surer ones: it says nothing of its own
    excused = (on_void[1:] > 0.5 * of_estimate[1:]) | hidden
    seen = of_truth[1:, 0] > 0
    matches = overlap > 0
    missed, extra = ~matches.any(axis=1) & seen, ~matches.any(axis=0) & ~excused
    return Pairing(tuple(true), tuple(detections), overlap, missed, extra)
