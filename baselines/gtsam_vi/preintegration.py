"""IMU preintegration by GTSAM: noise model, preintegrated measurements, and the factor made of them."""

from __future__ import annotations

import math

import gtsam
import numpy as np
from gtsam.symbol_shorthand import B, V, X
from scipy.spatial.transform import Rotation

from oysterbench.sequence.types import ImuCalibration
from oysterbench_baselines.common.filter import ACCEL_WARMING, GYRO_WARMING
from oysterbench_baselines.common.inertial import Segment
from oysterbench_baselines.gtsam_vi.settings import NoiseSettings


def preintegration_params(
    calibration: ImuCalibration, settings: NoiseSettings, warming_s: float = 1.0
) -> gtsam.PreintegrationCombinedParams:
    """IMU noise as GTSAM requires it: continuous-time variances, every one of them set (z of the world up).

    warming_s: time over which its warming goes on alike. It drifts by rate times time, and a random walk that is to
    reach as far in that time has a density of the rate times its root.

    The states are those of the IMU itself, not of base_link: GTSAM's `body_P_sensor` leaves the tangential
    acceleration of the lever arm out.
    """
    params = gtsam.PreintegrationCombinedParams.MakeSharedU(calibration.gravity)
    eye = np.eye(3)
    # A file may say zero; a zero variance makes the factor singular.
    gyro = max(calibration.gyro_noise_density, 1e-5) * settings.imu_inflation
    accel = max(calibration.accel_noise_density, 1e-4) * settings.imu_inflation
    gyro_walk = math.hypot(calibration.gyro_random_walk * settings.bias_inflation, math.sqrt(warming_s) * GYRO_WARMING)
    accel_walk = math.hypot(
        calibration.accel_random_walk * settings.bias_inflation, math.sqrt(warming_s) * ACCEL_WARMING
    )
    params.setGyroscopeCovariance(eye * gyro**2)
    params.setAccelerometerCovariance(eye * accel**2)
    params.setIntegrationCovariance(eye * settings.integration_sigma**2)
    params.setBiasOmegaCovariance(eye * gyro_walk**2)
    params.setBiasAccCovariance(eye * accel_walk**2)
    return params


def preintegrate(
    segment: Segment, bias: gtsam.imuBias.ConstantBias, params: gtsam.PreintegrationCombinedParams
) -> gtsam.PreintegratedCombinedMeasurements:
    """Preintegrated measurements of a segment (Forster et al. 2017) at a bias.

    GTSAM applies the specific force in the attitude at the start of an interval: as it includes gravity, that is an
    error of half the rotation per sample times g. Rotated by half an interval, it acts in the attitude in the middle.
    """
    measurements = gtsam.PreintegratedCombinedMeasurements(params, bias)
    turn = (segment.gyro - bias.gyroscope()) * segment.dt[:, None]
    force = Rotation.from_rotvec(0.5 * turn).apply(segment.accel) if len(turn) else segment.accel
    for dt, gyro, accel in zip(segment.dt, segment.gyro, force, strict=True):
        measurements.integrateMeasurement(accel, gyro, dt)
    return measurements


def inertial_factor(
    before: int,
    after: int,
    segment: Segment,
    bias: gtsam.imuBias.ConstantBias,
    params: gtsam.PreintegrationCombinedParams,
) -> gtsam.CombinedImuFactor:
    """Factor of a segment between the states of the keyframes at its ends, preintegrated at a bias."""
    measurements = preintegrate(segment, bias, params)
    return gtsam.CombinedImuFactor(X(before), V(before), X(after), V(after), B(before), B(after), measurements)
