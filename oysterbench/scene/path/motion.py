"""Motion of the vehicle: splines smooth enough to be differentiated analytically into what an IMU measures."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import BSpline
from scipy.spatial.transform import Rotation

from oysterbench.core.geometry import Array
from oysterbench.core.trajectory import Trajectory


@dataclass(frozen=True)
class Motion:
    """State of the body at N times. World frame `map`, body frame `base_link`.

    position (N, 3) m, velocity (N, 3) m/s, acceleration (N, 3) m/s^2: of the body's origin, in the world frame.
    rotation (N, 3, 3): body to world. rate (N, 3) rad/s, rate_dot (N, 3) rad/s^2: of the body relative to the world,
    in the body frame.
    """

    position: Array
    velocity: Array
    acceleration: Array
    rotation: Array
    rate: Array
    rate_dot: Array


@dataclass(frozen=True)
class Path:
    """Quintic splines of x, y, z (m) and yaw, pitch, roll (rad; intrinsic z y x) over time (s): four times
    continuously differentiable, so that accelerations and rates are exact derivatives rather than differences."""

    position: BSpline
    attitude: BSpline
    duration_s: float

    def at(self, times_s: Array) -> Motion:
        """Motion at times (N,) s from the start."""
        velocity, acceleration = self.position.derivative(1), self.position.derivative(2)
        angles = self.attitude(times_s)
        rates = self.attitude.derivative(1)(times_s)
        accelerations = self.attitude.derivative(2)(times_s)
        rate, rate_dot = body_rates(angles, rates, accelerations)
        return Motion(
            position=self.position(times_s),
            velocity=velocity(times_s),
            acceleration=acceleration(times_s),
            rotation=Rotation.from_euler("ZYX", angles).as_matrix(),
            rate=rate,
            rate_dot=rate_dot,
        )

    def trajectory(self, times_s: Array, stamps_ns: np.ndarray) -> Trajectory:
        """Poses at times (N,) s, stamped with stamps_ns (N,)."""
        quaternions = Rotation.from_euler("ZYX", self.attitude(times_s)).as_quat(canonical=True)
        return Trajectory(np.asarray(stamps_ns, dtype=np.int64), self.position(times_s), quaternions)


def body_rates(angles: Array, rates: Array, accelerations: Array) -> tuple[Array, Array]:
    """Body rate and its derivative, both (N, 3) in the body frame, from yaw, pitch, roll (N, 3) and their derivatives.

    Kinematics of z-y-x Euler angles (Fossen 2011, eq. 2.28), and their time derivative.
    """
    _, pitch, roll = angles.T
    yaw_1, pitch_1, roll_1 = rates.T
    yaw_2, pitch_2, roll_2 = accelerations.T
    sin_p, cos_p, sin_r, cos_r = np.sin(pitch), np.cos(pitch), np.sin(roll), np.cos(roll)
    rate = np.column_stack(
        [
            roll_1 - yaw_1 * sin_p,
            pitch_1 * cos_r + yaw_1 * cos_p * sin_r,
            -pitch_1 * sin_r + yaw_1 * cos_p * cos_r,
        ]
    )
    rate_dot = np.column_stack(
        [
            roll_2 - yaw_2 * sin_p - yaw_1 * pitch_1 * cos_p,
            pitch_2 * cos_r
            - pitch_1 * roll_1 * sin_r
            + yaw_2 * cos_p * sin_r
            - yaw_1 * pitch_1 * sin_p * sin_r
            + yaw_1 * roll_1 * cos_p * cos_r,
            -pitch_2 * sin_r
            - pitch_1 * roll_1 * cos_r
            + yaw_2 * cos_p * cos_r
            - yaw_1 * pitch_1 * sin_p * cos_r
            - yaw_1 * roll_1 * cos_p * sin_r,
        ]
    )
    return rate, rate_dot
