"""Inertial samples integrated: by hand for the initialisation, by GTSAM for factors."""

from __future__ import annotations

from dataclasses import dataclass

import gtsam
import numpy as np
from scipy.spatial.transform import Rotation

from oysterbench.core.geometry import Array
from oysterbench.sequence.types import ImuCalibration
from oysterbench_baselines.common.inertial import Segment
from oysterbench_baselines.gtsam_vi.settings import Settings


@dataclass(frozen=True)
class Integral:
    """Inertial integrals from the first of K stamps to each, in the IMU frame at the first.

    rotation (K, 3, 3): R_0_k. rate (K, 3, 3): integral of R, so that a change db of the gyro bias turns R_0_k by
    -rate db (rotation vector in frame 0). velocity, position (K, 3): of the specific force. velocity_rate,
    position_rate (K, 3, 3): minus their derivatives to the accelerometer bias. time (K,) s.
    """

    time: Array
    rotation: Array
    rate: Array
    velocity: Array
    position: Array
    velocity_rate: Array
    position_rate: Array


def integrate(segments: list[Segment], gyro_bias: Array) -> Integral:
    """Integrals at the K = len(segments) + 1 ends of segments, for a gyro bias and no accelerometer bias."""
    whole = Segment.join(segments)
    steps = Rotation.from_rotvec((whole.gyro - gyro_bias) * whole.dt[:, None]).as_matrix()
    half_steps = Rotation.from_rotvec(0.5 * (whole.gyro - gyro_bias) * whole.dt[:, None]).as_matrix()
    rotation = np.empty((len(steps) + 1, 3, 3))
    rotation[0] = np.eye(3)
    for k, step in enumerate(steps):
        rotation[k + 1] = rotation[k] @ step
    middle = rotation[:-1] @ half_steps  # attitude in the middle of the interval: second-order integration
    dt = whole.dt[:, None, None]
    force = (middle @ whole.accel[:, :, None])[..., 0]
    velocity = _cumulate(force * whole.dt[:, None])
    velocity_rate = _cumulate(middle * dt)
    position = _cumulate((velocity[:-1] + 0.5 * force * whole.dt[:, None]) * whole.dt[:, None])
    position_rate = _cumulate((velocity_rate[:-1] + 0.5 * middle * dt) * dt)
    ends = np.concatenate([[0], np.cumsum([len(s.dt) for s in segments])]).astype(int)
    time = _cumulate(whole.dt)
    rate = velocity_rate
    return Integral(
        time[ends], rotation[ends], rate[ends], velocity[ends], position[ends], velocity_rate[ends], position_rate[ends]
    )


def _cumulate(steps: Array) -> Array:
    return np.concatenate([np.zeros((1, *steps.shape[1:])), np.cumsum(steps, axis=0)])


def preintegration_params(calibration: ImuCalibration, settings: Settings) -> gtsam.PreintegrationCombinedParams:
    """Noise of the inertial unit as GTSAM wants it: continuous variances, every one of them set (z of the world up).

    The states are those of the IMU itself, not of base_link: GTSAM's `body_P_sensor` leaves the tangential
    acceleration of the lever arm out.
    """
    params = gtsam.PreintegrationCombinedParams.MakeSharedU(calibration.gravity)
    eye = np.eye(3)
    # A file may say zero; a zero variance makes the factor singular.
    gyro = max(calibration.gyro_noise_density, 1e-5) * settings.imu_inflation
    accel = max(calibration.accel_noise_density, 1e-4) * settings.imu_inflation
    gyro_walk = max(calibration.gyro_random_walk, 1e-6) * settings.bias_inflation
    accel_walk = max(calibration.accel_random_walk, 1e-5) * settings.bias_inflation
    params.setGyroscopeCovariance(eye * gyro**2)
    params.setAccelerometerCovariance(eye * accel**2)
    params.setIntegrationCovariance(eye * settings.integration_sigma**2)
    params.setBiasOmegaCovariance(eye * gyro_walk**2)
    params.setBiasAccCovariance(eye * accel_walk**2)
    return params


def preintegrate(
    segment: Segment, bias: gtsam.imuBias.ConstantBias, params: gtsam.PreintegrationCombinedParams
) -> gtsam.PreintegratedCombinedMeasurements:
    """Preintegrated measurements of a segment (Forster et al. 2017) at a bias."""
    measurements = gtsam.PreintegratedCombinedMeasurements(params, bias)
    extend(measurements, segment)
    return measurements


def extend(measurements: gtsam.PreintegratedCombinedMeasurements, segment: Segment) -> None:
    """Integrate a further segment.

    GTSAM lets the force act in the attitude at the beginning of an interval: with gravity in the force, an error of
    half a turn per sample times g. Turned on by half an interval, the force acts in the attitude in its middle.
    """
    if len(segment.dt) == 0:
        return
    turn = (segment.gyro - measurements.biasHat().gyroscope()) * segment.dt[:, None]
    force = Rotation.from_rotvec(0.5 * turn).apply(segment.accel)
    for dt, gyro, accel in zip(segment.dt, segment.gyro, force, strict=True):
        measurements.integrateMeasurement(accel, gyro, dt)
