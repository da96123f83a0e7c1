"""Doppler velocity log: along beam b it sees b . (1 + s) Exp(-m) R_dvl_imu (R^T v + w x r).

Scale s and misalignment m of its axes are its calibration, (4,); r is its place in the IMU's frame, w the angular rate.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from oysterbench.core.geometry import Array
from oysterbench.core.measurements import DvlMeasurement
from oysterbench_baselines.common.aiding.sensor import AidingSensor, Calibration, GateSettings, python_factor, symbol
from oysterbench_baselines.common.filter import (
    CORE,
    GYRO_BIAS,
    VELOCITY,
    InvariantFilter,
    cross,
    left_jacobian,
    rotation_exp,
)
from oysterbench_baselines.common.inertial import Segment, integrate

if TYPE_CHECKING:
    import gtsam

    from oysterbench_baselines.gtsam_vi.states import State

DVL_KEY = symbol("d")
WEAK = 1e-6  # share of the strongest direction's information below which beams say nothing about a direction
BIAS_STEP = 1e-5  # rad/s, of the difference quotient


@dataclass(frozen=True)
class DvlSettings:
    """What the samples do not say of a DVL."""

    scale_sigma: float = 0.003  # of 1: a DVL of the A50 class is sold as good to 1 %, the better model to 0.1 %
    misalignment_sigma_deg: float = 0.5  # per axis: what a mount is made and measured to
    noise_floor: float = 0.001  # m/s, 1 sigma of a beam, whatever the sample says
    huber: float = 3.0  # sigmas; beyond, a residual in the graph counts linearly


class Dvl(AidingSensor):
    """T_imu_dvl (4, 4): its mount. velocity_ns: stamp of the last velocity that was believed."""

    kind = "dvl"
    measures = (DvlMeasurement,)
    suspect = VELOCITY
    unit = np.ones(4)

    def __init__(self, T_imu_dvl: Array, gravity: float, settings: DvlSettings, gate: GateSettings) -> None:
        super().__init__(gate)
        self.T_imu_dvl, self.gravity, self.settings = T_imu_dvl, gravity, settings
        self.velocity_ns: int | None = None
        twist = np.radians(settings.misalignment_sigma_deg)
        self._sigmas = np.array([settings.scale_sigma, twist, twist, twist])
        self._beam_variance = 0.0
        self._parts: list[tuple[Segment, DvlMeasurement | None]] = []  # since the last key frame
        self._intervals: dict[
            int, list[tuple[Segment, DvlMeasurement | None]]
        ] = {}  # by the key frame that they lead to

    def update(self, filter: InvariantFilter, sample: DvlMeasurement) -> bool:
        """By its beams. Linear in v, but not in v and the calibration together: the slopes by the calibration are taken
        at the velocity that the sample leads to. At the one before it, which at a start in motion is nothing, or after
        a long silence wrong, the sample would say nothing of the misalignment, the next one would, and from the two of
        them the filter would believe to know it.
        """
        beams = beam_rows(sample, self.settings.noise_floor)
        if beams is None:
            return False
        directions, along, variances = beams
        if len(directions) >= 3:
            self._beam_variance = float(variances.max())
        variances = np.maximum(variances, self._beam_variance)
        if self.rows is None:
            self.rows = filter.append(np.zeros(4), self._sigmas)
        at = self.rows
        calibration = filter.extra[at.start - CORE : at.stop - CORE]
        rotation, lever = self.T_imu_dvl[:3, :3], self.T_imu_dvl[:3, 3]
        turn = (1.0 + calibration[0]) * rotation_exp(-calibration[1:])
        by_velocity = turn @ rotation.T @ filter.rotation.T
        seen = by_velocity @ filter.velocity + turn @ rotation.T @ np.cross(filter.rate, lever)
        residual = along - directions @ seen
        rows = directions @ by_velocity
        gain = filter.covariance[VELOCITY, VELOCITY] @ rows.T
        change = gain @ np.linalg.solve(rows @ gain + np.diag(variances), residual)
        then = seen + by_velocity @ change
        slope = np.zeros((3, len(filter.covariance)))
        slope[:, VELOCITY] = by_velocity
        slope[:, GYRO_BIAS] = turn @ rotation.T @ cross(lever)
        slope[:, at.start] = then / (1.0 + calibration[0])
        slope[:, at.start + 1 : at.stop] = cross(then) @ left_jacobian(-calibration[1:])
        believed = self.correct(filter, residual, directions @ slope, variances)
        if believed:
            self.velocity_ns = sample.stamp_ns
            if self._parts:
                self._parts[-1] = (self._parts[-1][0], sample)
        return believed

    def propagate(self, segment: Segment) -> None:
        self._parts.append((segment, None))

    def add_keyframe(self, keyframe: int, stamp_ns: int, filter: InvariantFilter, interval_s: float) -> None:
        self._intervals[keyframe], self._parts = self._parts, []

    def forget_intervals(self) -> None:
        self._intervals.clear()

    def calibration(self) -> Calibration:
        return Calibration(DVL_KEY, np.zeros(4), self._sigmas)

    def factors(self, keyframe: int, before: State) -> list[gtsam.NonlinearFactor]:
        floor = self.settings.noise_floor
        velocity = sum_velocities(self._intervals[keyframe], before, self.gravity, self.T_imu_dvl, floor)
        return [] if velocity is None else [velocity_factor(velocity, keyframe - 1, self.gravity, self.settings.huber)]


def beam_rows(sample: DvlMeasurement, floor: float) -> tuple[Array, Array, Array] | None:
    """Directions (K, 3) in the DVL's frame, velocities (K,) m/s along them, and their variances (K,).

    The beams that are valid, each for itself: fewer than three, which give no velocity, still say something. The noise
    of a beam follows from the covariance of the velocity, sigma^2 (B^T B)^-1, or is the floor. None where there
    is neither.
    """
    valid = np.asarray(sample.beam_valid, dtype=bool) & np.isfinite(sample.beam_velocities)
    if valid.any():
        beams = sample.beam_directions[valid]
        variance = 0.0
        if valid.sum() >= 3 and np.isfinite(sample.covariance).all():
            variance = float(np.trace(sample.covariance) / np.trace(np.linalg.inv(beams.T @ beams)))
        return beams, sample.beam_velocities[valid], np.full(len(beams), max(variance, floor**2))
    if np.isfinite(sample.velocity).all() and np.isfinite(sample.covariance).all():
        # Turned to its principal axes, so that each row is independent.
        variances, axes = np.linalg.eigh(sample.covariance)
        return axes.T, axes.T @ sample.velocity, np.maximum(variances, floor**2)
    return None


@dataclass(frozen=True)
class Velocity:
    """What a DVL says about the velocity at the first of two key frames, over the interval between them.

    With u = R^T v there, g gravity, a and b the changes of accelerometer and gyro bias, c the DVL's calibration:
    axes (u + down R^T g + accel a + gyro b + calibration c - measured) is white with `sigmas`.

    axes (K, 3) unit rows, K <= 3; sigmas (K,) m/s; down (3, 3) s: the samples' mean time after the key frame, and how
    the turns in between mix the axes; accel, gyro (3, 3), calibration (3, 4); measured (3,); bias: of the IMU, about
    which it was linearised.
    """

    axes: Array
    sigmas: Array
    down: Array
    accel: Array
    gyro: Array
    calibration: Array
    measured: Array
    bias: gtsam.imuBias.ConstantBias


def sum_velocities(
    parts: list[tuple[Segment, DvlMeasurement | None]], state: State, gravity: float, T_imu_dvl: Array, floor: float
) -> Velocity | None:
    """All samples of an interval, propagated to its beginning by the inertial measurements, as one; None without any.

    parts: the interval's inertial measurements, cut at the samples; state: at its beginning, roughly.
    A beam d of the DVL at time t sees d . (1 + s) Exp(-m) R_dvl_imu (dR^T (u + t R^T g + dv) + w x r), with dR, dv the
    preintegrated rotation and velocity (Forster et al. 2017, eq. 33). The rows of all beams are linear in u: their
    least-squares solution for it is the measurement, and keeps how it depends on the rest.
    """
    segments = [segment for segment, _ in parts]
    heard = [(k + 1, beam_rows(sample, floor)) for k, (_, sample) in enumerate(parts) if sample is not None]
    usable = [(k, rows) for k, rows in heard if rows is not None and len(segments[k - 1].dt)]
    if not usable:
        return None
    to_dvl, lever = T_imu_dvl[:3, :3].T, T_imu_dvl[:3, 3]
    bias = state.bias
    down = state.nav.attitude().matrix().T @ np.array([0.0, 0.0, -gravity])
    start = state.nav.attitude().matrix().T @ state.nav.velocity()

    def slopes_at(gyro_bias: Array) -> tuple[Array, Array, Array, Array]:
        """Slopes (M, 3) of all beams by u, by time R^T g (M, 3) and accelerometer bias (M, 3), and constants (M,)."""
        integral = integrate(segments, gyro_bias)
        slopes, down_slopes, accel_slopes, constants = [], [], [], []
        for k, (directions, _, _) in usable:
            slope = directions @ to_dvl @ integral.rotation[k].T
            rate = segments[k - 1].gyro[-1] - gyro_bias
            gained = integral.velocity[k] - integral.velocity_rate[k] @ bias.accelerometer()
            slopes.append(slope)
            down_slopes.append(slope * integral.time[k])
            accel_slopes.append(-slope @ integral.velocity_rate[k])
            constants.append(slope @ gained + directions @ to_dvl @ np.cross(rate, lever))
        by_u, by_down, by_accel, constant = map(np.concatenate, (slopes, down_slopes, accel_slopes, constants))
        return by_u, by_down, by_accel, constant

    slope, down_slope, accel_slope, constant = slopes_at(bias.gyroscope())
    along = np.concatenate([rows[1] for _, rows in usable])
    weight = 1.0 / np.concatenate([rows[2] for _, rows in usable])
    if not np.isfinite(weight).all():
        return None
    seen = slope @ start + down_slope @ down + constant
    gyro_slope = np.empty((len(seen), 3))
    for axis in range(3):
        moved = slopes_at(bias.gyroscope() + BIAS_STEP * np.eye(3)[axis])
        gyro_slope[:, axis] = (moved[0] @ start + moved[1] @ down + moved[3] - seen) / BIAS_STEP
    # The velocity in the DVL's frame, by which its calibration multiplies.
    calibration_slope = []
    for k, (directions, _, _) in usable:
        integral = integrate(segments[:k], bias.gyroscope())
        gained = integral.velocity[-1] - integral.velocity_rate[-1] @ bias.accelerometer()
        rate = segments[k - 1].gyro[-1] - bias.gyroscope()
        moving = integral.rotation[-1].T @ (start + integral.time[-1] * down + gained) + np.cross(rate, lever)
        moving = to_dvl @ moving
        calibration_slope.append(directions @ np.column_stack([moving, cross(moving)]))
    information = slope.T @ (weight[:, None] * slope)
    values, vectors = np.linalg.eigh(information)
    known = values > WEAK * values[-1]
    axes = vectors[:, known].T
    solve = (vectors[:, known] / values[known]) @ axes @ slope.T * weight  # (3, M): the least-squares solution
    return Velocity(
        axes,
        1.0 / np.sqrt(values[known]),
        solve @ down_slope,
        solve @ accel_slope,
        solve @ gyro_slope,
        solve @ np.concatenate(calibration_slope),
        solve @ (along - constant),
        bias,
    )


def velocity_error(
    velocity: Velocity,
    gravity: float,
    pose: gtsam.Pose3,
    v: Array,
    bias: gtsam.imuBias.ConstantBias,
    calibration: Array,
) -> tuple[Array, list[Array]]:
    """Error (K,) of a `Velocity`; its derivatives by pose (K, 6), velocity (K, 3), bias (K, 6), calibration (K, 4)."""
    to_body = pose.rotation().matrix().T
    start, down = to_body @ v, to_body @ np.array([0.0, 0.0, -gravity])
    accel = bias.accelerometer() - velocity.bias.accelerometer()
    gyro = bias.gyroscope() - velocity.bias.gyroscope()
    error = start + velocity.down @ down + velocity.accel @ accel + velocity.gyro @ gyro
    error = error + velocity.calibration @ calibration - velocity.measured
    turn = cross(start) + velocity.down @ cross(down)
    slopes = [
        np.hstack([turn, np.zeros((3, 3))]),
        to_body,
        np.hstack([velocity.accel, velocity.gyro]),
        velocity.calibration,
    ]
    return velocity.axes @ error, [velocity.axes @ slope for slope in slopes]


def velocity_factor(velocity: Velocity, keyframe: int, gravity: float, huber: float) -> gtsam.NonlinearFactor:
    """On pose, velocity and bias of a key frame, and the DVL's calibration."""
    keys = [symbol("x", keyframe), symbol("v", keyframe), symbol("b", keyframe), DVL_KEY]
    evaluate: Callable[..., Any] = lambda *at: velocity_error(velocity, gravity, *at)  # noqa: E731
    return python_factor(keys, velocity.sigmas, len(velocity.sigmas), evaluate, huber=huber)
