"""Messages as bytes: CDR of ROS 2's stock types, and what a recorder says about a topic."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import Any

from rosbags.typesys import Stores, get_typestore
from rosbags.typesys.store import Typestore

from oysterbench.core.geometry import Array
from oysterbench.sequence.names import TF_STATIC

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
"""As ROS 2 Jazzy's recorder writes it; the times are its "infinite"."""


@dataclass(frozen=True)
class Message:
    """One message, ready to be written: CDR bytes at a stamp on a topic."""

    topic: str
    stamp_ns: int
    data: bytes


@cache
def typestore() -> Typestore:
    """Message types of ROS 2 Jazzy. Humble has the same, but for Range, which ends there before its variance."""
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


def make(type_name: str, **values: Any) -> Any:
    """Message object of a type."""
    return typestore().types[type_name](**values)


def encode(message: Any) -> bytes:
    """CDR bytes of a message object."""
    return bytes(typestore().serialize_cdr(message, message.__msgtype__))


def decode(data: bytes, type_name: str) -> Any:
    """Message object from CDR bytes."""
    return typestore().deserialize_cdr(data, type_name)


def stamp_of(header: Any) -> int:
    """Nanoseconds of a message's header."""
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
