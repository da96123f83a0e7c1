"""Log of a closed-loop rollout of a policy over a reef, from which it is scored."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class RolloutLog:
    """A rollout of K commands, step by step; the first of K + 1 time steps is before the first command.

    reef: the sequence's name; policy: the policy that steered. step_s: interval between time steps, s.
    states (K + 1, 5) float64: x, y, z m in `map`, heading rad (from east, counter-clockwise), pitch rad (bow down
    positive). altitude (K + 1,): above the bottom, m.
    commands (K, 2) int: classes of yaw and pitch. seen (K + 1,) int: number of live oysters seen for the first time.
    contact (K + 1,) bool: the hull would have touched something and was held above it. turned (K + 1,) bool: turned
    back at the fence. covered (K + 1,): share of the area within the fence whose bottom has been seen so far.
    half_m: the area extends from -half_m to half_m in x and y. oysters (N, 3): x, y, z m of the live oysters within it;
    found (N,) bool: seen in this rollout. wall_s, cpu_s: time taken by rendering, steering and motion.
    """

    reef: str
    policy: str
    step_s: float
    states: NDArray[np.float64]
    altitude: NDArray[np.float64]
    commands: NDArray[np.int64]
    seen: NDArray[np.int64]
    contact: NDArray[np.bool_]
    turned: NDArray[np.bool_]
    covered: NDArray[np.float64]
    half_m: float
    oysters: NDArray[np.float64]
    found: NDArray[np.bool_]
    wall_s: float
    cpu_s: float
