"""Bags of ROS 1, and cuts of sequence files for ROS 2."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
import yaml
from evo.tools import file_interface
from rosbags.rosbag1 import Reader
from rosbags.typesys import Stores, get_typestore

import oysterbench
from oysterbench.core.errors import SequenceError
from oysterbench.sequence.export import export_sequence
from oysterbench.sequence.types import imu_arrays, is_measured
from tests.helpers import hand_made_dive as dive

T_BASE_IMU = np.array(dive.calibration()["imu"]["T_base_imu"])


def bag_messages(folder):
    """Topic -> messages with the times at which they were recorded."""
    (path,) = folder.glob("*.bag")
    types, found = get_typestore(Stores.ROS1_NOETIC), {}
    with Reader(path) as bag:
        for connection, time_ns, data in bag.messages():
            message = types.deserialize_ros1(data, connection.msgtype)
            found.setdefault(connection.topic, []).append((time_ns, message))
    return found


def test_a_bag_has_the_topics_of_eurocs_and_gives_back_stamps_samples_and_grey_images(sequence, folders):
    found = bag_messages(folders["rosbag"])
    assert set(found) == {"/cam0/image_raw", "/cam1/image_raw", "/imu0", "/groundtruth"}
    for topic, name in (("/cam0/image_raw", "cam_left"), ("/cam1/image_raw", "cam_right")):
        images = list(sequence.images(name))
        assert [time for time, _ in found[topic]] == [image.stamp_ns for image in images]
        for k, ((time, message), image) in enumerate(zip(found[topic], images, strict=True)):
            assert (message.encoding, message.step, message.header.seq) == ("mono8", message.width, k)
            assert message.header.stamp.sec * 10**9 + message.header.stamp.nanosec == time
            grey = message.data.reshape(message.height, message.width)
            assert np.array_equal(grey, cv2.cvtColor(image.pixels, cv2.COLOR_RGB2GRAY))
    stamps, gyro, accel = imu_arrays(sequence.imu())
    samples = [message for _, message in found["/imu0"]]
    assert [time for time, _ in found["/imu0"]] == list(stamps)
    assert np.array_equal([[getattr(m.angular_velocity, axis) for axis in "xyz"] for m in samples], gyro)
    assert np.array_equal([[getattr(m.linear_acceleration, axis) for axis in "xyz"] for m in samples], accel)
    assert {m.orientation_covariance[0] for m in samples} == {-1.0}


def test_the_truth_of_a_bag_is_the_imus_and_loads_in_evo(sequence, folders):
    (path,) = folders["rosbag"].glob("*.bag")
    with Reader(path) as bag:
        loaded = file_interface.read_bag_trajectory(bag, "/groundtruth")
    poses = sequence.truth().matrices @ T_BASE_IMU
    np.testing.assert_allclose(loaded.positions_xyz, poses[:, :3, 3], atol=1e-12)
    np.testing.assert_allclose(loaded.timestamps, sequence.truth().stamps_ns * 1e-9, atol=1e-6)


def test_kalibrs_files_beside_a_bag_name_its_topics(folders):
    chain = yaml.safe_load((folders["rosbag"] / "camchain-imucam.yaml").read_text())
    unit = yaml.safe_load((folders["rosbag"] / "imu.yaml").read_text())
    named = [chain["cam0"]["rostopic"], chain["cam1"]["rostopic"], unit["rostopic"]]
    assert named == ["/cam0/image_raw", "/cam1/image_raw", "/imu0"]


def test_a_bag_and_a_file_for_ros_2_have_no_truth_where_none_is_asked_for(sequence, dive_file, tmp_path, folders):
    folder, _ = export_sequence(sequence, "rosbag", tmp_path / "ros1", truth=False)
    assert set(bag_messages(folder)) == {"/cam0/image_raw", "/cam1/image_raw", "/imu0"}
    folder, _ = export_sequence(sequence, "mcap", tmp_path / "ros2", truth=False)
    (path,) = folder.iterdir()
    blind = oysterbench.open(path)
    assert path.name == f"{sequence.name}.mcap"
    assert all(is_measured(topic) for topic, _, _ in blind.contents())
    assert set(blind.attachments) <= {"calibration.json", "classes.json"}
    with pytest.raises(SequenceError, match="has no ground truth"):
        blind.truth()
    assert len(list(blind.images("cam_left"))) == 20
    (whole,) = folders["mcap"].iterdir()
    assert whole.read_bytes() == dive_file.read_bytes()


def test_a_folder_is_no_sequence_file_that_could_be_cut(folders, tmp_path):
    with pytest.raises(SequenceError, match="the format mcap needs a sequence file, and this is not one"):
        export_sequence(oysterbench.open(folders["euroc"]), "mcap", tmp_path / "out")
