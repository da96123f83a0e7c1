"""Factors of DVL, pressure sensor and magnetometer, at the rate of key frames.

A factor written in Python costs a hundred times a native one: so all that a DVL says between two key frames goes into
one factor of at most three rows, and of depth and field there is one factor a key frame.
"""

from __future__ import annotations

from dataclasses import dataclass

import gtsam
import numpy as np
from gtsam.symbol_shorthand import B, V, X

from oysterbench.core.geometry import Array
from oysterbench.core.measurements import DvlMeasurement
from oysterbench_baselines.common.aiding import dvl_rows
from oysterbench_baselines.common.filter import cross
from oysterbench_baselines.common.inertial import Segment
from oysterbench_baselines.gtsam_vi.inertial import integrate
from oysterbench_baselines.gtsam_vi.states import State

DVL_KEY = gtsam.symbol("d", 0)
"""Error of scale, and misalignment (rad) about x, y, z of the DVL: (4,)."""
COMPASS_KEY = gtsam.symbol("m", 0)
"""The Earth's field in odom (3), hard iron (3), both in FIELD_UNIT, and soft iron (9, row by row): (15,)."""
DEPTH_KEY = gtsam.symbol("z", 0)
"""What the pressure sensor's height is over z of odom, m: (1,)."""
FIELD_UNIT = 1e-5
"""T: makes a field a number near one, as the solver likes its variables."""

WEAK = 1e-6  # share of the strongest direction's information below which beams say nothing about a direction
BIAS_STEP = 1e-5  # rad/s, of the difference quotient


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
    """All samples of an interval, carried to its beginning along the inertial measurements, as one; None without any.

    parts: the interval's inertial measurements, cut at the samples; state: at its beginning, roughly.
    A beam d of the DVL at time t sees d . (1 + s) Exp(-m) R_dvl_imu (dR^T (u + t R^T g + dv) + w x r), with dR, dv the
    preintegrated rotation and velocity (Forster et al. 2017, eq. 33). The rows of all beams are linear in u: their
    least-squares solution for it is the measurement, and keeps how it depends on the rest.
    """
    segments = [segment for segment, _ in parts]
    heard = [(k + 1, dvl_rows(sample, floor)) for k, (_, sample) in enumerate(parts) if sample is not None]
    heard = [(k, rows) for k, rows in heard if rows is not None and len(segments[k - 1].dt)]
    if not heard:
        return None
    to_dvl, lever = T_imu_dvl[:3, :3].T, T_imu_dvl[:3, 3]
    bias = state.bias
    down = state.nav.attitude().matrix().T @ np.array([0.0, 0.0, -gravity])
    start = state.nav.attitude().matrix().T @ state.nav.velocity()

    def carry(gyro_bias: Array) -> tuple[Array, Array, Array, Array]:
        """Slopes (M, 3) of all beams by u, by time R^T g (M, 3) and accelerometer bias (M, 3), and constants (M,)."""
        integral = integrate(segments, gyro_bias)
        slopes, down_slopes, accel_slopes, constants = [], [], [], []
        for k, (directions, _, _) in heard:
            slope = directions @ to_dvl @ integral.rotation[k].T
            rate = segments[k - 1].gyro[-1] - gyro_bias
            gained = integral.velocity[k] - integral.velocity_rate[k] @ bias.accelerometer()
            slopes.append(slope)
            down_slopes.append(slope * integral.time[k])
            accel_slopes.append(-slope @ integral.velocity_rate[k])
            constants.append(slope @ gained + directions @ to_dvl @ np.cross(rate, lever))
        return (
            np.concatenate(slopes),
            np.concatenate(down_slopes),
            np.concatenate(accel_slopes),
            np.concatenate(constants),
        )

    slope, down_slope, accel_slope, constant = carry(bias.gyroscope())
    along = np.concatenate([rows[1] for _, rows in heard])
    weight = 1.0 / np.concatenate([rows[2] for _, rows in heard])
    if not np.isfinite(weight).all():
        return None
    seen = slope @ start + down_slope @ down + constant
    gyro_slope = np.empty((len(seen), 3))
    for axis in range(3):
        moved = carry(bias.gyroscope() + BIAS_STEP * np.eye(3)[axis])
        gyro_slope[:, axis] = (moved[0] @ start + moved[1] @ down + moved[3] - seen) / BIAS_STEP
    # The velocity in the DVL's frame, by which its calibration multiplies.
    calibration_slope = []
    for k, (directions, _, _) in heard:
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

    def error(_: gtsam.CustomFactor, values: gtsam.Values, jacobians: list[Array] | None) -> Array:
        x, v, b = X(keyframe), V(keyframe), B(keyframe)
        at = values.atPose3(x), values.atVector(v), values.atConstantBias(b), values.atVector(DVL_KEY)
        residual, slopes = velocity_error(velocity, gravity, *at)
        if jacobians is not None:
            for k, slope in enumerate(slopes):
                jacobians[k] = np.asfortranarray(slope)
        return residual

    noise = gtsam.noiseModel.Diagonal.Sigmas(velocity.sigmas)
    return gtsam.CustomFactor(_robust(noise, huber), [X(keyframe), V(keyframe), B(keyframe), DVL_KEY], error)


def depth_error(height: float, lever: Array, pose: gtsam.Pose3, offset: Array) -> tuple[Array, list[Array]]:
    """(p + R r)_z + offset - height (1,), m, and derivatives by pose (1, 6) and offset (1, 1); x and y have no part."""
    down_row = pose.rotation().matrix()[2]
    error = pose.z() + down_row @ lever + offset - height
    return error, [np.concatenate([np.cross(lever, down_row), down_row])[None], np.ones((1, 1))]


def depth_factor(keyframe: int, height: float, lever: Array, sigma: float) -> gtsam.NonlinearFactor:
    """A height (m) of a point at `lever` (3,) of the IMU, over a level that is where odom's zero is but for an offset.

    The offset is a variable: what waves press while it is first read would otherwise lift the whole path.
    """

    def error(_: gtsam.CustomFactor, values: gtsam.Values, jacobians: list[Array] | None) -> Array:
        residual, slopes = depth_error(height, lever, values.atPose3(X(keyframe)), values.atVector(DEPTH_KEY))
        if jacobians is not None:
            for k, slope in enumerate(slopes):
                jacobians[k] = np.asfortranarray(slope)
        return residual

    return gtsam.CustomFactor(gtsam.noiseModel.Isotropic.Sigma(1, sigma), [X(keyframe), DEPTH_KEY], error)


def field_error(field: Array, R_compass_imu: Array, pose: gtsam.Pose3, iron: Array) -> tuple[Array, list[Array]]:
    """A R_compass_imu R^T f + h - measured, in FIELD_UNIT (3,), and derivatives by pose (3, 6) and iron (3, 15)."""
    earth, hard, soft = iron[:3], iron[3:6], iron[6:].reshape(3, 3)
    to_body = pose.rotation().matrix().T
    local = R_compass_imu @ to_body @ earth
    by_pose = np.hstack([soft @ R_compass_imu @ cross(to_body @ earth), np.zeros((3, 3))])
    by_iron = np.zeros((3, 15))
    by_iron[:, :3], by_iron[:, 3:6] = soft @ R_compass_imu @ to_body, np.eye(3)
    for row in range(3):  # np.kron took half of the factor's time
        by_iron[row, 6 + 3 * row : 9 + 3 * row] = local
    return soft @ local + hard - field, [by_pose, by_iron]


def field_factor(
    keyframe: int, field: Array, sigma: float, R_compass_imu: Array, huber: float
) -> gtsam.NonlinearFactor:
    """A magnetic field (3,) and its 1 sigma, in FIELD_UNIT, on the pose of a key frame, the Earth's field and iron."""

    def error(_: gtsam.CustomFactor, values: gtsam.Values, jacobians: list[Array] | None) -> Array:
        at = values.atPose3(X(keyframe)), values.atVector(COMPASS_KEY)
        residual, slopes = field_error(field, R_compass_imu, *at)
        if jacobians is not None:
            for k, slope in enumerate(slopes):
                jacobians[k] = np.asfortranarray(slope)
        return residual

    noise = gtsam.noiseModel.Isotropic.Sigma(3, sigma)
    return gtsam.CustomFactor(_robust(noise, huber), [X(keyframe), COMPASS_KEY], error)


def _robust(noise: gtsam.noiseModel.Base, huber: float) -> gtsam.noiseModel.Base:
    return gtsam.noiseModel.Robust.Create(gtsam.noiseModel.mEstimator.Huber.Create(huber), noise)
