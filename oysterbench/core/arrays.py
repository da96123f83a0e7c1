"""Arrays of other people's making, brought to what the arithmetic on them takes for granted."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from oysterbench.core.errors import LabelError


def truth_values(values: NDArray[Any], where: str) -> NDArray[np.bool_]:
    """The same shape of truth values, of bool or of the integers 0 and 1, each stored as a byte 0 or 1.

    In a file, or after a view, a byte of a bool array may be any number: numpy takes it for true, and arithmetic on
    the bytes takes it for what it is. Raises LabelError, in one line that begins with `where`, for other numbers.
    """
    if values.dtype == bool:
        return np.asarray(values.view(np.uint8) != 0)
    if values.dtype.kind in "iu" and values.min(initial=0) >= 0 and values.max(initial=0) <= 1:
        return np.asarray(values != 0)
    raise LabelError(
        f"{where}: expected a mask of bool, or of the integers 0 and 1, got {values.dtype}"
        + (f" from {values.min():g} to {values.max():g}" if values.size and values.dtype.kind in "iuf" else "")
    )
