"""Which labelled oysters count; all others are ignored, in evaluation and in exports."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from oysterbench.recipe import OYSTER

LEAST_VISIBILITY = 0.1
"""Minimum visible share of an oyster for it to count; with less, not even a person could tell what it is."""
LEAST_PIXELS = 16
"""Minimum number of pixels of an oyster for it to count: 4 x 4."""


def countable(
    classes: NDArray[np.uint8], instances: NDArray[np.uint16], visibility: NDArray[np.float32] | None
) -> tuple[NDArray[np.uint16], NDArray[np.bool_]]:
    """Split off the oysters that are too small or too hidden: return the other instances (H, W), and their mask
    (H, W)."""
    sizes = np.bincount(instances.ravel())
    bad = sizes < LEAST_PIXELS
    if visibility is not None:
        hidden = np.ones(len(sizes), dtype=bool)
        hidden[instances[visibility >= LEAST_VISIBILITY]] = False
        bad |= hidden
    bad[0] = False
    ignore = bad[instances] & (classes == OYSTER)
    return np.where(ignore, 0, instances).astype(np.uint16), ignore
