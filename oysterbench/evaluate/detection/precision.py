"""Average precision and recall from matches: COCO's 101-point curve, over any resample of clips."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from oysterbench.core.geometry import Array
from oysterbench.evaluate.detection.matching import OVERLAPS, Matches

RECALLS = np.linspace(0.0, 1.0, 101)
_TINY = np.spacing(1)


def join(parts: Sequence[Matches]) -> Matches:
    """Concatenate the matches of several clips, in their order."""
    return Matches(
        np.concatenate([part.scores for part in parts]),
        np.concatenate([part.right for part in parts], axis=1),
        np.concatenate([part.ignored for part in parts], axis=1),
        sum(part.truths for part in parts),
    )


class PrecisionCurve:
    """Curve of precision over recall from the matches of several clips."""

    def __init__(self, clips: Sequence[Matches]) -> None:
        whole = join(clips)
        order = np.argsort(-whole.scores, kind="mergesort")
        self.scores = whole.scores[order]
        self._right = whole.right[:, order].astype(float)
        self._wrong = (~whole.right & ~whole.ignored)[:, order].astype(float)
        self._clip = np.repeat(np.arange(len(clips)), [len(part.scores) for part in clips])[order]
        self._truths = np.array([part.truths for part in clips], dtype=float)

    def at(self, times: Array | None = None) -> tuple[Array, Array]:
        """Compute precision (T, 101) at `RECALLS` and the final recall (T,), counting each clip `times` (clips,) over,
        once by default; NaN if there is no truth to be found."""
        right, wrong, truths = self._right, self._wrong, self._truths
        if times is not None:
            weight = times[self._clip]
            right, wrong, truths = right * weight, wrong * weight, truths * times
        total = truths.sum()
        n = len(OVERLAPS)
        if total == 0:
            return np.full((n, len(RECALLS)), np.nan), np.full(n, np.nan)
        if right.shape[1] == 0:
            return np.zeros((n, len(RECALLS))), np.zeros(n)
        hits, misses = np.cumsum(right, axis=1), np.cumsum(wrong, axis=1)
        recall = hits / total
        precision = hits / (hits + misses + _TINY)
        precision = np.maximum.accumulate(precision[:, ::-1], axis=1)[:, ::-1]
        sampled = np.zeros((n, len(RECALLS)))
        for k in range(n):
            at = np.searchsorted(recall[k], RECALLS, side="left")
            reached = at < recall.shape[1]
            sampled[k, reached] = precision[k, at[reached]]
        return sampled, recall[:, -1]


def average_precision(precision: Array, overlap: float | None = None) -> float:
    """Mean of a curve (T, 101) over recalls, and over overlaps, or at one of them."""
    chosen = precision if overlap is None else precision[np.isclose(OVERLAPS, overlap)]
    return float(chosen.mean())
