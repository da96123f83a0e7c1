"""Messages as bytes: CDR of ROS 2's stock types, point clouds, 16-bit images, and a recorder's metadata of a topic."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rosbags.serde import SerdeError
from rosbags.typesys import Stores, get_typestore
from rosbags.typesys.store import Typestore

from oysterbench.core.geometry import Array

MAP, BASE = "map", "base_link"
TF_STATIC = "/tf_static"

IMAGE = "sensor_msgs/msg/Image"
POINTS = "sensor_msgs/msg/PointCloud2"
RANGE = "sensor_msgs/msg/Range"

EPOCH_NS = 1_767_225_600_000_000_000
"""First stamp of every sequence, 2026-01-01T00:00:00Z: readers take a time of zero for an empty chunk."""

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
"""QoS profile as ROS 2 Jazzy's recorder writes it; the times are its "infinite"."""


@dataclass(frozen=True)
class Message:
    """One message, ready to be written: CDR bytes at a stamp on a topic."""

    topic: str
    stamp_ns: int
    data: bytes


@cache
def typestore() -> Typestore:
    """Message types of ROS 2 Jazzy. Humble's are the same, except that its Range lacks the last field, variance."""
    return get_typestore(Stores.ROS2_JAZZY)


def channel_metadata(topic: str, type_name: str) -> dict[str, str]:
    """Metadata that rosbag2 expects of a channel: QoS profile and type hash."""
    latched = topic == TF_STATIC
    qos = QOS.format(depth=1 if latched else 10, durability="transient_local" if latched else "volatile")
    return {
        "offered_qos_profiles": qos,
        "topic_type_hash": typestore().hash_rihs01(type_name),
    }


def schema(type_name: str) -> bytes:
    """Definition of a message type and of all types it refers to, as `ros2msg`."""
    return typestore().generate_msgdef(type_name, ros_version=2)[0].encode()


def make(type_name: str, **values: Any) -> Any:
    """Create a message object of a type."""
    return typestore().types[type_name](**values)


def encode(message: Any) -> bytes:
    """CDR bytes of a message object."""
    return bytes(typestore().serialize_cdr(message, message.__msgtype__))


def decode(data: bytes, type_name: str) -> Any:
    """Decode a message object from CDR bytes. Raises ValueError, struct.error and the like where they hold none."""
    try:
        return typestore().deserialize_cdr(data, type_name)
    except (SerdeError, AssertionError) as error:
        raise ValueError(f"no message {type_name}: {str(error) or 'of another length'}") from None


def stamp_of(header: Any) -> int:
    """Timestamp of a message's header, ns."""
    return int(header.stamp.sec) * 1_000_000_000 + int(header.stamp.nanosec)


def header(stamp_ns: int, frame: str) -> Any:
    """std_msgs/Header."""
    seconds, nanoseconds = divmod(int(stamp_ns), 1_000_000_000)
    time = make("builtin_interfaces/msg/Time", sec=seconds, nanosec=nanoseconds)
    return make("std_msgs/msg/Header", stamp=time, frame_id=frame)


def point(values: Array) -> Any:
    """geometry_msgs/Point from (3,)."""
    x, y, z = (float(v) for v in values)
    return make("geometry_msgs/msg/Point", x=x, y=y, z=z)


def vector(values: Array) -> Any:
    """geometry_msgs/Vector3 from (3,)."""
    x, y, z = (float(v) for v in values)
    return make("geometry_msgs/msg/Vector3", x=x, y=y, z=z)


def quaternion(values: Array) -> Any:
    """geometry_msgs/Quaternion from (4,), x y z w."""
    x, y, z, w = (float(v) for v in values)
    return make("geometry_msgs/msg/Quaternion", x=x, y=y, z=z, w=w)


_DATATYPES = {"i1": 1, "u1": 2, "i2": 3, "u2": 4, "i4": 5, "u4": 6, "f4": 7, "f8": 8}
"""Type of a number -> PointField's constant."""

_KINDS = {code: kind for kind, code in _DATATYPES.items()}


def points_bytes(stamp_ns: int, frame: str, rows: NDArray[Any]) -> bytes:
    """Encode an unordered cloud (height 1) from a structured array (N,), keeping its fields and their offsets."""
    offsets: Any = rows.dtype.fields
    fields = [
        make(
            "sensor_msgs/msg/PointField",
            name=name,
            offset=offsets[name][1],
            datatype=_DATATYPES[rows.dtype[name].str[1:]],
            count=1,
        )
        for name in rows.dtype.names or ()
    ]
    xyz = np.stack([rows[axis] for axis in "xyz"])
    message = make(
        POINTS,
        header=header(stamp_ns, frame),
        height=1,
        width=len(rows),
        fields=fields,
        is_bigendian=False,
        point_step=rows.dtype.itemsize,
        row_step=rows.dtype.itemsize * len(rows),
        data=np.frombuffer(rows.tobytes(), dtype=np.uint8),
        is_dense=bool(np.isfinite(xyz).all()),
    )
    return encode(message)


def point_rows(message: Any) -> NDArray[Any]:
    """Structured array (N,) of a decoded cloud. Raises ValueError where sizes do not match."""
    kind = np.dtype(
        {
            "names": [field.name for field in message.fields],
            "formats": ["<" + _KINDS[field.datatype] for field in message.fields],
            "offsets": [field.offset for field in message.fields],
            "itemsize": message.point_step,
        }
    )
    rows = np.frombuffer(np.asarray(message.data).tobytes(), dtype=kind)
    if len(rows) != message.height * message.width:
        raise ValueError(f"a cloud of {message.height} x {message.width} points holds {len(rows)}")
    return rows


def image_bytes(stamp_ns: int, frame: str, encoding: str, pixels: NDArray[Any]) -> bytes:
    """Encode an Image: pixels (H, W) or (H, W, channels), little-endian, in the type of `encoding`."""
    rows = np.ascontiguousarray(pixels)
    message = make(
        IMAGE,
        header=header(stamp_ns, frame),
        height=rows.shape[0],
        width=rows.shape[1],
        encoding=encoding,
        is_bigendian=0,
        step=rows[0].nbytes if len(rows) else 0,
        data=rows.view(np.uint8).ravel(),
    )
    return encode(message)


def echo_image(stamp_ns: int, frame: str, amplitudes: NDArray[np.uint16]) -> bytes:
    """Encode amplitudes (H, W) of a sonar as a 16-bit image."""
    return image_bytes(stamp_ns, frame, "mono16", np.asarray(amplitudes, dtype="<u2"))


def read_echo_image(data: bytes, sensor: str, shape: tuple[int, int]) -> tuple[int, NDArray[np.uint16]]:
    """Stamp and amplitudes (H, W) of a sonar image. Raises ValueError where it is none, or does not have the shape (H,
    W) that follows from the sonar's calibration."""
    message = decode(data, IMAGE)
    if message.encoding != "mono16":
        raise ValueError(f"expected a sonar's image as mono16, got {message.encoding!r}")
    if (message.height, message.width) != shape:
        raise ValueError(
            f"{sensor}: expected {shape[1]} x {shape[0]} amplitudes, as its calibration says, got {message.width} x "
            f"{message.height}"
        )
    pixels = np.asarray(message.data).view("<u2").reshape(message.height, message.width)
    return stamp_of(message.header), pixels.astype(np.uint16)


ULTRASOUND = 0
"""sensor_msgs/Range's radiation type; the other one is infrared."""


def range_bytes(
    stamp_ns: int, frame: str, reading: float, limits: tuple[float, float], beam_rad: float, variance: float = 0.0
) -> bytes:
    """Encode a Range in m, +inf or NaN without echo (REP 117); limits: minimum and maximum; variance in m^2, 0 if
    unknown."""
    message = make(
        RANGE,
        header=header(stamp_ns, frame),
        radiation_type=ULTRASOUND,
        field_of_view=beam_rad,
        min_range=limits[0],
        max_range=limits[1],
        range=float(reading),
        variance=variance,
    )
    return encode(message)
