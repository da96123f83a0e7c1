"""Quantiles of many rows of resampled values at once."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from oysterbench.core.geometry import Array


def row_quantiles(values: Array, shares: Sequence[float]) -> Array:
    """Quantiles (R, len(shares)) of each row (R, n), interpolated as in `np.quantile`, but along contiguous memory."""
    places = [share * (values.shape[1] - 1) for share in shares]
    kept = [place for at in places for place in (math.floor(at), math.ceil(at))]
    ordered = np.partition(values, sorted(set(kept)), axis=1)
    ends = [(ordered[:, math.floor(at)], ordered[:, math.ceil(at)], at - math.floor(at)) for at in places]
    return np.stack([low + (high - low) * part for low, high, part in ends], axis=1)


def signs_off_zero(values: Array, tails: tuple[float, float]) -> Array:
    """Sign (R,) of the interval of each row of values (R, n), between two quantiles, tails; 0 where it contains 0.

    A quantile lies between two neighbouring sorted values: if both have the same sign, so does the quantile, and
    counting is enough. It is computed only where zero falls between these two.
    """
    neighbour = math.floor(tails[0] * (values.shape[1] - 1))
    below, above = np.count_nonzero(values <= 0, axis=1), np.count_nonzero(values >= 0, axis=1)
    signs = np.where(below <= neighbour, 1.0, np.where(above <= neighbour, -1.0, 0.0))
    for k in np.flatnonzero((np.minimum(below, above) == neighbour + 1) & (signs == 0)):
        low, high = np.quantile(values[k], tails)
        signs[k] = float(low > 0) - float(high < 0)
    return signs
