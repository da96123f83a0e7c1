"""Scalar sensors as tables: a row per message, a column per number."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import TYPE_CHECKING, Any

import numpy as np

from oysterbench.sequence.messages.points import read_points
from oysterbench.sequence.names import CLOUD, DVL_BEAMS
from oysterbench.sequence.wire import decode, stamp_of

if TYPE_CHECKING:
    import pandas as pd

BEAM_COLUMNS = ("range", "velocity", "valid")
XYZ = ("x", "y", "z")
XYZW = ("x", "y", "z", "w")


def _vector(prefix: str, value: Any, axes: tuple[str, ...] = XYZ) -> dict[str, float]:
    return {f"{prefix}{axis}": getattr(value, axis) for axis in axes}


def _pose(pose: Any) -> dict[str, float]:
    return _vector("", pose.position) | _vector("q", pose.orientation, XYZW)


def _imu(message: Any) -> dict[str, float]:
    return _vector("gyro_", message.angular_velocity) | _vector("accel_", message.linear_acceleration)


def _velocity(message: Any) -> dict[str, float]:
    variances = message.twist.covariance[[0, 7, 14]]
    return _vector("velocity_", message.twist.twist.linear) | {
        f"variance_{axis}": float(value) for axis, value in zip(XYZ, variances, strict=True)
    }


def _odometry(message: Any) -> dict[str, float]:
    twist = message.twist.twist
    return _pose(message.pose.pose) | _vector("velocity_", twist.linear) | _vector("rate_", twist.angular)


ROWS: dict[str, Callable[[Any], dict[str, float]]] = {
    "sensor_msgs/msg/Imu": _imu,
    "geometry_msgs/msg/TwistWithCovarianceStamped": _velocity,
    "sensor_msgs/msg/FluidPressure": lambda message: {"pressure": message.fluid_pressure, "variance": message.variance},
    "sensor_msgs/msg/MagneticField": lambda message: _vector("field_", message.magnetic_field),
    "sensor_msgs/msg/Range": lambda message: {"range": message.range},
    "sensor_msgs/msg/JointState": lambda message: {"angle": float(message.position[0])},
    "nav_msgs/msg/Odometry": _odometry,
    "geometry_msgs/msg/PoseStamped": lambda message: _pose(message.pose),
}
"""Message type -> the numbers of a message by their columns, in SI units: rad/s, m/s^2, m/s, Pa, T, m, rad."""


def has_table(topic: str, type_name: str) -> bool:
    """Whether a topic's messages make rows: those of scalar sensors, the DVL's beams included."""
    return type_name in ROWS or topic == DVL_BEAMS


def table(messages: Iterable[bytes], type_name: str) -> pd.DataFrame:
    """Messages of one type as a table, indexed by stamp_ns (int64)."""
    import pandas as pd

    stamps, rows = [], []
    for data in messages:
        if type_name == CLOUD:
            stamp, beams = read_points(data)
            stamps.append(stamp)
            rows.append({f"{key}_{k}": beam[key].item() for k, beam in enumerate(beams) for key in BEAM_COLUMNS})
            continue
        message = decode(data, type_name)
        stamps.append(stamp_of(message.header))
        rows.append(ROWS[type_name](message))
    return pd.DataFrame(rows, index=pd.Index(np.array(stamps, dtype=np.int64), name="stamp_ns"))
