"""The inertial unit's message."""

from __future__ import annotations

import numpy as np

from oysterbench.core.measurements import ImuMeasurement
from oysterbench.sequence.names import IMU, IMU_FRAME, TYPES
from oysterbench.sequence.wire import Message, decode, encode, header, make, quaternion, stamp_of, vector


def imu_message(sample: ImuMeasurement, gyro_variance: float, accel_variance: float) -> Message:
    """Inertial sample; variances per sample in (rad/s)^2 and (m/s^2)^2. Orientation is marked as absent (REP 145)."""
    absent = np.zeros(9)
    absent[0] = -1.0
    message = make(
        TYPES[IMU],
        header=header(sample.stamp_ns, IMU_FRAME),
        orientation=quaternion(np.array([0.0, 0.0, 0.0, 1.0])),
        orientation_covariance=absent,
        angular_velocity=vector(sample.gyro),
        angular_velocity_covariance=np.diag([gyro_variance] * 3).ravel(),
        linear_acceleration=vector(sample.accel),
        linear_acceleration_covariance=np.diag([accel_variance] * 3).ravel(),
    )
    return Message(IMU, sample.stamp_ns, encode(message))


def read_imu(data: bytes) -> ImuMeasurement:
    """Inertial sample from its message."""
    message = decode(data, TYPES[IMU])
    rate, force = message.angular_velocity, message.linear_acceleration
    return ImuMeasurement(
        stamp_of(message.header), np.array([rate.x, rate.y, rate.z]), np.array([force.x, force.y, force.z])
    )
