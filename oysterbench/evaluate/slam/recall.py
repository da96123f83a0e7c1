"""The score of a trajectory: the area under the recall curve of its position error, over all truth stamps."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from oysterbench.core.geometry import Array


@dataclass(frozen=True)
class Recall:
    """Recall curve: the share of all truth stamps whose position error is at most a given one.

    error_m: (K,) position errors in increasing order, m; at most `points` of them
    share:   (K,) share of all truth stamps with at most this error, 0 to 1; it ends at the coverage, not at 1
    scale_m: error that counts half in the area, m
    area:    area under `share` over error / (error + scale), an axis from 0 to 1 without a cut-off
    """

    error_m: Array
    share: Array
    scale_m: float
    area: float


def recall(error_m: Array, stamps: int, scale_m: float, points: int = 500) -> Recall:
    """Compute the recall curve from position errors (C,) m at the covered ones of `stamps` truth stamps.

    The share of stamps with error <= e, over u = e / (e + scale), is a step function that rises by 1 / stamps at
    each u_i. Its area from 0 to 1 is the mean over ALL stamps of 1 - u_i = 1 / (1 + e_i / scale), 0 where there is
    no estimate. Ten times the error costs less than a factor of ten, as 1 / (1 + 10 x) > 0.1 / (1 + x): an estimate
    that covers a tenth of the stamps always scores below one that covers all with ten times the error.
    """
    area = float(np.sum(1.0 / (1.0 + error_m / scale_m)) / stamps)
    ordered = np.sort(error_m)
    kept = np.unique(np.linspace(0, len(ordered) - 1, min(points, len(ordered))).round().astype(int))
    return Recall(ordered[kept], (kept + 1) / stamps, scale_m, area)
