"""What a path claims and the vehicle's own sensors contradict: its clock, its rotation, its speed.

No ground truth is needed. Each decision is made over the whole dive, so that surges, lost pings and short errors of the
path do not matter.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import accumulate
from operator import mul

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import cumulative_trapezoid
from scipy.spatial.transform import Rotation

from oysterbench.core.errors import SequenceError
from oysterbench.core.geometry import Array
from oysterbench.core.trajectory import Trajectory
from oysterbench.evaluate.slam.time_offset import MIN_STEP_S, fit_offset, shift
from oysterbench.evaluate.slam.time_offset_notes import MIN_SIGMAS
from oysterbench.sequence.types import Sequence, imu_arrays

MOST_LAG_S = 0.3
"""Error of the path's clock up to which nothing is said."""
MOST_SCALE = 1.2
"""Ratio of the speeds by path and DVL, or by DVL and path, up to which nothing is said."""
LEAST_TURN = float(np.radians(1.0))
"""RMS rate about the vertical axis, rad/s, up to which a vehicle does not turn: several times a bias."""
LEAST_SPEED = 0.05
"""Speed, m/s, up to which a vehicle does not move: several times the noise of a DVL."""
STILL = 0.02
"""Share of the measured motion up to which a path does not move."""
OPPOSITE = -0.5
"""Correlation of the rates about the vertical axis below which the path turns the other way."""
WINDOW_S = 1.0
"""Time over which speeds are averaged, or more where poses are rarer: long enough for the noise of positions, short
enough for a straight line."""
LEAST_WINDOWS = 5
"""Number of speeds, or rates, in a comparison."""


@dataclass(frozen=True)
class Motion:
    """Rates, or speeds, at the same times (K,), by the path and as measured."""

    path: Array
    measured: Array


def contradictions(sequence: Sequence, trajectory: Trajectory) -> list[str]:
    """Say in what a trajectory (poses of base_link) contradicts gyroscope and DVL, one sentence each; empty if in
    nothing, or if the vehicle moves too little to tell."""
    try:
        stamps, gyro, _ = imu_arrays(sequence.imu())
    except SequenceError:  # a file with some of the topics only
        return []
    if len(trajectory) < 2 or len(stamps) < 2 or sequence.imu_calibration is None:
        return []
    gyro = gyro @ sequence.imu_calibration.T_base_imu[:3, :3].T
    lag_s = clock_error_s(trajectory, stamps, gyro)
    path = shift(trajectory, lag_s)
    step_s = max(MIN_STEP_S, _median_step_s(path))
    turns, speeds = turns_of(path, stamps, gyro, step_s), speeds_of(path, sequence, stamps, gyro)
    moved = [each for each in (turns, speeds) if each is not None]
    in_place = speeds is not None or not np.ptp(path.positions, axis=0).any()
    if moved and in_place and all(_is_still(each) for each in moved):
        return ["the path does not move, but by its gyroscope or DVL the vehicle did"]
    found = []
    if abs(lag_s) > MOST_LAG_S:
        side = "late" if lag_s < 0 else "early"
        found.append(
            f"by the gyroscope, the path's timestamps are {abs(lag_s):.2f} s {side}: expected the clock of the sequence"
        )
    if turns is not None and _is_still(turns):
        found.append("the path does not turn, but by its gyroscope the vehicle did: expected quaternions of T_map_base")
    elif turns is not None and _cosine(turns) < OPPOSITE:
        found.append("by the gyroscope, the path turns the other way: expected quaternions of T_map_base, z up")
    if speeds is not None:
        scale = float(np.median(speeds.path / speeds.measured))
        if not 1.0 / MOST_SCALE <= scale <= MOST_SCALE:
            found.append(
                f"by the DVL, the path is {scale:.2g} times as long as it should be: expected metres; counts and "
                "areas along it are wrong"
            )
    return found


def clock_error_s(trajectory: Trajectory, stamps_ns: NDArray[np.int64], gyro: Array) -> float:
    """Time to add to a path's stamps so that its angular speed fits that of the gyroscope (N, 3); 0 if none is certain.

    Angular speed depends neither on the world's frame nor on the sense of rotation.
    """
    step_s = max(MIN_STEP_S, _median_step_s(trajectory))
    begin, first = int(stamps_ns[0]), int(trajectory.stamps_ns[0])
    measured = np.linalg.norm(_means(stamps_ns, gyro, _grid(begin, int(stamps_ns[-1]), step_s)), axis=1)
    claimed = np.linalg.norm(_path_rates(trajectory, _grid(first, int(trajectory.stamps_ns[-1]), step_s)), axis=1)
    try:
        offset = fit_offset(measured, claimed, step_s, "angular speed")
    except ValueError:
        return 0.0
    found = offset.offset_s + (begin - first) * 1e-9
    return 0.0 if abs(found) < MIN_SIGMAS * offset.sigma_s else found


def turns_of(path: Trajectory, stamps_ns: NDArray[np.int64], gyro: Array, step_s: float) -> Motion | None:
    """Rates about the vertical axis of the vehicle, rad/s; None if it hardly turns."""
    grid = _common_grid(path, stamps_ns, step_s)
    if len(grid) <= LEAST_WINDOWS:
        return None
    found = Motion(_path_rates(path, grid)[:, 2], _means(stamps_ns, gyro, grid)[:, 2])
    return found if _rms(found.measured) > LEAST_TURN else None


def speeds_of(path: Trajectory, sequence: Sequence, stamps_ns: NDArray[np.int64], gyro: Array) -> Motion | None:
    """Speeds of base_link, m/s, wherever the DVL measured a motion; None if hardly anywhere."""
    if sequence.dvl_calibration is None:
        return None
    try:
        pings = [ping for ping in sequence.dvl() if np.isfinite(ping.velocity).all()]
    except SequenceError:  # a file with some of the topics only
        return None
    pinged = np.array([ping.stamp_ns for ping in pings], dtype=np.int64)
    grid = _poses_apart(path, pinged) if len(pinged) > 1 else pinged
    if len(grid) <= LEAST_WINDOWS:
        return None
    T_base_dvl = sequence.dvl_calibration.T_base_sensor
    of_dvl = np.array([ping.velocity for ping in pings]) @ T_base_dvl[:3, :3].T
    rates = np.column_stack([np.interp(pinged - stamps_ns[0], stamps_ns - stamps_ns[0], axis) for axis in gyro.T])
    of_base = of_dvl - np.cross(rates, T_base_dvl[:3, 3])
    velocities = _attitudes(stamps_ns, gyro, pinged).apply(of_base)
    claimed = np.linalg.norm(np.diff(path.at(grid).positions, axis=0), axis=1) / _seconds(grid)
    measured = np.linalg.norm(_means(pinged, velocities, grid), axis=1)
    pings_hz = np.diff(np.searchsorted(pinged, grid)) / _seconds(grid)
    moving = (measured > LEAST_SPEED) & (pings_hz > 0.5 * np.median(pings_hz))  # and not without bottom lock
    return Motion(claimed[moving], measured[moving]) if np.count_nonzero(moving) >= LEAST_WINDOWS else None


def _grid(first_ns: int, last_ns: int, step_s: float) -> NDArray[np.int64]:
    return first_ns + np.round(np.arange(int((last_ns - first_ns) * 1e-9 / step_s) + 1) * step_s * 1e9).astype(np.int64)


def _common_grid(path: Trajectory, stamps_ns: NDArray[np.int64], step_s: float) -> NDArray[np.int64]:
    """Even stamps within both; empty if they do not overlap."""
    first = max(int(path.stamps_ns[0]), int(stamps_ns[0]))
    last = min(int(path.stamps_ns[-1]), int(stamps_ns[-1]))
    return _grid(first, max(first, last), step_s)


def _poses_apart(path: Trajectory, stamps_ns: NDArray[np.int64]) -> NDArray[np.int64]:
    """Stamps of poses within both, about `WINDOW_S` apart, or more where poses are: what is between is unknown."""
    grid = _common_grid(path, stamps_ns, WINDOW_S)
    found = path.stamps_ns[np.minimum(np.searchsorted(path.stamps_ns, grid), len(path) - 1)]
    return np.unique(found[(found >= stamps_ns[0]) & (found <= stamps_ns[-1])])


def _median_step_s(trajectory: Trajectory) -> float:
    return float(np.median(np.diff(trajectory.stamps_ns))) * 1e-9


def _path_rates(path: Trajectory, grid: NDArray[np.int64]) -> Array:
    """Mean angular rates (K, 3) of the body between stamps (K + 1,), rad/s in its frame."""
    turns = Rotation.from_quat(path.at(np.minimum(grid, path.stamps_ns[-1])).quaternions)
    return np.asarray((turns[:-1].inv() * turns[1:]).as_rotvec() / _seconds(grid)[:, None])


def _means(stamps_ns: NDArray[np.int64], rates: Array, grid: NDArray[np.int64]) -> Array:
    """Means (K, 3), between stamps (K + 1,), of rates (N, 3) measured at stamps (N,)."""
    seconds = (stamps_ns - stamps_ns[0]) * 1e-9
    whole = cumulative_trapezoid(rates, seconds, axis=0, initial=0)
    at = [np.interp((grid - stamps_ns[0]) * 1e-9, seconds, axis) for axis in whole.T]
    return np.asarray(np.diff(np.column_stack(at), axis=0) / _seconds(grid)[:, None])


def _attitudes(stamps_ns: NDArray[np.int64], gyro: Array, at_ns: NDArray[np.int64]) -> Rotation:
    """Attitudes at stamps (K,), relative to the first, by the gyroscope alone: they drift by little over `WINDOW_S`."""
    turns = Rotation.from_rotvec(_means(stamps_ns, gyro, at_ns) * _seconds(at_ns)[:, None])
    return Rotation.concatenate(list(accumulate(turns, mul, initial=Rotation.identity())))


def _seconds(grid: NDArray[np.int64]) -> Array:
    return np.asarray(np.diff(grid) * 1e-9)


def _is_still(motion: Motion) -> bool:
    """Whether the path does not move, although a motion was measured."""
    return _rms(motion.path) <= STILL * _rms(motion.measured)


def _cosine(motion: Motion) -> float:
    """Correlation without taking off the means: a steady turn counts."""
    product = _rms(motion.path) * _rms(motion.measured)
    return float(np.mean(motion.path * motion.measured)) / product if product > 0 else 0.0


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))
