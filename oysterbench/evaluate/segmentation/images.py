"""Input of the evaluator for one image: its ground truth, and what a method estimates."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from oysterbench.core.errors import LabelError
from oysterbench.core.masks import as_mask
from oysterbench.recipe import CLASSES, OYSTER


@dataclass(frozen=True)
class TruthImage:
    """Ground truth of one image.

    name:       unique in its clip
    classes:    (H, W) uint8, numbers of `recipe.CLASSES`; if only oysters are masked, only their number matters
    named:      whether classes other than oyster are told apart
    ignore:     (H, W) bool, pixels that are not scored; None if there are none
    depth_m:    (H, W) float32, m along the optical axis, 0 = none; None if unknown
    instances:  (H, W) uint16, number of the oyster (or other object) at each pixel, 0 = none; None if unknown
    heights_mm: shell height of each instance by its number (N,), NaN where it has none; None if unknown
    footprint_m2: area of seabed in the image, seen from above; None if unknown
    live:       1 for live oysters, 0 for dead ones, by number; None if unknown
    """

    name: str
    classes: NDArray[np.uint8]
    named: bool = True
    ignore: NDArray[np.bool_] | None = None
    depth_m: NDArray[np.float32] | None = None
    instances: NDArray[np.uint16] | None = None
    heights_mm: NDArray[np.float64] | None = None
    footprint_m2: float | None = None
    live: Mapping[int, float] | None = None

    @property
    def oyster(self) -> NDArray[np.bool_]:
        """Mask (H, W) of the oysters."""
        return np.asarray(self.classes == OYSTER)


@dataclass(frozen=True)
class EstimateImage:
    """Estimate for one image, exactly one of: oyster (H, W) bool; probability of an oyster (H, W) float; or classes
    (H, W) uint8, numbers of `recipe.CLASSES`.

    Arrays from untrusted sources enter here: they are checked, and converted to these types
    (`core.masks.as_mask`). Raises LabelError naming the image.
    """

    name: str
    oyster: NDArray[np.bool_] | None = None
    probability: NDArray[np.floating[Any]] | None = None
    classes: NDArray[np.uint8] | None = None

    def __post_init__(self) -> None:
        given = self._given
        if len(given) != 1:
            raise LabelError(f"{self.name}: expected one of oyster, probability and classes, got {len(given)}")
        if given[0].ndim != 2:
            raise LabelError(f"{self.name}: expected an array (H, W), got one of shape {given[0].shape}")
        if self.oyster is not None:
            object.__setattr__(self, "oyster", as_mask(self.oyster, self.name))
        if self.probability is not None:
            self._check_probability(self.probability)
        if self.classes is not None:
            object.__setattr__(self, "classes", self._checked_classes(self.classes))

    def _check_probability(self, values: NDArray[np.floating[Any]]) -> None:
        if not np.issubdtype(values.dtype, np.floating):
            raise LabelError(f"{self.name}: expected probabilities as floating point numbers, got {values.dtype}")
        low, high = (float(values.min()), float(values.max())) if values.size else (0.0, 0.0)
        if not (low >= 0.0 and high <= 1.0):  # NaN fails as well
            advice = "check the network's weights" if low != low else "apply a sigmoid to logits first"
            raise LabelError(f"{self.name}: expected probabilities from 0 to 1, got {low:g} to {high:g}; {advice}")

    def _checked_classes(self, values: NDArray[Any]) -> NDArray[np.uint8]:
        if values.dtype.kind not in "iu":
            raise LabelError(f"{self.name}: expected class numbers as integers, got {values.dtype}")
        unknown = sorted(set(np.unique(values).tolist()) - set(CLASSES))
        if unknown:
            known = ", ".join(f"{number} {name}" for number, name in CLASSES.items())
            raise LabelError(f"{self.name}: unknown class {unknown[0]}; known classes: {known}")
        return values.astype(np.uint8)

    @property
    def kind(self) -> str:
        """Kind of the estimate: "probabilities", "masks" or "classes"."""
        return "probabilities" if self.probability is not None else "masks" if self.oyster is not None else "classes"

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape (H, W) of the estimate."""
        return self._given[0].shape

    @property
    def _given(self) -> list[NDArray[Any]]:
        return [array for array in (self.oyster, self.probability, self.classes) if array is not None]

    def mask(self, threshold: float) -> NDArray[np.bool_]:
        """Mask (H, W) of the estimated oysters; the threshold applies to probabilities."""
        if self.oyster is not None:
            return self.oyster
        if self.probability is not None:
            return self.probability >= threshold
        assert self.classes is not None
        return np.asarray(self.classes == OYSTER)


def check_pair(truth: TruthImage, estimate: EstimateImage) -> None:
    """Refuse an estimate of another image, or of another size."""
    if truth.name != estimate.name:
        raise LabelError(f"expected the estimate of image {truth.name}, got that of {estimate.name}")
    check_size(estimate, truth.classes.shape, truth.name)


def check_size(estimate: EstimateImage, shape: tuple[int, ...], where: str) -> None:
    """Refuse an estimate whose size differs from that of the truth (H, W). Raises LabelError that starts with `where`,
    such as the file's path, and says how to resize what was given."""
    if estimate.shape != shape:
        (h, w), (eh, ew) = shape, estimate.shape
        advice = "is it turned or transposed?" if (eh, ew) == (w, h) else _resizing(estimate)
        raise LabelError(f"{where}: expected an estimate of the truth's size, {w} x {h}, got {ew} x {eh}; {advice}")


def _resizing(estimate: EstimateImage) -> str:
    values = estimate.probability
    if values is not None and ((values > 0) & (values < 1)).any():
        return "resize probabilities to it (bilinear) before thresholding"
    what = "classes" if estimate.classes is not None else "masks"
    return f"resize {what} to it by nearest neighbour, which makes no values in between, or predict at that size"
