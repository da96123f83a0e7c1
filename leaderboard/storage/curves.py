"""Curves for a record's page: the path against ground truth, and its error over time, at a few hundred shared stamps.

Only for public splits: a drawn path would reveal the ground truth.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any

import msgspec
import numpy as np

from oysterbench.core.geometry import Array
from oysterbench.evaluate.slam.scoring import SlamResult

FORMAT = "oysterbench-curves/1"

MOST_POINTS = 300
"""Maximum number of points of a path."""

DECIMALS = 3
"""Decimals of positions in m and times in s: a millimetre is less than the width of a line."""

ERROR_DECIMALS = 5
"""Decimals of errors in m: those of the best paths are about a millimetre."""


Point = tuple[float, float, float]
"""x y z, m, in the world frame `map`."""


class Curve(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The path on a sequence, as `sequence_curve` makes it."""

    run: Annotated[int, msgspec.Meta(ge=0)]
    t_s: list[float]
    truth: list[Point]
    path: list[Point | None]
    error_m: list[float | None]


class Curves(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The document of a record's curves, as `curves_document` makes it."""

    format: str
    align: str
    sequences: dict[str, Curve]


def sequence_curve(result: SlamResult, run: int) -> dict[str, Any]:
    """A path on its sequence, thinned to stamps spread evenly over those of the ground truth, including first and last.

    run:     of the record, from 0
    t_s:     (N,) seconds from the first stamp of the ground truth, N <= MOST_POINTS
    truth:   (N, 3) true positions x y z, m, in the world frame `map`
    path:    (N, 3) estimated positions, as aligned by the evaluator; None at stamps without an estimate
    error_m: (N,) distance between the two; None at the same stamps
    """
    truth = result.whole_truth
    chosen = np.unique(np.linspace(0, len(truth) - 1, min(MOST_POINTS, len(truth))).round().astype(int))
    matched = np.full(len(truth), -1)
    matched[np.searchsorted(truth.stamps_ns, result.stamps_ns)] = np.arange(len(result.stamps_ns))
    places = matched[chosen].tolist()
    seconds = (truth.stamps_ns[chosen] - truth.stamps_ns[0]) * 1e-9
    return {
        "run": run,
        "t_s": np.round(seconds, DECIMALS).tolist(),
        "truth": _points(truth.positions[chosen]),
        "path": [None if k < 0 else _points(result.estimate.positions[k : k + 1])[0] for k in places],
        "error_m": [None if k < 0 else round(float(result.error_m[k]), ERROR_DECIMALS) for k in places],
    }


def curves_document(sequences: Mapping[str, Mapping[str, Any]], align: str) -> dict[str, Any]:
    """Document for `RecordStore.add_curves`. sequences: name -> `sequence_curve`; align: how paths were aligned."""
    return {"format": FORMAT, "align": align, "sequences": {name: dict(curve) for name, curve in sequences.items()}}


def _points(positions: Array) -> list[list[float]]:
    found: list[list[float]] = (np.round(positions, DECIMALS) + 0.0).tolist()
    return found  # + 0.0: no negative zeros
