"""Samples to messages and back: nothing is lost but what a message has no room for, and the types are stock."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from mcap.reader import make_reader
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_typestore

import oysterbench
from oysterbench.core.ros import EPOCH_NS, stamp_of
from oysterbench.recipe import RigRecipe, parse_split
from oysterbench.sensors.registry import rig_frames, sensor_kinds
from oysterbench.sequence.truth import rig_topics
from tests.helpers import hand_made_dive as dive
from tests.helpers.tiny import TINY_RIG, TINY_SPLIT

EVERY_SENSOR = """
[[sonar]]
name = "fls"
rate_hz = 5.0
cloud = true
[[sonar]]
name = "plain"
rate_hz = 5.0
[[scanner]]
name = "msis"
rate_hz = 20.0
[[altimeter]]
name = "alt"
rate_hz = 5.0
[dvl]
[pressure]
[magnetometer]
"""


def rig_of_every_kind() -> RigRecipe:
    """With one sensor of each kind that there is a file of, named after its block."""
    kinds = [kind for kind in sensor_kinds().values() if not kind.required]
    blocks = [
        f"[{kind.block}]" if kind.single else f'[[{kind.block}]]\nname = "{kind.block}_1"\nrate_hz = 5.0'
        for kind in kinds
    ]
    source = TINY_RIG + "\n".join(blocks) + '\n[[sonar]]\nname = "second"\nrate_hz = 1.0\ncloud = true\n'
    return parse_split(TINY_SPLIT, "tiny.toml", rig_source=source).rig


def same(a, b) -> bool:
    """Whether two samples are equal, NaN and +inf included."""
    left, right = dataclasses.asdict(a), dataclasses.asdict(b)
    return left.keys() == right.keys() and all(
        np.array_equal(left[key], right[key], equal_nan=np.asarray(left[key]).dtype.kind == "f") for key in left
    )


@pytest.fixture(scope="module")
def made():
    return dive.measurements()


@pytest.fixture(scope="module")
def sequence(dive_file):
    return oysterbench.open(dive_file)


def test_every_sample_comes_back_as_it_was(sequence, made):
    read = {
        "imu": sequence.imu(),
        "dvl": sequence.dvl(),
        "pressure": sequence.pressure(),
        "magnetometer": sequence.magnetometer(),
        "ranges": sequence.ranges("alt"),
        "sonar": sequence.sonar("fls"),
        "scans": sequence.scans("msis"),
        "clouds": sequence.clouds("fls"),
    }
    for name, measurements in read.items():
        got, expected = list(measurements), getattr(made, name)
        assert len(got) == len(expected) > 9, name
        for a, b in zip(got, expected, strict=True):
            if name == "clouds" or name == "sonar":
                assert {k: v.dtype for k, v in vars(a).items() if hasattr(v, "dtype")} == {
                    k: v.dtype for k, v in vars(b).items() if hasattr(v, "dtype")
                }
            assert same(a, b), f"{name}: {a} is not {b}"


def test_a_fan_of_other_numbers_is_not_the_same(made):
    """So that the test above can fail."""
    changed = dataclasses.replace(made.sonar[0], pixels=made.sonar[0].pixels + np.uint16(1))
    assert not same(made.sonar[0], changed)


def test_frames_as_png_come_back_bit_by_bit_and_as_jpeg_nearly(sequence, tmp_path):
    jpeg = oysterbench.open(dive.write_dive(tmp_path / "jpeg.mcap", 0.5, "jpeg"))
    for k, (_, t) in enumerate(dive.stamps(10, 0.5)):
        expected = dive.colour(t, "cam_left")
        exact = list(sequence.images("cam_left"))[k].pixels
        lossy = list(jpeg.images("cam_left"))[k].pixels
        assert np.array_equal(exact, expected)
        assert not np.array_equal(lossy, expected)
        assert np.abs(lossy.astype(int) - expected).mean() < 6


def test_rosbags_opens_the_file_with_its_own_types_and_every_message_decodes(dive_file):
    expected = {}
    for message in dive.messages():
        expected[message.topic] = expected.get(message.topic, 0) + 1
    with AnyReader([dive_file]) as reader:
        assert {connection.topic: connection.msgcount for connection in reader.connections} == expected
        decoded = [(c.topic, stamp, reader.deserialize(raw, c.msgtype)) for c, stamp, raw in reader.messages()]
    assert len(decoded) == sum(expected.values())
    times = [stamp for _, stamp, _ in decoded]
    assert times == sorted(times)
    assert min(times) == EPOCH_NS
    for topic, stamp, message in decoded:
        head = message.transforms[0].header if hasattr(message, "transforms") else message.header
        assert stamp_of(head) == stamp, topic


@pytest.mark.parametrize("store", [Stores.ROS2_HUMBLE, Stores.ROS2_JAZZY, Stores.LATEST])
def test_schemas_and_type_hashes_are_those_of_ros(dive_file, store):
    """All but Range, which has no variance in Humble, are one in all releases."""
    types = get_typestore(store)
    with open(dive_file, "rb") as file:
        summary = make_reader(file).get_summary()
    for channel in summary.channels.values():
        name = summary.schemas[channel.schema_id].name
        assert summary.schemas[channel.schema_id].encoding == "ros2msg"
        if name == "sensor_msgs/msg/Range" and store == Stores.ROS2_HUMBLE:
            continue
        assert channel.metadata["topic_type_hash"] == types.hash_rihs01(name), name


def test_only_static_transforms_are_latched(dive_file):
    with open(dive_file, "rb") as file:
        channels = make_reader(file).get_summary().channels.values()
    latched = {c.topic for c in channels if "durability: transient_local" in c.metadata["offered_qos_profiles"]}
    assert latched == {"/tf_static"}
    assert all("reliability: reliable" in c.metadata["offered_qos_profiles"] for c in channels)


def test_frames_follow_rep_103(dive_file):
    with AnyReader([dive_file]) as reader:
        frames = {}
        for connection, _, raw in reader.messages():
            message = reader.deserialize(raw, connection.msgtype)
            if hasattr(message, "header"):
                frames.setdefault(connection.topic, message.header.frame_id)
    assert frames["/imu"] == "imu_link"
    assert {frames[topic] for topic in ("/dvl/velocity", "/dvl/beams", "/dvl/altitude")} == {"dvl_link"}
    assert frames["/pressure"] == "pressure_link"
    assert frames["/magnetometer"] == "magnetometer_link"
    assert frames["/fls/image"] == frames["/fls/cloud"] == "fls_link"
    assert frames["/msis/ping"] == "msis_link"
    assert frames["/alt/range"] == "alt_link"
    assert frames["/cam_left/image"] == frames["/cam_left/depth"] == "cam_left_optical_frame"
    assert frames["/truth/odometry"] == frames["/truth/pose"] == "map"


def test_a_beam_is_the_point_that_it_hits(sequence, dive_file):
    with AnyReader([dive_file]) as reader:
        connection = next(c for c in reader.connections if c.topic == "/dvl/beams")
        _, _, raw = next(reader.messages([connection]))
        cloud = reader.deserialize(raw, connection.msgtype)
    assert [(field.name, field.offset) for field in cloud.fields] == [
        ("x", 0),
        ("y", 4),
        ("z", 8),
        ("range", 12),
        ("velocity", 16),
        ("valid", 20),
    ]
    assert cloud.is_dense
    points = np.frombuffer(cloud.data.tobytes(), "<f4").reshape(4, 6)
    assert np.allclose(points[:, 2], -1.1, atol=1e-6), "1.1 m under the DVL is the bottom"
    assert np.allclose(np.linalg.norm(points[:, :3], axis=1), points[:, 3])


def test_a_rig_has_the_topics_and_frames_of_its_sensors():
    rig = parse_split(TINY_SPLIT, "tiny.toml", rig_source=TINY_RIG + EVERY_SENSOR).rig
    found = rig_topics(rig)
    assert {
        "/tf_static",
        "/tf",
        "/imu",
        "/truth/odometry",
        "/truth/pose",
        "/dvl/velocity",
        "/dvl/beams",
        "/dvl/altitude",
        "/pressure",
        "/magnetometer",
        "/alt/range",
        "/msis/ping",
        "/msis/head",
        "/fls/image",
        "/fls/cloud",
        "/plain/image",
        "/cam_front/image",
        "/cam_front/camera_info",
        "/cam_front/depth",
        "/cam_front/class",
        "/cam_front/instance",
    } == set(found)
    assert found["/fls/cloud"] == "sensor_msgs/msg/PointCloud2"
    assert set(rig_frames(rig)) == {
        "imu_link",
        "dvl_link",
        "pressure_link",
        "magnetometer_link",
        "cam_front_optical_frame",
        "fls_link",
        "plain_link",
        "msis_link",
        "alt_link",
    }
    bare = rig_topics(parse_split(TINY_SPLIT, "tiny.toml", rig_source=TINY_RIG).rig)
    assert not {"/dvl/velocity", "/pressure", "/magnetometer"} & set(bare)
