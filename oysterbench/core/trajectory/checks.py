"""Checks that every pose must pass; errors name the place in the file."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from oysterbench.core.errors import TrajectoryError
from oysterbench.core.geometry import Array
from oysterbench.core.trajectory.duplicates import each_stamp_once
from oysterbench.core.trajectory.options import ReadOptions
from oysterbench.core.trajectory.poses import Trajectory
from oysterbench.core.trajectory.stamps import ns_to_seconds

MAX_POSITION_M = 1e9
"""Farther from the origin than this, an estimate has diverged; its square would soon overflow a float64."""
NORM_TOLERANCE = 2e-3
"""Tolerance of a quaternion's norm: writing three decimals puts it off by 1e-3 at most."""
NORM_STATED = 1e-6
"""Deviation of a norm above which its correction is reported: less is the rounding of six decimals."""


def checked_poses(
    trajectory: Trajectory, name: str, where: Callable[[int], str], options: ReadOptions | None = None
) -> Trajectory:
    """Check the poses of a file; return them in the order of their stamps, one per stamp, with unit quaternions.

    where: pose, counted from 0 -> its place in the file; options: their `sort` and `duplicates` apply; None for poses
    that do not come from a file and are not to be chosen among. Changes are recorded in the trajectory's notes: one of
    several poses at a stamp is taken (`each_stamp_once`), quaternions with a norm within NORM_TOLERANCE of one are
    normalised, and covariances are left out where one of them cannot be one: no score depends on them. Those that are
    marked as unknown, as ROS does it, are none. Raises TrajectoryError for anything else.
    """
    options = options or ReadOptions(duplicates="refuse")
    notes = list(trajectory.notes)
    values = np.column_stack([trajectory.positions, trajectory.quaternions])
    wrong = np.asarray(~np.isfinite(values).all(axis=1))
    if wrong.any():
        i = int(np.argmax(wrong))
        column = ("x", "y", "z", "qx", "qy", "qz", "qw")[int(np.argmin(np.isfinite(values[i])))]
        value = values[i][~np.isfinite(values[i])][0]
        raise TrajectoryError(f"{where(i)}: expected finite numbers, got {column} = {value}; leave out unknown poses")
    if trajectory.covariances is not None:
        trajectory = replace(trajectory, covariances=_known(trajectory.covariances, name, where, notes))
    quaternions = _unit(trajectory.quaternions, name, where, notes)
    trajectory = replace(trajectory, quaternions=quaternions)
    rows = np.arange(len(trajectory))
    if options.sort and (np.diff(trajectory.stamps_ns) < 0).any():
        rows = np.argsort(trajectory.stamps_ns, kind="stable")
        trajectory = trajectory.select(rows)
        notes.append(f"{name}: the poses were put in the order of their timestamps")

    def place(i: int) -> str:
        return where(int(rows[i]))

    _check_order(trajectory.stamps_ns, place)
    trajectory = each_stamp_once(trajectory, name, place, options.duplicates, notes)
    return replace(trajectory, notes=tuple(notes))


def _unit(quaternions: Array, name: str, where: Callable[[int], str], notes: list[str]) -> Array:
    # Large numbers are set aside first: the square of one that has diverged overflows a float64.
    largest = np.abs(quaternions).max(axis=1, initial=0.0)
    norms = np.where(largest > 1e3, np.inf, np.linalg.norm(np.where(largest[:, None] > 1e3, 0, quaternions), axis=1))
    deviation = np.abs(norms - 1.0)
    wrong = deviation > NORM_TOLERANCE
    if wrong.any():
        i = int(np.argmax(wrong))
        shown = f"{norms[i]:.4g}" if np.isfinite(norms[i]) else f"above {largest[i]:.4g}"
        raise TrajectoryError(
            f"{where(i)}: expected a unit quaternion, got norm {shown}{others(wrong)}; check the order of the columns "
            "or normalise them"
        )
    stated = deviation > NORM_STATED
    if not stated.any():
        return quaternions
    notes.append(
        f"{name}: {np.count_nonzero(stated)} of {len(norms)} quaternions were normalised; their norms were off by up "
        f"to {deviation.max():.2g}"
    )
    return quaternions / norms[:, None]


def _check_order(stamps: NDArray[np.int64], where: Callable[[int], str]) -> None:
    back = np.asarray(stamps[1:] < stamps[:-1])
    if back.any():
        i = int(np.argmax(back)) + 1
        raise TrajectoryError(
            f"{where(i)}: expected increasing timestamps, got {ns_to_seconds(stamps[i])} s after "
            f"{ns_to_seconds(stamps[i - 1])} s{others(back)}; sort the poses by time (--sort)"
        )


def _known(covariances: Array, name: str, where: Callable[[int], str], notes: list[str]) -> Array | None:
    """Return covariances (N, 6, 6), or None where they are unknown, all zero or one of them with -1 in its first cell,
    or where one is not finite, not symmetric, or has a negative variance, which is noted."""
    if not covariances.any() or (covariances[:, 0, 0] == -1).any():
        return None
    finite = np.asarray(np.isfinite(covariances).all(axis=(1, 2)))
    known = np.where(finite[:, None, None], covariances, 0.0)
    diagonal = np.einsum("nii->ni", covariances)
    scale = np.abs(known).max(axis=(1, 2), initial=0.0)
    uneven = np.abs(known - known.transpose(0, 2, 1)).max(axis=(1, 2), initial=0.0) > 1e-6 * scale
    wrong = np.asarray(~finite | (diagonal < 0).any(axis=1) | uneven)
    if not wrong.any():
        return covariances
    i = int(np.argmax(wrong))
    notes.append(
        f"{name}: the covariances are left out, as one at least is not finite, not symmetric, or has a negative "
        f"variance: {where(i)} has the diagonal {np.array2string(diagonal[i], precision=3)}{others(wrong)}"
    )
    return None


def others(wrong: NDArray[np.bool_]) -> str:
    """Number of wrong ones besides the first, for the end of a clause; empty where there are none."""
    count = int(np.count_nonzero(wrong)) - 1
    return f" and {count} more" if count else ""
