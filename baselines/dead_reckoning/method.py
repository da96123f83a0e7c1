"""Strapdown integration of the inertial unit, from an assumed rest."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from oysterbench.errors import MethodError
from oysterbench.geometry import Array, invert
from oysterbench.methods import Estimate
from oysterbench.sequence.types import ImuCalibration, Sequence, imu_arrays
from oysterbench.trajectory import Trajectory


@dataclass(frozen=True)
class Settings:
    """level_s: the vehicle is levelled by the mean specific force of so many seconds. It was at rest in them if both
    sensors scattered by less than rest_sigmas of their white noise, or the floors, which stand in for the noise of a
    unit that states none; and if the mean rate is within rest_sigmas of the turn-on bias.
    """

    level_s: float = 1.0
    rest_sigmas: float = 2.0
    gyro_floor: float = 2e-3  # rad/s
    accel_floor: float = 0.02  # m/s^2


class DeadReckoning:
    """Inertial navigation without aiding: attitude, velocity and position by integrating rates and forces."""

    name = "dead_reckoning"
    track = "slam"

    def __init__(self, settings: Settings | None = None) -> None:
        self.settings = settings or Settings()

    def run(self, sequence: Sequence) -> Estimate:
        """Poses T_odom_base at the stamps of the inertial samples; odom starts at the vehicle, yaw zero, z up."""
        stamps_ns, gyro, accel = imu_arrays(sequence.imu())
        if len(stamps_ns) < 2:
            raise MethodError(
                f"dead_reckoning: expected inertial samples in sequence {sequence.name}, got {len(stamps_ns)}"
            )
        calibration = sequence.imu_calibration
        rotation, gyro_bias, accel_bias, at_rest = align(stamps_ns, gyro, accel, calibration, self.settings)
        T_odom_imu = integrate(stamps_ns, gyro - gyro_bias, accel - accel_bias, rotation, calibration.gravity)
        poses = T_odom_imu @ invert(calibration.T_base_imu)
        poses[:, :3, 3] -= poses[0, :3, 3].copy()
        quaternions = Rotation.from_matrix(poses[:, :3, :3]).as_quat()
        return Estimate(Trajectory(stamps_ns, poses[:, :3, 3].copy(), quaternions), {"started_at_rest": at_rest})


def align(
    stamps_ns: NDArray[np.int64], gyro: Array, accel: Array, calibration: ImuCalibration, settings: Settings
) -> tuple[Array, Array, Array, bool]:
    """Attitude R_odom_imu (3, 3) at the first sample, biases of gyro and accel (3,), and whether that was at rest.

    Level by the mean specific force, with the yaw of base_link zero. The biases are those seen at rest, of the force
    only the part along gravity (the rest of it cannot be told from tilt); in motion they are zero.
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
    up = force / np.linalg.norm(force)  # of odom, in the IMU frame
    forward = calibration.T_base_imu[:3, :3].T[:, 0]
    x = forward - up * (up @ forward)
    if np.linalg.norm(x) < 1e-6:
        raise MethodError("dead_reckoning: the vehicle starts nose up or down: its yaw is not defined")
    x /= np.linalg.norm(x)
    rotation = np.stack([x, np.cross(up, x), up])
    if not at_rest:
        return rotation, np.zeros(3), np.zeros(3), False
    return rotation, rate, force - up * calibration.gravity, True


def integrate(stamps_ns: NDArray[np.int64], gyro: Array, accel: Array, rotation: Array, gravity: float) -> Array:
    """T_odom_imu (N, 4, 4) at N stamps from rates and specific forces (N, 3) at them, starting at rest at the origin.

    Rates and forces are taken to be linear between samples; the force acts in the attitude half-way (midpoint rule),
    so that the error is of second order in the sampling interval.
    """
    dt = np.diff(stamps_ns)[:, None] * 1e-9
    turn = 0.5 * (gyro[1:] + gyro[:-1]) * dt
    steps = Rotation.from_rotvec(turn).as_matrix()
    halves = Rotation.from_rotvec(0.5 * turn).as_matrix()
    poses = np.tile(np.eye(4), (len(stamps_ns), 1, 1))
    poses[0, :3, :3] = rotation
    for k, step in enumerate(steps):
        poses[k + 1, :3, :3] = poses[k, :3, :3] @ step
    middle = poses[:-1, :3, :3] @ halves
    acceleration = np.einsum("nij,nj->ni", middle, 0.5 * (accel[1:] + accel[:-1])) - [0.0, 0.0, gravity]
    velocity = np.concatenate([np.zeros((1, 3)), np.cumsum(acceleration * dt, axis=0)])
    poses[1:, :3, 3] = np.cumsum((velocity[:-1] + 0.5 * acceleration * dt) * dt, axis=0)
    return poses
