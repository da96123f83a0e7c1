"""Masks from outside, converted to what the arithmetic on them takes for granted."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from oysterbench.core.errors import LabelError


def as_mask(values: NDArray[Any], where: str) -> NDArray[np.bool_]:
    """Convert an array of bool, or of the integers 0 and 1, to bool of the same shape with every byte 0 or 1.

    The bytes of a bool array from a file or a view may hold any number: numpy treats every one but 0 as true, whereas
    arithmetic on the bytes uses the number itself. Raises LabelError, with a one-line message that starts with `where`,
    for other values.
    """
    if values.dtype == bool:
        return np.asarray(values.view(np.uint8) != 0)
    if values.dtype.kind in "iu" and values.min(initial=0) >= 0 and values.max(initial=0) <= 1:
        return np.asarray(values != 0)
    raise LabelError(
        f"{where}: expected a mask of bool, or of the integers 0 and 1, got {values.dtype}"
        + (f" from {values.min():g} to {values.max():g}" if values.size and values.dtype.kind in "iuf" else "")
    )
