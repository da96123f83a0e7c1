"""Classes of restoration of an oyster reef, by its live oysters per square metre."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from oysterbench.core.geometry import Array

THRESHOLD_PER_M2, TARGET_PER_M2 = 15.0, 50.0
"""Live oysters per square metre of a restored reef: minimum and target (Oyster Metrics Workgroup, 2011)."""

RESTORATION_CLASSES = ("below threshold", "threshold", "target")
"""Fewer than 15 live oysters per square metre, 15 to 50, and 50 or more."""


def restoration_class(per_m2: Array) -> NDArray[np.int64]:
    """Index in `RESTORATION_CLASSES`: 0 below the threshold, 1 from the threshold, 2 from the target; -1 for NaN."""
    classes = (per_m2 >= THRESHOLD_PER_M2).astype(np.int64) + (per_m2 >= TARGET_PER_M2)
    return np.where(np.isnan(per_m2), -1, classes)
