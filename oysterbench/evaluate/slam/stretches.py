"""Errors of an estimate in parts of a sequence by the method's own state, such as tracking or coasting."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from oysterbench.core.trajectory.poses import nearest_stamps
from oysterbench.evaluate.slam.pose_errors import rms
from oysterbench.evaluate.slam.scoring import SlamResult


def states_at(
    stamps_ns: NDArray[np.int64], states: NDArray[np.uint8], wanted_ns: NDArray[np.int64]
) -> NDArray[np.uint8]:
    """States (M,) at wanted stamps (M,): of states (N,) at increasing stamps (N,), N > 0, those nearest in time."""
    return np.asarray(states[nearest_stamps(stamps_ns, wanted_ns)])


def errors_by_state(
    result: SlamResult, states: NDArray[np.uint8], names: Sequence[str]
) -> dict[str, dict[str, float | None]]:
    """For each state that occurs, by name: its share of the matched stamps, position RMSE (m), and mean NEES.

    states: (N,) at the matched stamps, indices into `names`. NEES is None where the estimate has no covariances; for
    position and rotation each, 3 is expected if they are right. Position errors are after alignment of the whole path.
    """
    found = dict[str, dict[str, float | None]]()
    for value, name in enumerate(names):
        of = states == value
        if not of.any():
            continue
        found[name] = {"share": float(np.mean(of)), "ate_rmse_m": rms(result.error_m[of])}
        for part in ("position", "rotation"):
            values = result.nees[part].values if part in result.nees else np.empty(0)
            sampled = of[len(of) - len(values) :]
            mean = float(np.mean(values[sampled])) if sampled.any() else math.nan
            found[name][f"nees_{part}"] = mean if math.isfinite(mean) else None
    return found
