"""Scores of probability maps over all thresholds, from a histogram of probability by true class."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from oysterbench.core.geometry import Array

STEPS = 256
"""Number of thresholds k / STEPS: those that an 8-bit map can tell apart."""


@dataclass(frozen=True)
class ThresholdCurve:
    """Precision, recall and IoU (STEPS,) of the class oyster, for pixels predicted as oyster from each of `thresholds`
    on; NaN where nothing is predicted (precision) or there is no oyster (recall)."""

    thresholds: Array
    precision: Array
    recall: Array
    iou: Array

    @property
    def best(self) -> tuple[float, float]:
        """The greatest IoU and its threshold; the highest threshold on ties."""
        k = STEPS - 1 - int(np.argmax(self.iou[::-1]))
        return float(self.iou[k]), float(self.thresholds[k])


def histogram(
    probability: NDArray[np.floating], true: NDArray[np.bool_], scored: NDArray[np.bool_] | None
) -> NDArray[np.int64]:
    """Number of pixels (2, STEPS) by truth (0 no, 1 yes) and floor(STEPS * probability); probability 1 falls into the
    last bin. scored (H, W): the pixels that are counted; None: all."""
    level = np.minimum(probability * np.float32(STEPS), np.float32(STEPS - 1)).astype(np.uint16)
    level += true.view(np.uint8) * np.uint16(STEPS)
    return np.bincount(level.ravel() if scored is None else level[scored], minlength=2 * STEPS).reshape(2, STEPS)


def curve(counts: NDArray[np.int64]) -> ThresholdCurve:
    """Compute the curve from a histogram (2, STEPS)."""
    called, hit = (np.cumsum(row[::-1])[::-1].astype(float) for row in (counts.sum(axis=0), counts[1]))
    true = float(counts[1].sum())
    union = called + true - hit
    with np.errstate(divide="ignore", invalid="ignore"):
        return ThresholdCurve(
            np.arange(STEPS) / STEPS,
            np.where(called > 0, hit / called, np.nan),
            hit / true if true else np.full(STEPS, np.nan),
            np.where(union > 0, hit / union, 1.0),
        )
