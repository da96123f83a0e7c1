"""Pairs of poses between which relative errors are taken.

Each choice is made along one axis on which poses only move forward: index, stamp, true path or true angle turned. The
axis is the truth's, so that all estimates are evaluated on the same pairs.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from oysterbench.core.errors import TrajectoryError
from oysterbench.core.geometry import Array, rotation_angle

Index = NDArray[np.intp]
NO_PAIRS: Index = np.empty((0, 2), dtype=np.intp)

TIME_TOLERANCE = 0.05
"""Relative tolerance of a pair's time difference, where no stamp falls on start + time."""
TOLERANCE = 0.1
"""The same for a path or an angle; evo's value."""
MAX_DIRECT = 20_000
"""Maximum number of poses of which all pairs are tried for the angle between them: pairs grow with its square."""


def pairs_over_frames(n: int, delta: int, consecutive: bool = False) -> Index:
    """Index pairs (M, 2) that are `delta` poses apart."""
    starts = np.arange(0, max(n - delta, 0), delta if consecutive else 1)
    return _paired(starts, starts + delta)


def pairs_over_time(stamps_ns: NDArray[np.int64], delta_s: float, consecutive: bool = False) -> Index:
    """Index pairs (M, 2) of stamps (N,) that are delta_s apart, from every start that has such an end.

    The end is the stamp nearest to start + delta_s, if within TIME_TOLERANCE of delta_s and within half the median
    step, so that the last starts have no end rather than one that is too early. Consecutive: the first of those pairs,
    then always the next one that starts where the last one ended or later.
    """
    n = len(stamps_ns)
    if n < 2:
        return NO_PAIRS
    delta_ns = round(delta_s * 1e9)
    ends_ns = stamps_ns + delta_ns
    after = np.clip(np.searchsorted(stamps_ns, ends_ns), 1, n - 1)
    ends = after - (ends_ns - stamps_ns[after - 1] <= stamps_ns[after] - ends_ns)
    starts = np.arange(n)
    allowed_ns = min(TIME_TOLERANCE * delta_ns, 0.5 * float(np.median(np.diff(stamps_ns))))
    fits = (np.abs(stamps_ns[ends] - ends_ns) <= allowed_ns) & (ends > starts)
    pairs = _paired(starts[fits], ends[fits])
    return _chain(pairs) if consecutive else pairs


def pairs_along(axis: Array, delta: float, consecutive: bool = False) -> Index:
    """Index pairs (M, 2) of poses that are `delta` apart on a non-decreasing axis (N,), in m or rad.

    All: from every start to the pose nearest to start + delta, if within TOLERANCE * delta. Consecutive: from the
    first pose to the first one that is delta or more ahead, and on from there (evo's two modes for metres).
    """
    n = len(axis)
    if n < 2:
        return NO_PAIRS
    starts = np.arange(n)
    if consecutive:
        return _follow(np.maximum(np.searchsorted(axis, axis + delta, side="left"), starts + 1))
    last = starts[:-1]
    wanted = axis[:-1] + delta
    high = np.clip(np.searchsorted(axis, wanted, side="left"), last + 1, n - 1)
    low = np.maximum(high - 1, last + 1)
    low = np.where(wanted - axis[low] <= axis[high] - wanted, low, high)
    # Of several poses at the same place, take the first.
    ends = np.maximum(np.searchsorted(axis, axis[low], side="left"), last + 1)
    fits = np.abs(axis[ends] - axis[:-1] - delta) <= TOLERANCE * delta
    return _paired(last[fits], ends[fits])


def pairs_apart(quaternions: Array, delta_rad: float) -> Index:
    """All index pairs (M, 2) of attitudes (N, 4) between which the angle is delta_rad, within TOLERANCE of it.

    It does not matter how the body rotated in between: evo's all pairs over an angle. Raises TrajectoryError for more
    than MAX_DIRECT poses.
    """
    n = len(quaternions)
    if n > MAX_DIRECT:
        raise TrajectoryError(
            f"the angles between all pairs of {n} poses are {n**2:.1e} numbers; expected at most {MAX_DIRECT} poses "
            "for rpe_angle 'direct'; choose 'turned'"
        )
    found = []
    for i in range(n - 1):
        angles = rotation_angle(np.broadcast_to(quaternions[i], (n - i - 1, 4)), quaternions[i + 1 :])
        ends = i + 1 + np.flatnonzero(np.abs(angles - delta_rad) <= TOLERANCE * delta_rad)
        found.append(_paired(np.full(len(ends), i), ends))
    return np.concatenate(found) if found else NO_PAIRS


def segments(distances_m: Array, length_m: float, step: int = 1, nearest: float | None = None) -> Index:
    """Index pairs (M, 2): from every step-th truth stamp to the end of a segment of length_m.

    distances_m (T,) are along the whole true path. The end is the first stamp that is more than length_m ahead (KITTI
    devkit, `lastFrameFromSegmentLength`). With `nearest`, it is the stamp nearest to length_m ahead, if within that
    many metres (rpg_trajectory_evaluation). Starts without an end are left out.
    """
    n = len(distances_m)
    starts = np.arange(0, n, step)
    wanted = distances_m[starts] + length_m
    ends = np.searchsorted(distances_m, wanted, side="right" if nearest is None else "left")
    if nearest is None:
        fits = ends < n
    else:
        high = np.clip(ends, 1, n - 1)
        ends = high - (wanted - distances_m[high - 1] <= distances_m[high] - wanted)
        fits = (np.abs(distances_m[ends] - wanted) < nearest) & (ends > starts)
    return _paired(starts[fits], ends[fits])


def _paired(starts: NDArray[np.intp], ends: NDArray[np.intp]) -> Index:
    """Pairs (M, 2) with each column contiguous in memory, as columns are used one at a time."""
    return np.stack([starts, ends]).T


def distances(positions: Array) -> Array:
    """Distance (N,) in m along the path of positions (N, 3)."""
    steps = np.diff(positions, axis=0)
    return np.concatenate([[0.0], np.cumsum(np.sqrt(np.einsum("ij,ij->i", steps, steps)))])


def turned(quaternions: Array) -> Array:
    """Accumulated rotation angle (N,) in rad of attitudes (N, 4), from step to step."""
    return np.concatenate([[0.0], np.cumsum(rotation_angle(quaternions[:-1], quaternions[1:]))])


def run_of(index: NDArray[np.intp]) -> NDArray[np.intp] | slice:
    """Return indices (M,), at least one, as a slice if they are consecutive: slicing needs no copy."""
    first, last = int(index[0]), int(index[-1])
    if last - first == len(index) - 1 and bool((index[1:] - index[:-1] == 1).all()):
        return slice(first, last + 1)
    return index


def pick(values: Array, index: NDArray[np.intp] | slice, axis: int = 0) -> Array:
    """values[index] along axis 0 or 1; for an index array, `take` is several times as fast."""
    if isinstance(index, slice):
        return values[index] if axis == 0 else values[:, index]
    return np.take(values, index, axis=axis)


def between(points: Array, i: NDArray[np.intp] | slice, j: NDArray[np.intp] | slice) -> Array:
    """Vectors (M, 3) from points i to points j of (N, 3)."""
    return pick(points, j) - pick(points, i)


def _follow(following: Index) -> Index:
    """Pairs (M, 2) of the chain that starts at index 0, given the successor of each index (N: none)."""
    onward = following.tolist()
    chain, here = [0], onward[0]
    while here < len(onward):
        chain.append(here)
        here = onward[here]
    ids = np.array(chain, dtype=np.intp)
    return _paired(ids[:-1], ids[1:])


def _chain(pairs: Index) -> Index:
    """Select non-overlapping pairs, greedily, from pairs (M, 2) in order of their starts."""
    if not len(pairs):
        return pairs
    following = np.searchsorted(pairs[:, 0], pairs[:, 1], side="left").tolist()
    taken, here = [], 0
    while here < len(pairs):
        taken.append(here)
        here = following[here]
    return pairs[np.array(taken, dtype=np.intp)]
