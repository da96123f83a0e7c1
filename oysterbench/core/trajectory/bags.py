"""Trajectories in MCAP files and ROS bags (ROS 1 .bag, ROS 2 folder or .db3): topics of stock messages with poses."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np

from oysterbench.core.errors import OysterbenchError, TrajectoryError
from oysterbench.core.text import in_one_line
from oysterbench.core.trajectory.checks import checked_poses
from oysterbench.core.trajectory.options import ReadOptions
from oysterbench.core.trajectory.poses import Trajectory

MCAP_MAGIC = b"\x89MCAP0\r\n"
BAG_MAGIC = b"#ROSBAG V"
SQLITE_MAGIC = b"SQLite format 3\0"

POSE_TYPES = (
    "geometry_msgs/msg/PoseStamped",
    "geometry_msgs/msg/PoseWithCovarianceStamped",
    "geometry_msgs/msg/TransformStamped",
    "nav_msgs/msg/Odometry",
    "nav_msgs/msg/Path",
    "tf2_msgs/msg/TFMessage",
)
PACKED = re.compile(rb"compression_mode:\s*['\"]?(file|message)", re.IGNORECASE)
"""Metadata entry of a compressed ROS 2 bag, which may decompress to any size."""

LATCHED = "/tf_static"
"""Topic with the static poses of sensors, never a trajectory."""

PoseRow = tuple[int, tuple[float, ...], Any]
"""Stamp in ns, x y z qx qy qz qw, covariance (36,) or None."""


@dataclass(frozen=True)
class Bag:
    """Content of a recording.

    types:    topic -> type of its messages, as `package/msg/Name`
    messages: topic -> its messages, decoded
    """

    types: dict[str, str]
    messages: Callable[[str], Iterator[Any]]


def read_bag(path: Path, options: ReadOptions) -> Trajectory:
    """Read the poses of one topic. Raises TrajectoryError where the choice of it is ambiguous or the file is
    damaged."""
    try:
        trajectory = _read(path, options)
    except (OysterbenchError, KeyboardInterrupt):
        raise
    # The libraries underneath raise whatever damaged bytes lead them to: struct, zlib, sqlite, assertions, lookups.
    except Exception as error:
        raise TrajectoryError(f"{path}: damaged, or not a recording that can be read: {in_one_line(error)}") from None
    return checked_poses(trajectory, path.name, lambda i: f"{path}: message {i + 1}", options)


def _read(path: Path, options: ReadOptions) -> Trajectory:
    bag = _open(path)
    topic, _, frames = (options.topic or "").partition(":")
    topic = topic or _only_topic(bag, path)
    if bag.types.get(topic) not in POSE_TYPES:
        got = f"one of {bag.types[topic]}" if topic in bag.types else "none of that name"
        raise TrajectoryError(f"{path}: expected {topic!r} to be a topic with poses, got {got}; {_offer(bag)}")
    notes = [] if options.topic else [f"{path.name}: the poses are those of its only topic with poses, {topic}"]
    kind = bag.types[topic].rsplit("/", 1)[-1]
    if kind == "TFMessage":
        rows = _transforms(bag.messages(topic), frames, path, topic)
    elif kind == "Path":
        last: Any = None
        count = 0
        for last in bag.messages(topic):  # noqa: B007
            count += 1
        rows = [_pose_row(pose) for pose in last.poses] if last is not None else []
        if count > 1:
            notes.append(f"{path.name}: {topic} holds {count} paths, of which the last is read")
    else:
        rows = [_pose_row(message) for message in bag.messages(topic)]
    if not rows:
        raise TrajectoryError(f"{path}: {topic} holds no pose; {_offer(bag)}")
    if not any(row[0] for row in rows):
        raise TrajectoryError(f"{path}: the headers of {topic} carry no timestamps; write each pose's time into them")
    values = np.array([row[1] for row in rows], dtype=float)
    if options.quaternion == "wxyz":
        values = values[:, [0, 1, 2, 4, 5, 6, 3]]
    return Trajectory(
        np.array([row[0] for row in rows], dtype=np.int64),
        values[:, :3].copy(),
        values[:, 3:].copy(),
        _covariances([row[2] for row in rows]),
        tuple(notes),
    )


def _covariances(given: list[Any]) -> np.ndarray | None:
    """Covariances (N, 6, 6), or None where one is missing."""
    if any(covariance is None for covariance in given):
        return None
    return np.array(given, dtype=float).reshape(-1, 6, 6)


def _stamp(header: Any) -> int:
    return int(header.stamp.sec) * 1_000_000_000 + int(header.stamp.nanosec)


def _numbers(place: Any, turn: Any) -> tuple[float, ...]:
    return (place.x, place.y, place.z, turn.x, turn.y, turn.z, turn.w)


def _pose_row(message: Any) -> PoseRow:
    """Row of a PoseStamped, PoseWithCovarianceStamped, Odometry or TransformStamped."""
    stamp = _stamp(message.header)
    if hasattr(message, "transform"):
        return stamp, _numbers(message.transform.translation, message.transform.rotation), None
    if hasattr(message.pose, "pose"):
        pose = message.pose.pose
        return stamp, _numbers(pose.position, pose.orientation), message.pose.covariance
    return stamp, _numbers(message.pose.position, message.pose.orientation), None


def _transforms(messages: Iterator[Any], frames: str, path: Path, topic: str) -> list[PoseRow]:
    """Rows of one transform of a TF topic; `frames` is `parent.child`, or empty where there is only one."""
    rows: dict[str, list[PoseRow]] = {}
    for message in messages:
        for item in message.transforms:
            name = f"{item.header.frame_id.lstrip('/')}.{item.child_frame_id.lstrip('/')}"
            rows.setdefault(name, []).append(_pose_row(item))
    if frames in rows:
        return rows[frames]
    if len(rows) == 1 and not frames:
        return next(iter(rows.values()))
    offer = ", ".join(f"{topic}:{name}" for name in sorted(rows)[:6]) or "none"
    raise TrajectoryError(
        f"{path}: expected one transform of {topic}, got {frames or len(rows)!r}; choose it with --topic: {offer}"
    )


def _only_topic(bag: Bag, path: Path) -> str:
    found = [topic for topic, kind in bag.types.items() if kind in POSE_TYPES and topic != LATCHED]
    if len(found) != 1:
        raise TrajectoryError(f"{path}: expected one topic with poses, got {len(found)}; {_offer(bag)}")
    return found[0]


def _offer(bag: Bag) -> str:
    found = sorted(topic for topic, kind in bag.types.items() if kind in POSE_TYPES and topic != LATCHED)
    if not found:
        known = ", ".join(kind.rsplit("/", 1)[-1] for kind in POSE_TYPES)
        return f"it has no topic of {known}"
    return f"choose it with --topic: {', '.join(found[:8])}"


def _open(path: Path) -> Bag:
    if path.is_dir():
        parts = sorted(path.glob("*.mcap"))
        return _mcap(parts) if parts else _ros2(path)
    with open(path, "rb") as file:
        magic = file.read(16)
    if magic.startswith(MCAP_MAGIC):
        return _mcap([path])
    if magic.startswith(BAG_MAGIC):
        return _ros1(path)
    if magic.startswith(SQLITE_MAGIC) and path.suffix != ".db3":
        raise TrajectoryError(f"{path}: looks like the database of a ROS 2 bag; rename it to .db3")
    if magic.startswith(SQLITE_MAGIC):
        return _ros2(path)
    raise TrajectoryError(f"{path}: expected an MCAP file or a ROS bag, got neither")


@cache
def _decoder(encoding: str) -> Callable[[bytes, str], Any]:
    """Decoder of messages in `cdr` (ROS 2) or `ros1`."""
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    if encoding == "cdr":
        return get_typestore(Stores.ROS2_JAZZY).deserialize_cdr
    store = get_typestore(Stores.ROS1_NOETIC)
    # This type is missing from the distribution's common packages.
    store.register(get_types_from_msg("geometry_msgs/TransformStamped[] transforms", "tf2_msgs/msg/TFMessage"))
    return store.deserialize_ros1


def _full_name(name: str) -> str:
    """`package/msg/Name` of a type that ROS 1 calls `package/Name`; tf's own message becomes tf2's."""
    package, _, rest = name.partition("/")
    full = name if "/msg/" in name else f"{package}/msg/{rest}"
    return full.replace("tf/msg/tfMessage", "tf2_msgs/msg/TFMessage")


def _mcap(parts: list[Path]) -> Bag:
    """Open the MCAP files of one recording; checksums are checked. Raises TrajectoryError where one has no index."""
    from oysterbench.core.mcap import iter_messages, read_summary

    types: dict[str, str] = {}
    encodings: dict[str, str] = {}
    counts: dict[str, int] = {}
    starts: dict[Path, int] = {}
    for part in parts:
        with open(part, "rb") as file:
            summary = read_summary(file)
        if summary is None or summary.statistics is None:
            raise TrajectoryError(f"{part}: damaged: it has no index; recover it with `mcap recover`")
        starts[part] = summary.statistics.message_start_time
        for key, channel in summary.channels.items():
            if channel.schema_id in summary.schemas:
                types[channel.topic] = _full_name(summary.schemas[channel.schema_id].name)
            encodings[channel.topic] = channel.message_encoding
            counts[channel.topic] = counts.get(channel.topic, 0) + summary.statistics.channel_message_counts.get(key, 0)

    # By name, NAME_10 of a recording in pieces would precede NAME_2.
    parts = sorted(parts, key=lambda part: (starts[part], part))

    def messages(topic: str) -> Iterator[Any]:
        if encodings[topic] not in ("cdr", "ros1"):
            raise TrajectoryError(f"{parts[0]}: expected {topic} in cdr or ros1, got {encodings[topic]!r}")
        decode = _decoder(encodings[topic])
        count = 0
        for part in parts:
            with open(part, "rb") as file:
                summary = read_summary(file)
                assert summary is not None  # it was there a moment ago
                for schema, _, message in iter_messages(file, summary, {topic}):
                    count += 1
                    yield decode(message.data, _full_name(schema.name) if schema else types[topic])
        _check_count(count, counts[topic], parts[0], topic)

    return Bag(types, messages)


def _ros1(path: Path) -> Bag:
    from rosbags.rosbag1 import Reader, reader

    # The library's own decompressors have no size limit.
    reader.decompressors.update({kind: partial(_unpacked, kind) for kind in ("bz2", "lz4")})
    return _rosbags(lambda: Reader(path), path, "ros1")


def _unpacked(compression: str, data: bytes) -> bytes:
    from oysterbench.core.mcap import LARGEST_CHUNK, unpack

    found = unpack(data, compression, LARGEST_CHUNK)
    if len(found) > LARGEST_CHUNK:
        raise ValueError(f"expected chunks of at most {LARGEST_CHUNK >> 20} MiB unpacked, got more")
    return found


def _ros2(path: Path) -> Bag:
    from rosbags.rosbag2 import Reader

    described = path / "metadata.yaml"
    if described.is_file() and PACKED.search(described.read_bytes()):
        raise TrajectoryError(f"{path}: expected a bag that is not compressed; `ros2 bag convert` writes one")
    return _rosbags(lambda: Reader(path), path, "cdr")


def _rosbags(make: Callable[[], Any], path: Path, encoding: str) -> Bag:
    """Open a bag with one of the readers of rosbags, which share an interface."""
    with make() as reader:
        types = {connection.topic: _full_name(connection.msgtype) for connection in reader.connections}

    def messages(topic: str) -> Iterator[Any]:
        decode = _decoder(encoding)
        count = 0
        with make() as reader:
            chosen = [connection for connection in reader.connections if connection.topic == topic]
            for connection, _, data in reader.messages(chosen):
                count += 1
                yield decode(data, _full_name(connection.msgtype))
            _check_count(count, sum(connection.msgcount for connection in chosen), path, topic)

    return Bag(types, messages)


def _check_count(count: int, expected: int, path: Path, topic: str) -> None:
    if count != expected:
        raise TrajectoryError(f"{path}: damaged: its index counts {expected} messages of {topic}, {count} are there")
