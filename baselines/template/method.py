"""A method in twenty lines: it turns with the gyroscope, levels itself by gravity once, and drives straight ahead."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from oysterbench.core.trajectory import Trajectory
from oysterbench.methods import Estimate
from oysterbench.sequence.types import Sequence, imu_arrays


class Template:
    """The template. speed_m_s: speed that it assumes; an option, as in `my_slam:MySlam[speed_m_s=0.4]`."""

    name = "template"
    track = "slam"

    def __init__(self, speed_m_s: float = 0.3) -> None:
        self.speed_m_s = speed_m_s

    def run(self, sequence: Sequence) -> Estimate:
        """Poses T_odom_base at the inertial stamps."""
        stamps, gyro, accel = imu_arrays(sequence.imu())
        R_base_imu = Rotation.from_matrix(sequence.imu_calibration.T_base_imu[:3, :3])
        up = R_base_imu.apply(accel[:100].mean(axis=0))  # specific force of the start: mostly what holds the vehicle up
        attitude = Rotation.align_vectors([[0.0, 0.0, 1.0]], [up])[0]  # T_odom_base at the start
        seconds = np.diff(stamps, prepend=stamps[0]) * 1e-9
        rotations, positions, position = [], [], np.zeros(3)
        for dt, turn in zip(seconds, R_base_imu.apply(gyro), strict=True):
            attitude = attitude * Rotation.from_rotvec(turn * dt)
            position = position + attitude.apply([self.speed_m_s * dt, 0.0, 0.0])
            rotations.append(attitude.as_quat())
            positions.append(position)
        return Estimate(Trajectory(stamps, np.array(positions), np.array(rotations)), {"speed_m_s": self.speed_m_s})
