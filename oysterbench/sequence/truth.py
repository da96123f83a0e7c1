"""True pose of the vehicle as odometry, pose and transform messages, and the poses of its sensors on it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from oysterbench.core.geometry import Array
from oysterbench.core.ros import (
    BASE,
    MAP,
    TF_STATIC,
    Message,
    decode,
    encode,
    header,
    make,
    point,
    quaternion,
    stamp_of,
    vector,
)
from oysterbench.core.trajectory import Trajectory
from oysterbench.core.trajectory.checks import MAX_POSITION_M, NORM_TOLERANCE
from oysterbench.recipe import RigRecipe
from oysterbench.sensors.kind import Row, columns_of
from oysterbench.sensors.registry import rig_sensors

TF = "/tf"
TRUTH, TRUTH_POSE = "/truth/odometry", "/truth/pose"
TRANSFORMS = "tf2_msgs/msg/TFMessage"

TRUTH_TYPES = {
    TRUTH: "nav_msgs/msg/Odometry",
    TRUTH_POSE: "geometry_msgs/msg/PoseStamped",
    TF: TRANSFORMS,
}
"""Topics with the true pose of the vehicle: as odometry, and in two further forms for viewers and tools."""


def rig_topics(rig: RigRecipe) -> dict[str, str]:
    """Topic -> type of everything that a rig publishes, ground truth included, in the order of the file: small first.

    Each topic has its own chunks (`SequenceWriter.section` after each), so that reading one touches no other.
    """
    topics = {TF_STATIC: TRANSFORMS}
    for kind, recipe in rig_sensors(rig):
        topics |= kind.topics(recipe)
        if kind.rank == 0:  # the IMU: next to it the ground truth
            topics |= TRUTH_TYPES
    return topics


def truth_message(stamp_ns: int, position: Array, attitude: Array, velocity: Array, rate: Array) -> Message:
    """True pose of base_link in map; velocity (m/s) and rate (rad/s) in base_link, as nav_msgs defines."""
    pose = make("geometry_msgs/msg/Pose", position=point(position), orientation=quaternion(attitude))
    twist = make("geometry_msgs/msg/Twist", linear=vector(velocity), angular=vector(rate))
    message = make(
        TRUTH_TYPES[TRUTH],
        header=header(stamp_ns, MAP),
        child_frame_id=BASE,
        pose=make("geometry_msgs/msg/PoseWithCovariance", pose=pose, covariance=np.zeros(36)),
        twist=make("geometry_msgs/msg/TwistWithCovariance", twist=twist, covariance=np.zeros(36)),
    )
    return Message(TRUTH, stamp_ns, encode(message))


def truth_pose_message(stamp_ns: int, position: Array, attitude: Array) -> Message:
    """True pose of base_link in map: position (3,) m, quaternion (4,)."""
    pose = make("geometry_msgs/msg/Pose", position=point(position), orientation=quaternion(attitude))
    message = make(TRUTH_TYPES[TRUTH_POSE], header=header(stamp_ns, MAP), pose=pose)
    return Message(TRUTH_POSE, stamp_ns, encode(message))


def transform_message(stamp_ns: int, position: Array, attitude: Array) -> Message:
    """True pose of base_link in map as a transform on `/tf`, so that a viewer can place what the sensors see."""
    return Message(TF, stamp_ns, _transforms(stamp_ns, MAP, {BASE: (position, attitude)}))


def static_transforms(stamp_ns: int, frames: Mapping[str, tuple[Array, Array]]) -> Message:
    """Poses of the rig's frames in base_link: name -> (position (3,) m, quaternion (4,))."""
    return Message(TF_STATIC, stamp_ns, _transforms(stamp_ns, BASE, frames))


def _transforms(stamp_ns: int, parent: str, frames: Mapping[str, tuple[Array, Array]]) -> bytes:
    transforms = [
        make(
            "geometry_msgs/msg/TransformStamped",
            header=header(stamp_ns, parent),
            child_frame_id=frame,
            transform=make("geometry_msgs/msg/Transform", translation=vector(position), rotation=quaternion(attitude)),
        )
        for frame, (position, attitude) in frames.items()
    ]
    return encode(make(TRANSFORMS, transforms=transforms))


def read_truth(messages: list[bytes]) -> Trajectory:
    """Trajectory from odometry messages. Raises ValueError where they hold no valid poses."""
    stamps, positions, quaternions = [], [], []
    for data in messages:
        message = decode(data, TRUTH_TYPES[TRUTH])
        at, by = message.pose.pose.position, message.pose.pose.orientation
        stamps.append(stamp_of(message.header))
        positions.append([at.x, at.y, at.z])
        quaternions.append([by.x, by.y, by.z, by.w])
    place, turn = np.array(positions).reshape(-1, 3), np.array(quaternions).reshape(-1, 4)
    near = (np.abs(place) <= MAX_POSITION_M).all() and (np.abs(turn) <= 2.0).all()  # NaN is not
    if not near or (np.abs(np.linalg.norm(turn, axis=1) - 1.0) > NORM_TOLERANCE).any():
        raise ValueError(f"{TRUTH}: expected positions within {MAX_POSITION_M:g} m and unit quaternions")
    times = np.array(stamps, dtype=np.int64)
    if not (np.diff(times) > 0).all():
        raise ValueError(f"{TRUTH}: expected stamps that increase")
    return Trajectory(times, place, turn)


def pose_row(pose: Any) -> Row:
    """Columns of a pose: position and quaternion."""
    return columns_of("", pose.position) | columns_of("q", pose.orientation, "xyzw")


def odometry_row(message: Any) -> Row:
    """Columns of a ground-truth odometry message: pose, velocity and angular rate."""
    twist = message.twist.twist
    return pose_row(message.pose.pose) | columns_of("velocity_", twist.linear) | columns_of("rate_", twist.angular)
