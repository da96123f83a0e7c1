"""ROS 1 bags (version 2.0) with EuRoC's topics: /cam0/image_raw, /cam1/image_raw, ... and /imu0, by rosbags.

Images are grey (mono8), like EuRoC's and as the systems that read them expect. Kalibr's files for the bag's topics lie
next to it. The truth, if requested, is on /groundtruth: geometry_msgs/PoseStamped, poses of the IMU in map.
"""

from __future__ import annotations

import heapq
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import scipy
from rosbags.rosbag1 import Writer
from rosbags.typesys import Stores, get_typestore

from oysterbench.core.geometry import Array
from oysterbench.core.measurements import Image, ImuMeasurement
from oysterbench.sequence.export.kalibr import write_calibration
from oysterbench.sequence.export.parts import inertial_samples, sensor_poses
from oysterbench.sequence.export.readme import truth_line, write_readme
from oysterbench.sequence.export.steps import Steps, frames
from oysterbench.sequence.types import Sequence

IMAGE, IMU, POSE = "sensor_msgs/msg/Image", "sensor_msgs/msg/Imu", "geometry_msgs/msg/PoseStamped"
IMU_TOPIC, TRUTH_TOPIC = "/imu0", "/groundtruth"
UNKNOWN = np.array([-1.0, *[0.0] * 8])
"""Covariance (9,) that marks a sensor_msgs/Imu as having no orientation."""


def write(sequence: Sequence, folder: Path, truth: bool, steps: Steps) -> list[str]:
    """Write NAME.bag, camchain-imucam.yaml, imu.yaml and README.txt."""
    topics = {name: f"/cam{index}/image_raw" for index, name in enumerate(sequence.cameras)}
    types = dict.fromkeys(topics.values(), IMAGE)
    types |= ({IMU_TOPIC: IMU} if sequence.has_imu else {}) | ({TRUTH_TOPIC: POSE} if truth else {})
    messages = Messages(topics)
    # At equal stamps in this order, as in `Sequence.stream`.
    sources: list[Iterator[Any]] = [inertial_samples(sequence), *map(sequence.images, sequence.cameras)]
    if truth:
        sources.append(_truth(sequence))
    steps.expect(frames(sequence, sequence.cameras))
    with Writer(folder / f"{sequence.name}.bag") as bag:
        connections = {
            topic: bag.add_connection(topic, kind, typestore=messages.types) for topic, kind in types.items()
        }
        for item in heapq.merge(*sources, key=lambda item: item.stamp_ns):
            topic, data = messages.encoded(item)
            bag.write(connections[topic], item.stamp_ns, data)
            if isinstance(item, Image):
                steps.done()
    notes = write_calibration(sequence, folder, topics.values(), IMU_TOPIC)
    labels = {topic: name for name, topic in topics.items()}
    own = (
        f"{IMU_TOPIC} has no orientation. camchain-imucam.yaml and imu.yaml are Kalibr's.",
        truth_line(truth, f"{TRUTH_TOPIC}, of the IMU"),
    )
    write_readme(sequence, folder, "EuRoC's ROS 1 bags", labels, truth, own)
    return [*(f"{topic} is {name}, in grey" for name, topic in topics.items()), *notes]


@dataclass(frozen=True)
class Pose:
    """Pose of the IMU in map: position (3,) m and quaternion x y z w (4,)."""

    stamp_ns: int
    position: Array
    quaternion: Array


def _truth(sequence: Sequence) -> Iterator[Pose]:
    truth = sequence.truth()
    poses = sensor_poses(truth, sequence.imu_calibration.T_base_imu)
    quaternions = scipy.spatial.transform.Rotation.from_matrix(poses[:, :3, :3]).as_quat(canonical=True)
    return map(Pose, map(int, truth.stamps_ns), poses[:, :3, 3], quaternions)


class Messages:
    """Encoder of measurements as ROS 1 messages. topics: those of the cameras, by camera name"""

    def __init__(self, topics: dict[str, str]) -> None:
        self.types = get_typestore(Stores.ROS1_NOETIC)
        self.topics = topics
        self._counts = dict.fromkeys((*topics.values(), IMU_TOPIC, TRUTH_TOPIC), 0)

    def encoded(self, item: Image | ImuMeasurement | Pose) -> tuple[str, bytes]:
        """Topic and bytes of a measurement or a pose."""
        if isinstance(item, Image):
            topic, kind = self.topics[item.camera], IMAGE
            values = self._image(item)
        elif isinstance(item, Pose):
            topic, kind = TRUTH_TOPIC, POSE
            values = {"pose": self._pose(item)}
        else:
            topic, kind = IMU_TOPIC, IMU
            values = self._imu(item)
        message = self._make(kind, header=self._header(topic, item), **values)
        return topic, bytes(self.types.serialize_ros1(message, kind))

    def _header(self, topic: str, item: Any) -> Any:
        seconds, nanoseconds = divmod(item.stamp_ns, 10**9)
        stamp = self._make("builtin_interfaces/msg/Time", sec=seconds, nanosec=nanoseconds)
        number, self._counts[topic] = self._counts[topic], self._counts[topic] + 1
        frame = "map" if topic == TRUTH_TOPIC else topic.split("/")[1]
        return self._make("std_msgs/msg/Header", seq=number, stamp=stamp, frame_id=frame)

    def _image(self, image: Image) -> dict[str, Any]:
        grey = cv2.cvtColor(image.pixels, cv2.COLOR_RGB2GRAY)
        height, width = grey.shape
        size = {"height": height, "width": width, "step": width}
        return {**size, "encoding": "mono8", "is_bigendian": 0, "data": np.ascontiguousarray(grey).reshape(-1)}

    def _imu(self, sample: ImuMeasurement) -> dict[str, Any]:
        return {
            "orientation": self._quaternion([0.0, 0.0, 0.0, 1.0]),
            "orientation_covariance": UNKNOWN,
            "angular_velocity": self._xyz("Vector3", sample.gyro),
            "angular_velocity_covariance": np.zeros(9),
            "linear_acceleration": self._xyz("Vector3", sample.accel),
            "linear_acceleration_covariance": np.zeros(9),
        }

    def _pose(self, pose: Pose) -> Any:
        position, orientation = self._xyz("Point", pose.position), self._quaternion(pose.quaternion)
        return self._make("geometry_msgs/msg/Pose", position=position, orientation=orientation)

    def _xyz(self, kind: str, values: Any) -> Any:
        return self._make(f"geometry_msgs/msg/{kind}", **dict(zip("xyz", map(float, values), strict=True)))

    def _quaternion(self, values: Any) -> Any:
        return self._make("geometry_msgs/msg/Quaternion", **dict(zip("xyzw", map(float, values), strict=True)))

    def _make(self, kind: str, **values: Any) -> Any:
        return self.types.types[kind](**values)
