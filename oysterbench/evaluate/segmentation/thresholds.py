"""Probability maps over all thresholds: how many pixels of each kind have which probability."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from oysterbench.core.geometry import Array

STEPS = 256
"""Thresholds k / STEPS: those that an 8-bit map can tell apart."""


@dataclass(frozen=True)
class ThresholdCurve:
    """Precision, recall and IoU (STEPS,) of the class oyster with pixels from `thresholds` on called so; NaN where
    nothing is called oyster (precision) or there is none (recall)."""

    thresholds: Array
    precision: Array
    recall: Array
    iou: Array

    @property
    def best(self) -> tuple[float, float]:
        """The greatest IoU and its threshold, the highest of several."""
        k = STEPS - 1 - int(np.argmax(self.iou[::-1]))
        return float(self.iou[k]), float(self.thresholds[k])


def histogram(
    probability: NDArray[np.floating], true: NDArray[np.bool_], asked: NDArray[np.bool_] | None
) -> NDArray[np.int64]:
    """(2, STEPS): pixels by truth (0 no, 1 yes) and by floor(STEPS * probability), 1 counted with the last."""
    level = np.minimum(probability * np.float32(STEPS), np.float32(STEPS - 1)).astype(np.uint16)
    level += true.view(np.uint8) * np.uint16(STEPS)
    return np.bincount(level.ravel() if asked is None else level[asked], minlength=2 * STEPS).reshape(2, STEPS)


def curve(counts: NDArray[np.int64]) -> ThresholdCurve:
    """The curve of a histogram (2, STEPS)."""
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
