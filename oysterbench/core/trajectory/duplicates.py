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
FEW = 2
"""Number of poses that a program may well write at one time: what it predicted, and what it measured."""
FLOWING = 0.8
"""Step between poses at one stamp, as a share of that to the next stamp, from which they may be poses of a motion; and
the way from stamp to stamp, as a share of all steps between, from which pairs of poses are, and not there and back."""


def each_stamp_once(
    trajectory: Trajectory, name: str, where: Callable[[int], str], choice: Duplicates | None, notes: list[str]
) -> Trajectory:
    """Reduce a trajectory, whose stamps do not decrease, to one pose per stamp; what was done is added to `notes`.

    where: pose, counted from 0 -> its place in the file. Without a choice, the first of several poses is taken if they
    differ by less than poses at neighbouring stamps do, as happens with motion capture and keyframes. Raises
    TrajectoryError where they differ by more, where they differ at all if the choice is to refuse, and, without a
    choice among them, where the stamps were rounded, so that poses of several times have the same.
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
        odd = wrong.any() or (not same.all() and np.median(count) > FEW)
        if odd and (rounded := _rounded(trajectory, count)):
            raise TrajectoryError(
                f"{name}: expected a timestamp for each pose, got {len(first)} for {len(trajectory)} poses, which "
                f"{rounded}; print at least 9 decimals (C++: std::fixed << std::setprecision(9); Python: .9f); or, if "
                "these are several poses of one time, keep one of them (--duplicates first, last or mean)"
            )
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


def _rounded(trajectory: Trajectory, count: NDArray[np.intp]) -> str:
    """How the stamps look rounded, empty if they do not. count: (S,) poses at each stamp.

    They do if most hold several poses, are regular, and the motion goes on within a stamp as it does to the next.
    """
    if np.count_nonzero(count > 1) <= len(count) / 2:
        return ""
    if len(count) == 1:
        return "all have the same" if len(trajectory) > FEW else ""
    gaps = np.diff(np.unique(trajectory.stamps_ns))
    step_ns = gaps.min()
    if np.mod(gaps, step_ns).any() or np.median(gaps) != step_ns:
        return ""
    steps = _distance(trajectory.positions[:-1], trajectory.positions[1:])
    inside = np.diff(trajectory.stamps_ns) == 0
    within, between = float(np.median(steps[inside])), float(np.median(steps[~inside]))
    firsts = trajectory.positions[np.cumsum(count) - count]
    forward = float(np.median(_distance(firsts[:-1], firsts[1:]))) > FLOWING * (within + between)
    flows = within > FLOWING * between and (forward or np.median(count) > FEW)
    return f"look rounded to {step_ns * 1e-9:g} s" if flows else ""


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
