"""Several poses at one stamp: which of them counts."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import scipy
from numpy.typing import NDArray

from oysterbench.core.errors import TrajectoryError
from oysterbench.core.geometry import Array, rotation_angle
from oysterbench.core.trajectory.options import Duplicates
from oysterbench.core.trajectory.poses import Trajectory
from oysterbench.core.trajectory.stamps import ns_to_seconds

USUAL_PERCENT = 99
"""Percentile of a file's steps up to which they are usual: the rest may be jumps of an estimate that relocalised."""


def each_stamp_once(
    trajectory: Trajectory, name: str, where: Callable[[int], str], choice: Duplicates | None, notes: list[str]
) -> Trajectory:
    """Reduce a trajectory, whose stamps do not decrease, to one pose per stamp; what was done is added to `notes`.

    where: pose, counted from 0 -> its place in the file. Without a choice, the first of several poses is taken if they
    differ by less than poses at neighbouring stamps do, as happens with motion capture and keyframes. Raises
    TrajectoryError where they differ by more, and where they differ at all if the choice is to refuse.
    """
    _, first, member, count = np.unique(
        trajectory.stamps_ns, return_index=True, return_inverse=True, return_counts=True
    )
    if len(first) == len(trajectory):
        return trajectory
    p, q = trajectory.positions, trajectory.quaternions
    own = first[member]
    off_m, off_rad = _distance(p[own], p), rotation_angle(q[own], q)
    same = (p == p[own]).all(axis=1) & ((q == q[own]).all(axis=1) | (q == -q[own]).all(axis=1))
    if choice is None or choice == "refuse":
        near = (off_m < _steps(p, first, _distance)[member]) & (off_rad < _steps(q, first, rotation_angle)[member])
        wrong = ~same & ~(near & (choice is None))
        if wrong.any():
            i = int(np.argmax(wrong))
            more = int(np.count_nonzero(wrong)) - 1
            raise TrajectoryError(
                f"{where(i)}: expected one pose for each timestamp, got another one at "
                f"{ns_to_seconds(trajectory.stamps_ns[i])} s than on {where(int(own[i])).rsplit('/', 1)[-1]}"
                f"{f' and {more} more' if more else ''}, {off_m[i]:.3g} m and {np.rad2deg(off_rad[i]):.3g} deg away; "
                "keep one of them (--duplicates first, last or mean; of the truth, --truth-duplicates)"
            )
    if same.all():
        notes.append(f"{name}: {len(same) - len(first)} poses were written twice and are taken once")
        return trajectory.select(first)
    taken = choice if choice in ("last", "mean") else "first"
    notes.append(
        f"{name}: at {np.count_nonzero(np.bincount(member, ~same))} of {len(first)} timestamps there are several "
        f"poses, up to {off_m.max():.3g} m and {np.rad2deg(off_rad.max()):.3g} deg apart: the "
        f"{taken} is taken (--duplicates)"
    )
    if taken == "mean":
        return _means(trajectory, first, count)
    return trajectory.select(first if taken == "first" else first + count - 1)


def _steps(values: Array, first: NDArray[np.intp], between: Callable[[Array, Array], Array]) -> Array:
    """Distances (S,) from the neighbour before each stamp to that after it; at least the file's usual step."""
    at = values[first]
    padded = np.concatenate([at[:1], at, at[-1:]])
    return np.maximum(between(padded[:-2], padded[2:]), _usual(between(at[:-1], at[1:])))


def _usual(steps: Array) -> float:
    return float(np.percentile(steps, USUAL_PERCENT)) if len(steps) else 0.0


def _distance(a: Array, b: Array) -> Array:
    with np.errstate(over="ignore"):  # of an estimate that has diverged
        return np.asarray(np.linalg.norm(b - a, axis=1))


def _means(trajectory: Trajectory, first: NDArray[np.intp], count: NDArray[np.intp]) -> Trajectory:
    """Average the poses at each stamp. Covariances are averaged too, but not reduced, as the errors are alike."""
    mean = trajectory.select(first)
    covariances = None if mean.covariances is None else mean.covariances.copy()
    positions, quaternions = mean.positions.copy(), mean.quaternions.copy()
    for k in np.flatnonzero(count > 1):
        part = trajectory.select(slice(first[k], first[k] + count[k]))
        positions[k] = part.positions.mean(axis=0)
        quaternions[k] = scipy.spatial.transform.Rotation.from_quat(part.quaternions).mean().as_quat()
        if covariances is not None and part.covariances is not None:
            covariances[k] = part.covariances.mean(axis=0)
    return replace(mean, positions=positions, quaternions=quaternions, covariances=covariances)
