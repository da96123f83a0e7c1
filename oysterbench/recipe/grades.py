"""Grades of inertial units: a rig names one, and states only the keys that differ from it."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

DEG = math.pi / 180.0
G = 9.80665  # m/s^2
ROOT_H = 60.0  # seconds under a root: 1 unit/sqrt(h) = 1/60 unit/s/sqrt(Hz)
HOUR = 3600.0  # s

IMU_GRADES: Mapping[str, Mapping[str, float]] = {
    "low": {
        "gyro_noise_density": 0.75 * DEG / ROOT_H,
        "gyro_bias_instability": 10.0 * DEG / HOUR,
        "accel_noise_density": 0.05 / ROOT_H,
        "accel_bias_instability": 2.0e-4,
    },
    "mid": {
        "gyro_noise_density": 0.25 * DEG / ROOT_H,
        "gyro_bias_instability": 3.5 * DEG / HOUR,
        "accel_noise_density": 0.03 / ROOT_H,
        "accel_bias_instability": 5.0e-5,
    },
    "high": {
        "gyro_noise_density": 0.002 * DEG / ROOT_H,
        "gyro_bias_instability": 0.1 * DEG / HOUR,
        "accel_noise_density": 2.5e-5 / ROOT_H,
        "accel_bias_instability": 3.6e-6,
    },
    # ICM-20602 (TDK InvenSense, DS-000176): 4 mdps and 100 ug per root hertz, zero within 1 dps and 40 mg, taken as
    # three sigma; 16 bits over 2000 dps and 16 g. The sheet names no bias instability: what is usual for its class.
    "mems": {
        "gyro_noise_density": 4.0e-3 * DEG,
        "gyro_turn_on": 1.0 * DEG / 3,
        "gyro_bias_instability": 10.0 * DEG / HOUR,
        "gyro_range": 2000.0 * DEG,
        "gyro_step": 2000.0 * DEG / 2**15,
        "accel_noise_density": 100e-6 * G,
        "accel_turn_on": 40e-3 * G / 3,
        "accel_bias_instability": 50e-6 * G,
        "accel_range": 16.0 * G,
        "accel_step": 16.0 * G / 2**15,
    },
}
"""Keys of an `ImuRecipe`, in its units, by grade; low, mid and high are those of OysterSim. Bias instability is the
stationary sigma of a Gauss-Markov process."""

COMMON = {"gyro_random_walk": 0.0, "gyro_bias_tau_s": 100.0, "accel_random_walk": 0.0, "accel_bias_tau_s": 100.0}
"""What all grades share: a bias that stays about its turn-on value, correlated over 100 s."""


def with_grade(rig: Mapping[str, Any]) -> dict[str, Any]:
    """The table of a rig, where each key that its inertial unit's grade gives and the rig does not is filled in."""
    unit = rig.get("imu")
    grade = unit.get("grade") if isinstance(unit, Mapping) else None
    if not isinstance(unit, Mapping) or not isinstance(grade, str) or grade not in IMU_GRADES:
        return dict(rig)
    return {**rig, "imu": {**COMMON, **IMU_GRADES[grade], **unit}}
