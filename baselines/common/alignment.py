"""Alignment of a vehicle in its first moments: level from gravity, biases where it is at rest, and their covariance."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from oysterbench.core.errors import MethodError
from oysterbench.core.geometry import Array, invert
from oysterbench.core.measurements import ImuMeasurement
from oysterbench.sequence.types import ImuCalibration
from oysterbench_baselines.common.filter import (
    ACCEL_BIAS,
    ATTITUDE,
    GYRO_BIAS,
    VELOCITY,
    InertialNoise,
    InvariantFilter,
    rotation_exp,
)
from oysterbench_baselines.common.inertial import MOST_FORCE, MOST_RATE, is_plausible

EARLY_NS = 1_000_000_000
"""What precedes the first inertial sample by more is not kept: nothing is known of the motion then, and a camera that
begins a minute earlier has gigabytes of images."""
JITTER_NS = 10_000_000
"""By how much another sensor's first stamp may precede that of the inertial unit though both begin together."""


@dataclass(frozen=True)
class StartSettings:
    """Settings of the alignment.

    level_s: the vehicle is levelled by the mean specific force over so many seconds. It was at rest in them if both
    sensors scattered by less than rest_sigmas of their white noise, or the floors, which stand in for the noise of an
    IMU that states none; and if the mean rate is within 3 sigmas of the turn-on bias, or the gyro's floor.
    """

    level_s: float = 1.0
    rest_sigmas: float = 2.0
    gyro_floor: float = 2e-3  # rad/s
    accel_floor: float = 0.02  # m/s^2
    rest_speed: float = 0.005  # m/s, 1 sigma at rest
    moving_speed: float = 1.0  # m/s, 1 sigma otherwise
    moving_accel: float = 0.3  # m/s^2, 1 sigma of the mean acceleration: an ROV accelerates and sways


@dataclass(frozen=True)
class FirstMoments:
    """What a sequence begins with: the items of the stream until then, but for those that are EARLY_NS before the first
    inertial sample; stamps (N,), gyro and accel (N, 3) of the inertial samples by which the vehicle is levelled."""

    items: list[Any]
    stamps_ns: NDArray[np.int64]
    gyro: Array
    accel: Array


def first_moments(method: str, sequence: str, stream: Iterator[Any], settings: StartSettings) -> FirstMoments:
    """Take the first moments from a stream: `level_s` from the first inertial sample on, whatever began before it.

    Samples that no motion explains are left out, as later: a single one would tilt the vehicle by degrees. Raises
    MethodError, with the names of method and sequence, where there are fewer than two others.
    """
    items, inertial, begin_ns = deque[Any](), list[ImuMeasurement](), 0
    for item in stream:
        items.append(item)
        while not inertial and item.stamp_ns - items[0].stamp_ns > EARLY_NS:
            items.popleft()
        if isinstance(item, ImuMeasurement) and is_plausible(item):
            if not inertial:
                early = item.stamp_ns - items[0].stamp_ns > JITTER_NS
                begin_ns = item.stamp_ns if early else items[0].stamp_ns
            inertial.append(item)
        if inertial and item.stamp_ns - begin_ns > settings.level_s * 1e9:
            break
    if len(inertial) < 2:
        raise MethodError(
            f"{method}: expected inertial samples in the first {settings.level_s:g} s of those of sequence {sequence}, "
            f"of less than {MOST_RATE:g} rad/s and {MOST_FORCE:g} m/s^2, got {len(inertial)}"
        )
    return FirstMoments(
        list(items),
        np.array([sample.stamp_ns for sample in inertial], dtype=np.int64),
        np.array([sample.gyro for sample in inertial]),
        np.array([sample.accel for sample in inertial]),
    )


def align(
    stamps_ns: NDArray[np.int64], gyro: Array, accel: Array, calibration: ImuCalibration, settings: StartSettings
) -> tuple[Array, Array, Array, bool]:
    """Attitude R_odom_imu (3, 3) at the first sample, biases of gyro and accel (3,), and whether that was at rest.

    Level by the mean specific force, with the yaw of base_link zero. The biases are those seen at rest, for the
    accelerometer only the part along gravity (the rest cannot be told from tilt); in motion they are zero. Raises
    MethodError where the vehicle starts nose up or down.
    """
    first = stamps_ns - stamps_ns[0] <= settings.level_s * 1e9
    rate, force = gyro[first].mean(axis=0), accel[first].mean(axis=0)
    gyro_limit = max(
        settings.rest_sigmas * calibration.gyro_noise_density * calibration.rate_hz**0.5, settings.gyro_floor
    )
    accel_limit = max(
        settings.rest_sigmas * calibration.accel_noise_density * calibration.rate_hz**0.5, settings.accel_floor
    )
    at_rest = bool(
        gyro[first].std(axis=0).max() < gyro_limit
        and accel[first].std(axis=0).max() < accel_limit
        and np.abs(rate).max() < max(3 * calibration.gyro_turn_on, settings.gyro_floor)
    )
    if not at_rest:
        force = _unturned(stamps_ns[first], gyro[first], accel[first]).mean(axis=0)
    up = force / np.linalg.norm(force)  # of odom, in the IMU frame
    forward = calibration.T_base_imu[:3, :3].T[:, 0]
    x = forward - up * (up @ forward)
    if np.linalg.norm(x) < 1e-6:
        raise MethodError("the vehicle starts nose up or down: its yaw is not defined")
    x /= np.linalg.norm(x)
    rotation = np.stack([x, np.cross(up, x), up])
    if not at_rest:
        return rotation, np.zeros(3), np.zeros(3), False
    return rotation, rate, force - up * calibration.gravity, True


def _unturned(stamps_ns: NDArray[np.int64], gyro: Array, accel: Array) -> Array:
    """Specific forces (N, 3) in the IMU's attitude at the first of N samples: rolling meanwhile is not tilt."""
    turned, rotation = [accel[0]], np.eye(3)
    for dt, rate, force in zip(np.diff(stamps_ns) * 1e-9, 0.5 * (gyro[1:] + gyro[:-1]), accel[1:], strict=True):
        rotation = rotation @ rotation_exp(dt * rate)
        turned.append(rotation @ force)
    return np.array(turned)


def start_filter(
    stamps_ns: NDArray[np.int64],
    gyro: Array,
    accel: Array,
    calibration: ImuCalibration,
    noise: InertialNoise,
    settings: StartSettings,
) -> tuple[InvariantFilter, bool]:
    """A filter at the first of N samples, odom at base_link with its yaw, and whether the vehicle was at rest.

    Tilt errs by the accelerometer bias, noise and acceleration in the mean force, divided by gravity: the first of
    these stays in the filter as the correlation between tilt and bias.
    """
    rotation, gyro_bias, accel_bias, at_rest = align(stamps_ns, gyro, accel, calibration, settings)
    filter = InvariantFilter(rotation, noise, calibration.gravity)
    filter.gyro_bias, filter.accel_bias = gyro_bias, accel_bias
    filter.position = rotation @ -invert(calibration.T_base_imu)[:3, 3]
    eye, up = np.eye(3), np.outer(rotation[2], rotation[2])
    span = max(min(settings.level_s, (stamps_ns[-1] - stamps_ns[0]) * 1e-9), 1e-3)
    gyro_white, accel_white = noise.gyro**2 / span, noise.accel**2 / span
    gyro_turn_on, accel_turn_on = max(calibration.gyro_turn_on, 1e-5), max(calibration.accel_turn_on, 1e-3)
    of_bias = accel_turn_on**2 * eye
    if at_rest:
        of_bias = accel_turn_on**2 * (eye - up) + accel_white * up
    of_mean = rotation @ of_bias @ rotation.T + accel_white * eye
    if not at_rest:
        of_mean = of_mean + settings.moving_accel**2 * eye
    # theta x (0, 0, g) is the mean force apart from gravity. The bow points along x by definition: where it is
    # above or below the horizon, a tilt about it needs a turn about z with it.
    bow = rotation @ calibration.T_base_imu[:3, :3].T[:, 0]
    tilt = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, -bow[2] / bow[0], 0.0]]) / calibration.gravity
    covariance = filter.covariance
    covariance[ATTITUDE, ATTITUDE] = tilt @ of_mean @ tilt.T
    # And where the bow is level, of second order: half the product of both tilts.
    covariance[2, 2] += 0.25 * covariance[0, 0] * covariance[1, 1]
    covariance[ACCEL_BIAS, ACCEL_BIAS] = of_bias
    covariance[ATTITUDE, ACCEL_BIAS] = tilt @ rotation @ of_bias
    covariance[ACCEL_BIAS, ATTITUDE] = covariance[ATTITUDE, ACCEL_BIAS].T
    covariance[GYRO_BIAS, GYRO_BIAS] = (gyro_white if at_rest else gyro_turn_on**2) * eye
    covariance[VELOCITY, VELOCITY] = (settings.rest_speed if at_rest else settings.moving_speed) ** 2 * eye
    return filter, at_rest
