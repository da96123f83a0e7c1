"""One trajectory in every format that is read, written here without the reader's own writers."""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any

import numpy as np
from mcap.writer import Writer as McapWriter
from rosbags.rosbag1 import Writer as BagWriter
from rosbags.rosbag2 import Writer as FolderWriter
from rosbags.rosbag2.enums import StoragePlugin
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from scipy.spatial.transform import Rotation

from oysterbench.core.streams import stream
from oysterbench.core.trajectory import Trajectory

ROS1 = get_typestore(Stores.ROS1_NOETIC)
ROS2 = get_typestore(Stores.ROS2_JAZZY)


def dive(n: int = 12, covariances: bool = False) -> Trajectory:
    """A short random walk that turns about all axes, 20 Hz, at stamps that no float64 of seconds holds."""
    rng = stream(5, b"", "dive")
    attitudes = Rotation.from_rotvec(np.cumsum(rng.normal(0, 0.1, (n, 3)), axis=0))
    spreads = rng.normal(0, 0.1, (n, 6, 6))
    return Trajectory(
        np.arange(n, dtype=np.int64) * 50_000_000 + 1_700_000_000_123_456_789,
        np.cumsum(rng.normal(0, 0.1, (n, 3)), axis=0),
        attitudes.as_quat(),
        spreads @ spreads.transpose(0, 2, 1) if covariances else None,
    )


def seconds(stamp: int) -> str:
    return f"{stamp // 10**9}.{stamp % 10**9:09d}"


def tum(t: Trajectory) -> bytes:
    rows = zip(t.stamps_ns.tolist(), t.positions.tolist(), t.quaternions.tolist(), strict=True)
    return "".join(f"{seconds(s)} {' '.join(map(repr, (*p, *q)))}\n" for s, p, q in rows).encode()


def euroc(t: Trajectory) -> bytes:
    rows = zip(t.stamps_ns.tolist(), t.positions.tolist(), t.quaternions.tolist(), strict=True)
    head = "#timestamp [ns],p_RS_R_x [m],p_RS_R_y [m],p_RS_R_z [m],q_RS_w [],q_RS_x [],q_RS_y [],q_RS_z [],v_x,b_x\n"
    lines = (f"{s},{','.join(map(repr, (*p, q[3], *q[:3])))},0.5,0.25\n" for s, p, q in rows)
    return (head + "".join(lines)).encode()


def kitti(t: Trajectory) -> bytes:
    return "".join(" ".join(map(repr, m[:3].ravel().tolist())) + "\n" for m in t.matrices).encode()


def csv(t: Trajectory) -> bytes:
    names = ["qw", "qx", "qy", "qz", "z", "y", "x", "speed", "time_s"]
    names += [f"cov_{k}" for k in range(36)] if t.covariances is not None else []
    lines = [",".join(names)]
    for i, (s, (x, y, z), (a, b, c, w)) in enumerate(
        zip(t.stamps_ns.tolist(), t.positions.tolist(), t.quaternions.tolist(), strict=True)
    ):
        cells = [*map(repr, (w, a, b, c, z, y, x)), "fast", seconds(s)]
        cells += map(repr, t.covariances[i].ravel().tolist()) if t.covariances is not None else []
        lines.append(",".join(cells))
    return "\r\n".join(lines).encode()


def npz(t: Trajectory) -> bytes:
    buffer = io.BytesIO()
    more: dict[str, Any] = {} if t.covariances is None else {"covariances": t.covariances}
    np.savez(buffer, stamps_ns=t.stamps_ns, positions=t.positions, quaternions=t.quaternions, **more)
    return buffer.getvalue()


class Messages:
    """Messages of a trajectory in the types of ROS 1 or ROS 2."""

    def __init__(self, trajectory: Trajectory, store=ROS2) -> None:
        self.t, self.store, self.types = trajectory, store, store.types

    def make(self, name: str, **values):
        return self.types[name](**values)

    def header(self, i: int):
        sec, nanosec = divmod(int(self.t.stamps_ns[i]), 10**9)
        stamp = self.make("builtin_interfaces/msg/Time", sec=sec, nanosec=nanosec)
        more = {"seq": i} if self.store is ROS1 else {}
        return self.make("std_msgs/msg/Header", stamp=stamp, frame_id="map", **more)

    def point(self, i: int, kind: str = "Point"):
        x, y, z = self.t.positions[i].tolist()
        return self.make(f"geometry_msgs/msg/{kind}", x=x, y=y, z=z)

    def quaternion(self, i: int):
        x, y, z, w = self.t.quaternions[i].tolist()
        return self.make("geometry_msgs/msg/Quaternion", x=x, y=y, z=z, w=w)

    def pose(self, i: int):
        return self.make("geometry_msgs/msg/Pose", position=self.point(i), orientation=self.quaternion(i))

    def with_covariance(self, i: int):
        covariance = np.zeros(36) if self.t.covariances is None else self.t.covariances[i].ravel()
        return self.make("geometry_msgs/msg/PoseWithCovariance", pose=self.pose(i), covariance=covariance)

    def pose_stamped(self, i: int):
        return self.make("geometry_msgs/msg/PoseStamped", header=self.header(i), pose=self.pose(i))

    def pose_with_covariance(self, i: int):
        name = "geometry_msgs/msg/PoseWithCovarianceStamped"
        return self.make(name, header=self.header(i), pose=self.with_covariance(i))

    def odometry(self, i: int):
        zero = self.make("geometry_msgs/msg/Vector3", x=0.0, y=0.0, z=0.0)
        twist = self.make("geometry_msgs/msg/Twist", linear=zero, angular=zero)
        still = self.make("geometry_msgs/msg/TwistWithCovariance", twist=twist, covariance=np.zeros(36))
        name = "nav_msgs/msg/Odometry"
        pose = self.with_covariance(i)
        return self.make(name, header=self.header(i), child_frame_id="base_link", pose=pose, twist=still)

    def transform(self, i: int, child: str = "base_link"):
        move = self.make(
            "geometry_msgs/msg/Transform", translation=self.point(i, "Vector3"), rotation=self.quaternion(i)
        )
        name = "geometry_msgs/msg/TransformStamped"
        return self.make(name, header=self.header(i), child_frame_id=child, transform=move)

    def tf(self, i: int, *children: str):
        items = [self.transform(i, child) for child in children or ("base_link",)]
        return self.make("tf2_msgs/msg/TFMessage", transforms=items)

    def path(self, n: int):
        poses = [self.pose_stamped(i) for i in range(n)]
        return self.make("nav_msgs/msg/Path", header=self.header(0), poses=poses)


def mcap(t: Trajectory, topics=None, compression=None) -> bytes:
    """An MCAP file; topics: name -> the messages in it, odometry on /odom where none are given."""
    messages = Messages(t)
    topics = topics or {"/odom": [messages.odometry(i) for i in range(len(t))]}
    buffer = io.BytesIO()
    writer = McapWriter(buffer, **({} if compression is None else {"compression": compression}))
    writer.start(profile="ros2")
    for topic, items in topics.items():
        kind = items[0].__msgtype__
        schema = writer.register_schema(kind, "ros2msg", ROS2.generate_msgdef(kind, ros_version=2)[0].encode())
        channel = writer.register_channel(topic, "cdr", schema)
        for i, item in enumerate(items):
            stamp = int(t.stamps_ns[i])
            writer.add_message(channel, stamp, bytes(ROS2.serialize_cdr(item, kind)), stamp)
    writer.finish()
    return buffer.getvalue()


def mcap_of_ros1(t: Trajectory) -> bytes:
    """An MCAP file as it is converted from a ROS 1 bag."""
    messages = Messages(t, ROS1)
    kind = "geometry_msgs/msg/PoseStamped"
    buffer = io.BytesIO()
    writer = McapWriter(buffer)
    writer.start(profile="ros1")
    schema = writer.register_schema("geometry_msgs/PoseStamped", "ros1msg", ROS1.generate_msgdef(kind)[0].encode())
    channel = writer.register_channel("/pose", "ros1", schema)
    for i, stamp in enumerate(t.stamps_ns.tolist()):
        writer.add_message(channel, stamp, bytes(ROS1.serialize_ros1(messages.pose_stamped(i), kind)), stamp)
    writer.finish()
    return buffer.getvalue()


def write_bag1(path: Path, t: Trajectory) -> Path:
    messages = Messages(t, ROS1)
    with BagWriter(path) as writer:
        kind = "geometry_msgs/msg/PoseWithCovarianceStamped"
        connection = writer.add_connection("/pose", kind, typestore=ROS1)
        for i in range(len(t)):
            data = ROS1.serialize_ros1(messages.pose_with_covariance(i), kind)
            writer.write(connection, int(t.stamps_ns[i]), data)
    return path


def write_bag1_tf(path: Path, t: Trajectory, kind: str) -> Path:
    """Transforms on /tf, as `kind`: tf2's message, or that of the first tf, which is the same."""
    store = get_typestore(Stores.ROS1_NOETIC)
    store.register(get_types_from_msg("geometry_msgs/TransformStamped[] transforms", kind))
    messages = Messages(t, ROS1)
    with BagWriter(path) as writer:
        connection = writer.add_connection("/tf", kind, typestore=store)
        for i in range(len(t)):
            message = store.types[kind](transforms=[messages.transform(i)])
            writer.write(connection, int(t.stamps_ns[i]), store.serialize_ros1(message, kind))
    return path


def write_bag2(folder: Path, t: Trajectory, storage: StoragePlugin = StoragePlugin.SQLITE3) -> Path:
    messages = Messages(t)
    with FolderWriter(folder, version=9, storage_plugin=storage) as writer:
        kind = "geometry_msgs/msg/PoseStamped"
        connection = writer.add_connection("/pose", kind, typestore=ROS2)
        for i in range(len(t)):
            writer.write(connection, int(t.stamps_ns[i]), ROS2.serialize_cdr(messages.pose_stamped(i), kind))
    return folder


def assert_same(read: Trajectory, expected: Trajectory, atol: float = 0.0) -> None:
    np.testing.assert_array_equal(read.stamps_ns, expected.stamps_ns)
    assert read.stamps_ns.dtype == np.int64
    np.testing.assert_allclose(read.positions, expected.positions, rtol=0, atol=atol)
    np.testing.assert_allclose(read.quaternions, expected.quaternions, rtol=0, atol=atol)
    assert (read.covariances is None) == (expected.covariances is None)
    if expected.covariances is not None:
        np.testing.assert_array_equal(read.covariances, expected.covariances)


def written(tmp_path, data: bytes, name: str = "poses.dat"):
    path = tmp_path / name
    path.write_bytes(data)
    return path
