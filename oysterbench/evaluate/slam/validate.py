"""Checks of a trajectory before it is scored, and signs in a scored one that it was written wrongly."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import scipy
from numpy.typing import NDArray

from oysterbench.core.errors import TrajectoryError
from oysterbench.core.geometry import Array, Similarity, align_umeyama, align_yaw, rotation_angle, spread
from oysterbench.core.trajectory import Trajectory, ns_to_seconds
from oysterbench.core.trajectory.checks import MAX_POSITION_M, NORM_TOLERANCE

MIN_POSES = 2
MAX_STAMP_NS = 2**62
"""146 years from the epoch: differences of such stamps fit an int64."""

SUSPICIOUS_RAD = np.deg2rad(20.0)
"""Attitudes with a smaller error than this are not suspicious."""
SUSPICIOUS_GAIN = 4.0
"""Factor by which another interpretation of the poses must fit better before it is mentioned."""
UNITS = {"millimetres": 1e-3, "centimetres": 1e-2}
UNIT_TOLERANCE = 0.1
"""Relative deviation of a scale, by its own drift, from that of a unit."""
EXPLAINED = 0.1
"""Share of the truth's spread: a smaller error is a fit, a larger one a curve shrunk or rotated to do little harm."""


def check_trajectory(trajectory: Trajectory, name: str) -> Trajectory:
    """Check a trajectory and return it with normalised quaternions.

    Raises TrajectoryError, in one line that starts with `name`, for fewer than two poses, NaN or infinity, positions
    that have diverged, stamps that repeat or go back, quaternions that are not rotations. Poses are counted from 1.
    """
    n = len(trajectory)
    if n < MIN_POSES:
        raise TrajectoryError(f"{name}: expected at least {MIN_POSES} poses, got {n}")
    if not np.issubdtype(trajectory.stamps_ns.dtype, np.integer):
        raise TrajectoryError(f"{name}: expected timestamps in int64 nanoseconds, got {trajectory.stamps_ns.dtype}")
    _check_finite(trajectory, name)
    _check_order(trajectory.stamps_ns, name)
    norms = np.linalg.norm(trajectory.quaternions, axis=1)
    wrong = np.abs(norms - 1.0) > NORM_TOLERANCE
    if wrong.any():
        i = int(np.argmax(wrong))
        raise TrajectoryError(
            f"{name}: expected unit quaternions x y z w, got norm {norms[i]:.4g} at {_pose(trajectory, i)}"
            f"{_others(wrong)}; check the order of the columns or normalise them"
        )
    return replace(
        trajectory,
        stamps_ns=trajectory.stamps_ns.astype(np.int64, copy=False),
        # Row-major in memory, whatever the reader returned: poses are gathered by row.
        positions=np.ascontiguousarray(trajectory.positions),
        quaternions=np.ascontiguousarray(trajectory.quaternions / norms[:, None]),
    )


def _check_finite(trajectory: Trajectory, name: str) -> None:
    if not (np.isfinite(trajectory.positions).all() and np.isfinite(trajectory.quaternions).all()):
        values = np.column_stack([trajectory.positions, trajectory.quaternions])
        wrong = np.asarray(~np.isfinite(values).all(axis=1))
        i = int(np.argmax(wrong))
        column = ("x", "y", "z", "qx", "qy", "qz", "qw")[int(np.argmin(np.isfinite(values[i])))]
        raise TrajectoryError(
            f"{name}: expected finite numbers, got {column} = {values[i][~np.isfinite(values[i])][0]} at "
            f"{_pose(trajectory, i)}{_others(wrong)}; leave out unknown poses"
        )
    wrong = np.asarray((np.abs(trajectory.positions) > MAX_POSITION_M).any(axis=1))
    if wrong.any():
        i = int(np.argmax(wrong))
        farthest = np.abs(trajectory.positions[i]).max()
        raise TrajectoryError(
            f"{name}: expected positions within {MAX_POSITION_M:g} m, got {farthest:.3g} m "
            f"at {_pose(trajectory, i)}{_others(wrong)}; it has diverged"
        )


def _check_order(stamps_ns: NDArray[np.int64], name: str) -> None:
    if int(stamps_ns.min()) < -MAX_STAMP_NS or int(stamps_ns.max()) > MAX_STAMP_NS:
        raise TrajectoryError(
            f"{name}: expected timestamps within 146 years of the epoch, got {ns_to_seconds(stamps_ns.min())} to "
            f"{ns_to_seconds(stamps_ns.max())} s; write nanoseconds since 1970"
        )
    wrong = np.asarray(stamps_ns[1:] <= stamps_ns[:-1])
    if not wrong.any():
        return
    i = int(np.argmax(wrong)) + 1
    before, here = ns_to_seconds(stamps_ns[i - 1]), ns_to_seconds(stamps_ns[i])
    if stamps_ns[i] == stamps_ns[i - 1]:
        raise TrajectoryError(
            f"{name}: expected increasing timestamps, got {here} s twice, at poses {i} and {i + 1}{_others(wrong)}; "
            "keep one pose for each timestamp"
        )
    raise TrajectoryError(
        f"{name}: expected increasing timestamps, got {here} s after {before} s at pose {i + 1}{_others(wrong)}; "
        "sort the poses by time"
    )


def _pose(trajectory: Trajectory, i: int) -> str:
    return f"pose {i + 1} of {len(trajectory)} ({ns_to_seconds(trajectory.stamps_ns[i])} s)"


def _others(wrong: NDArray[np.bool_]) -> str:
    count = int(np.count_nonzero(wrong)) - 1
    return f" and {count} more" if count else ""


def attitude_notes(truth: Array, estimate: Array, alignment: Similarity, turned: bool = False) -> list[str]:
    """Note on attitudes that seem to be in another order or of another frame than `base_link`.

    truth (N, 4) and estimate (N, 4) are matched quaternions x y z w, the estimate's before alignment. turned: whether
    they were read as those of another frame and rotated to `base_link`. This never changes scores: it only points out
    the two most common mistakes in writing a trajectory.
    """
    aligned = alignment.rotate(estimate)
    error = _rms(rotation_angle(truth, aligned))
    if error < SUSPICIOUS_RAD:
        return []
    # Where the world frames of both agree, a wrong order of the one is explained by that of the other as well.
    fits = []
    for columns, order in (([1, 2, 3, 0], "w x y z"), ([3, 0, 1, 2], "x y z w, and not as w x y z")):
        for name, reordered in (
            ("estimate", rotation_angle(truth, alignment.rotate(estimate[:, columns]))),
            ("ground truth", rotation_angle(truth[:, columns], aligned)),
        ):
            if (left := _rms(reordered)) * SUSPICIOUS_GAIN < error:
                fits.append(f"by {np.rad2deg(left):.1f} deg when those of the {name} are read as {order}")
    if fits:
        return [
            f"the attitudes err by {np.rad2deg(error):.1f} deg as they are and {' or '.join(fits)}: were they written "
            "in that order? x y z w is expected, in EuRoC files w x y z"
        ]
    from_quat = scipy.spatial.transform.Rotation.from_quat
    turns = from_quat(truth).inv() * from_quat(aligned)
    turn = turns.mean()
    rest = _rms(np.asarray((turns * turn.inv()).magnitude()))
    # A rotation about the vertical alone is what a wrong alignment of a level vehicle looks like.
    tilt = np.arccos(np.clip(turn.as_matrix()[2, 2], -1.0, 1.0))
    if rest * SUSPICIOUS_GAIN < error and tilt > SUSPICIOUS_RAD:
        asked = (
            "they were read as poses of a camera or an IMU (--poses-of): are they those of another frame?"
            if turned
            else "are these poses of a camera or an IMU? Poses of base_link are expected"
        )
        return [
            "the attitudes differ from the ground truth by a constant rotation of "
            f"{np.rad2deg(turn.magnitude()):.1f} deg ({np.rad2deg(rest):.1f} deg remain): {asked}"
        ]
    return []


def alignment_notes(truth: Array, estimate: Array, align: str, rmse_m: float) -> list[str]:
    """Note that a more general alignment of the matched positions (N, 3), or mirroring, would remove nearly all of an
    error of `rmse_m`, if so.

    The estimate is then good, but in another world frame or scale than the chosen alignment allows, or left-handed.
    """
    fit_m = EXPLAINED * spread(truth)
    if rmse_m * SUSPICIOUS_GAIN < fit_m:
        return []
    fits: dict[str, Callable[[], Similarity]] = {
        "posyaw": lambda: align_yaw(truth, estimate),
        "se3": lambda: align_umeyama(truth, estimate),
        "sim3": lambda: align_umeyama(truth, estimate, with_scale=True),
    }
    names = list(fits)
    for name in names[names.index(align) + 1 :] if align in names else names:
        try:
            fit = fits[name]()
        except ValueError:
            continue
        left_m = _rms(np.linalg.norm(fit.apply(estimate) - truth, axis=1))
        if left_m < min(rmse_m / SUSPICIOUS_GAIN, fit_m):
            scale = f" and scale {fit.scale:.3g}" if name == "sim3" else ""
            why = _in_unit(fit.scale) or "is the estimate in another world frame (z up is expected) or without scale?"
            return [
                f"with alignment {name}{scale} instead of {align} the ATE would be {left_m:.3g} m, not {rmse_m:.3g} m: "
                f"{why}"
            ]
    try:
        fit = align_umeyama(truth, estimate * [1.0, 1.0, -1.0], with_scale=align == "sim3")
    except ValueError:
        return []
    left_m = _rms(np.linalg.norm(fit.apply(estimate * [1.0, 1.0, -1.0]) - truth, axis=1))
    if left_m < min(rmse_m / SUSPICIOUS_GAIN, fit_m):
        return [
            f"mirrored, the ATE would be {left_m:.3g} m, not {rmse_m:.3g} m: are its coordinates left-handed, with "
            "two axes swapped or one of the wrong sign?"
        ]
    return []


def _in_unit(scale: float) -> str:
    """Question after the unit, if the scale of an estimate is that of another one; else empty."""
    for unit, metres in UNITS.items():
        for name, ratio in (("estimate", scale / metres), ("ground truth", scale * metres)):
            if abs(ratio - 1.0) < UNIT_TOLERANCE:
                return f"is the {name} in {unit}? Metres are expected"
    return ""


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(np.square(values))))
