"""Topics of a sequence file: names, ROS 2 message types, qualities of service, and turning them into bytes and back."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cache
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from rosbags.typesys import Stores, get_typestore
from rosbags.typesys.store import Typestore

from oysterbench.errors import SequenceError
from oysterbench.geometry import Array
from oysterbench.samples import ImuSample
from oysterbench.sequence.types import CameraCalibration
from oysterbench.trajectory import Trajectory

EPOCH_NS = 1_767_225_600_000_000_000
"""First stamp of every sequence, 2026-01-01T00:00:00Z: readers take a time of zero for an empty chunk."""

MAP, BASE, IMU_FRAME = "map", "base_link", "imu_link"
TF_STATIC, IMU, TRUTH = "/tf_static", "/imu", "/truth/odometry"

COLOUR = "sensor_msgs/msg/CompressedImage"
LAYER = "sensor_msgs/msg/Image"

TYPES = {
    TF_STATIC: "tf2_msgs/msg/TFMessage",
    IMU: "sensor_msgs/msg/Imu",
    TRUTH: "nav_msgs/msg/Odometry",
}

LAYERS = {
    "depth": "16UC1",
    "class": "mono8",
    "instance": "16UC1",
    "normals": "32FC3",
    "clean": "32FC3",
    "direct": "32FC3",
    "glow": "32FC3",
    "backscatter": "32FC3",
    "snow": "32FC3",
    "visibility": "32FC1",
}
"""Layers of a camera and their encodings. Depth in mm along the optical axis, 0 = none (REP 118)."""

PIXELS = {"mono8": ("u1", 1), "16UC1": ("<u2", 1), "32FC1": ("<f4", 1), "32FC3": ("<f4", 3)}
"""Encodings: type of a number, and numbers in a pixel."""

QOS = """\
- history: keep_last
  depth: {depth}
  reliability: reliable
  durability: {durability}
  deadline: {{sec: 9223372036, nsec: 854775807}}
  lifespan: {{sec: 9223372036, nsec: 854775807}}
  liveliness: automatic
  liveliness_lease_duration: {{sec: 9223372036, nsec: 854775807}}
  avoid_ros_namespace_conventions: false
"""
"""As ROS 2 Jazzy's recorder writes it; the times are its "infinite"."""


def camera_topics(camera: str, layers: Iterable[str] = tuple(LAYERS)) -> dict[str, str]:
    """Topic and type of everything that a camera sends: `image`, `camera_info` and the layers."""
    topics = {
        f"/{camera}/image": COLOUR,
        f"/{camera}/camera_info": "sensor_msgs/msg/CameraInfo",
    }
    return topics | {f"/{camera}/{layer}": LAYER for layer in layers}


def optical_frame(camera: str) -> str:
    """Frame of a camera's measurements: z forward, x right, y down (REP 103)."""
    return f"{camera}_optical_frame"


@cache
def typestore() -> Typestore:
    """Message types of ROS 2 Jazzy; those used here are the same in Humble."""
    return get_typestore(Stores.ROS2_JAZZY)


def channel_metadata(topic: str, type_name: str) -> dict[str, str]:
    """What rosbag2 wants to know of a channel."""
    latched = topic == TF_STATIC
    qos = QOS.format(depth=1 if latched else 10, durability="transient_local" if latched else "volatile")
    return {
        "offered_qos_profiles": qos,
        "topic_type_hash": typestore().hash_rihs01(type_name),
    }


def schema(type_name: str) -> bytes:
    """Definition of a message type with all that it refers to, as `ros2msg`."""
    return typestore().generate_msgdef(type_name, ros_version=2)[0].encode()


@dataclass(frozen=True)
class Message:
    """One message, ready to be written: CDR bytes at a stamp on a topic."""

    topic: str
    stamp_ns: int
    data: bytes


def _make(type_name: str, **values: Any) -> Any:
    return typestore().types[type_name](**values)


def _bytes(message: Any) -> bytes:
    return bytes(typestore().serialize_cdr(message, message.__msgtype__))


def decode(data: bytes, type_name: str) -> Any:
    """Message object from CDR bytes."""
    return typestore().deserialize_cdr(data, type_name)


def _time(stamp_ns: int) -> Any:
    seconds, nanoseconds = divmod(int(stamp_ns), 1_000_000_000)
    return _make("builtin_interfaces/msg/Time", sec=seconds, nanosec=nanoseconds)


def stamp_of(header: Any) -> int:
    """Nanoseconds of a message's header."""
    return int(header.stamp.sec) * 1_000_000_000 + int(header.stamp.nanosec)


def _header(stamp_ns: int, frame: str) -> Any:
    return _make("std_msgs/msg/Header", stamp=_time(stamp_ns), frame_id=frame)


def _vector(values: Array) -> Any:
    x, y, z = (float(v) for v in values)
    return _make("geometry_msgs/msg/Vector3", x=x, y=y, z=z)


def _quaternion(values: Array) -> Any:
    x, y, z, w = (float(v) for v in values)
    return _make("geometry_msgs/msg/Quaternion", x=x, y=y, z=z, w=w)


def imu_message(sample: ImuSample, gyro_variance: float, accel_variance: float) -> Message:
    """Inertial sample; variances per sample in (rad/s)^2 and (m/s^2)^2. Orientation is marked as absent (REP 145)."""
    absent = np.zeros(9)
    absent[0] = -1.0
    message = _make(
        TYPES[IMU],
        header=_header(sample.stamp_ns, IMU_FRAME),
        orientation=_quaternion(np.array([0.0, 0.0, 0.0, 1.0])),
        orientation_covariance=absent,
        angular_velocity=_vector(sample.gyro),
        angular_velocity_covariance=np.diag([gyro_variance] * 3).ravel(),
        linear_acceleration=_vector(sample.accel),
        linear_acceleration_covariance=np.diag([accel_variance] * 3).ravel(),
    )
    return Message(IMU, sample.stamp_ns, _bytes(message))


def read_imu(data: bytes) -> ImuSample:
    """Inertial sample from its message."""
    message = decode(data, TYPES[IMU])
    rate, force = message.angular_velocity, message.linear_acceleration
    return ImuSample(
        stamp_of(message.header), np.array([rate.x, rate.y, rate.z]), np.array([force.x, force.y, force.z])
    )


def truth_message(stamp_ns: int, position: Array, quaternion: Array, velocity: Array, rate: Array) -> Message:
    """True pose of base_link in map; velocity (m/s) and rate (rad/s) in base_link, as nav_msgs defines."""
    x, y, z = (float(v) for v in position)
    pose = _make(
        "geometry_msgs/msg/Pose",
        position=_make("geometry_msgs/msg/Point", x=x, y=y, z=z),
        orientation=_quaternion(quaternion),
    )
    twist = _make("geometry_msgs/msg/Twist", linear=_vector(velocity), angular=_vector(rate))
    message = _make(
        TYPES[TRUTH],
        header=_header(stamp_ns, MAP),
        child_frame_id=BASE,
        pose=_make("geometry_msgs/msg/PoseWithCovariance", pose=pose, covariance=np.zeros(36)),
        twist=_make("geometry_msgs/msg/TwistWithCovariance", twist=twist, covariance=np.zeros(36)),
    )
    return Message(TRUTH, stamp_ns, _bytes(message))


def read_truth(messages: list[bytes]) -> Trajectory:
    """Trajectory from odometry messages."""
    stamps, positions, quaternions = [], [], []
    for data in messages:
        message = decode(data, TYPES[TRUTH])
        point, turn = message.pose.pose.position, message.pose.pose.orientation
        stamps.append(stamp_of(message.header))
        positions.append([point.x, point.y, point.z])
        quaternions.append([turn.x, turn.y, turn.z, turn.w])
    return Trajectory(
        np.array(stamps, dtype=np.int64), np.array(positions).reshape(-1, 3), np.array(quaternions).reshape(-1, 4)
    )


def static_transforms(stamp_ns: int, frames: Mapping[str, tuple[Array, Array]]) -> Message:
    """Poses in base_link of the rig's frames: name -> (position (3,) m, quaternion (4,))."""
    transforms = [
        _make(
            "geometry_msgs/msg/TransformStamped",
            header=_header(stamp_ns, BASE),
            child_frame_id=frame,
            transform=_make(
                "geometry_msgs/msg/Transform", translation=_vector(position), rotation=_quaternion(quaternion)
            ),
        )
        for frame, (position, quaternion) in frames.items()
    ]
    return Message(TF_STATIC, stamp_ns, _bytes(_make(TYPES[TF_STATIC], transforms=transforms)))


def camera_info(stamp_ns: int, name: str, calibration: CameraCalibration) -> Message:
    """Calibration of a camera, valid for the frame of that stamp."""
    k = calibration.matrix
    message = _make(
        "sensor_msgs/msg/CameraInfo",
        header=_header(stamp_ns, optical_frame(name)),
        height=calibration.height,
        width=calibration.width,
        distortion_model=calibration.distortion_model,
        d=_coefficients(calibration),
        k=k.ravel(),
        r=np.eye(3).ravel(),
        p=np.column_stack([k, np.zeros(3)]).ravel(),
        binning_x=0,
        binning_y=0,
        roi=_make("sensor_msgs/msg/RegionOfInterest", x_offset=0, y_offset=0, height=0, width=0, do_rectify=False),
    )
    return Message(f"/{name}/camera_info", stamp_ns, _bytes(message))


def _coefficients(calibration: CameraCalibration) -> NDArray[np.float64]:
    """Distortion coefficients, as many as the model has in CameraInfo."""
    n = 4 if calibration.distortion_model == "equidistant" else 5
    return np.pad(calibration.distortion, (0, n - len(calibration.distortion)))


def colour_message(stamp_ns: int, camera: str, pixels: NDArray[np.uint8], quality: int) -> Message:
    """(H, W, 3) uint8 RGB as JPEG."""
    done, jpeg = cv2.imencode(".jpg", cv2.cvtColor(pixels, cv2.COLOR_RGB2BGR), [cv2.IMWRITE_JPEG_QUALITY, quality])
    if not done:
        raise SequenceError(f"{camera}: the frame at {stamp_ns} could not be encoded as JPEG")
    message = _make(COLOUR, header=_header(stamp_ns, optical_frame(camera)), format="jpeg", data=jpeg.ravel())
    return Message(f"/{camera}/image", stamp_ns, _bytes(message))


def read_colour(data: bytes) -> tuple[int, NDArray[Any]]:
    """Stamp and (H, W, 3) uint8 RGB from a compressed image."""
    message = decode(data, COLOUR)
    pixels = cv2.imdecode(np.asarray(message.data), cv2.IMREAD_COLOR_RGB)
    if pixels is None:
        raise SequenceError(f"the frame at {stamp_of(message.header)} is not a readable image")
    return stamp_of(message.header), pixels


def layer_message(stamp_ns: int, camera: str, layer: str, pixels: NDArray[Any]) -> Message:
    """A layer's image, in the units of `Image`; depth is rounded to mm."""
    if layer == "depth":
        pixels = np.rint(np.clip(pixels, 0.0, 65.535) * 1000.0)
    kind, numbers = PIXELS[LAYERS[layer]]
    pixels = np.ascontiguousarray(pixels, dtype=kind)
    height, width = pixels.shape[:2]
    message = _make(
        LAYER,
        header=_header(stamp_ns, optical_frame(camera)),
        height=height,
        width=width,
        encoding=LAYERS[layer],
        is_bigendian=0,
        step=width * numbers * pixels.itemsize,
        data=pixels.view(np.uint8).ravel(),
    )
    return Message(f"/{camera}/{layer}", stamp_ns, _bytes(message))


def read_layer(data: bytes, layer: str) -> tuple[int, NDArray[Any]]:
    """Stamp and pixels of a layer, in the units of `Image`."""
    message = decode(data, LAYER)
    kind, numbers = PIXELS[message.encoding]
    shape = (message.height, message.width) if numbers == 1 else (message.height, message.width, numbers)
    pixels = np.asarray(message.data).view(kind).reshape(shape)
    if layer == "depth":
        return stamp_of(message.header), pixels.astype(np.float32) / np.float32(1000.0)
    return stamp_of(message.header), pixels.astype(np.dtype(kind).newbyteorder("="))
