"""The same trajectory from every format that it comes in, to the nanosecond and the last digit."""

from __future__ import annotations

import os
import re
import threading
from dataclasses import replace

import numpy as np
import pytest
from rosbags.rosbag2.enums import StoragePlugin

from oysterbench.core.errors import TrajectoryError
from oysterbench.core.geometry import invert, transform
from oysterbench.core.trajectory import Trajectory, read_times, read_trajectory, write_npz, write_tum
from oysterbench.core.trajectory.frames import ROTATION_BODY_OPTICAL, poses_of_body
from oysterbench.evaluate.slam.diagnose import diagnose
from oysterbench.tracks.slam_options import read_options
from tests.helpers import trajectory_files as files
from tests.helpers.trajectory_files import Messages, assert_same, dive, written


@pytest.mark.parametrize("form", ["tum", "euroc", "csv", "npz", "mcap"])
def test_a_file_is_recognised_by_its_content_whatever_its_name(tmp_path, form):
    assert_same(read_trajectory(written(tmp_path, getattr(files, form)(dive()))), dive())


@pytest.mark.parametrize("form", ["csv", "npz", "mcap"])
def test_covariances_are_read(tmp_path, form):
    expected = dive(covariances=True)
    assert_same(read_trajectory(written(tmp_path, getattr(files, form)(expected))), expected)


def test_the_frame_that_was_estimated_goes_with_the_poses_through_a_file(tmp_path):
    place = transform(ROTATION_BODY_OPTICAL, np.array([0.2, 0.0, -0.1]))
    body = poses_of_body(dive(), place)
    write_npz(tmp_path / "poses.npz", body)
    read = read_trajectory(tmp_path / "poses.npz")
    np.testing.assert_array_equal(read.T_body_estimate, place)
    np.testing.assert_array_equal(read.select(slice(0, 3)).T_body_estimate, place)
    np.testing.assert_array_equal(read.at(read.stamps_ns[2:4]).T_body_estimate, place)
    # From another frame yet, the two follow one another.
    again = read_trajectory(tmp_path / "poses.npz", T_body_estimate=place)
    np.testing.assert_allclose(again.T_body_estimate, place @ place, atol=1e-12)


def test_a_frame_in_a_file_that_is_no_rigid_transform_is_refused(tmp_path):
    write_npz(tmp_path / "poses.npz", replace(dive(), T_body_estimate=2 * np.eye(4)))
    with pytest.raises(TrajectoryError, match=r"poses\.npz: 'T_body_estimate': expected a rigid transform"):
        read_trajectory(tmp_path / "poses.npz")


def test_a_ros_1_bag_is_read(tmp_path):
    expected = dive(covariances=True)
    assert_same(read_trajectory(files.write_bag1(tmp_path / "poses.bag", expected)), expected)


@pytest.mark.parametrize("kind", ["bz2", "lz4"])
def test_a_ros_1_bag_that_unpacks_to_more_than_any_chunk_is_refused(tmp_path, monkeypatch, kind):
    path = tmp_path / "a.bag"
    writer = files.BagWriter(path)
    writer.set_compression(files.BagWriter.CompressionFormat[kind.upper()])
    with writer:
        connection = writer.add_connection("/pose", "geometry_msgs/msg/PoseStamped", typestore=files.ROS1)
        pose = Messages(dive(), files.ROS1).pose_stamped(0)
        stamped = files.ROS1.serialize_ros1(pose, "geometry_msgs/msg/PoseStamped")
        writer.write(connection, 1, stamped)
    assert len(read_trajectory(path)) == 1
    monkeypatch.setattr("oysterbench.core.mcap.LARGEST_CHUNK", 99)
    with pytest.raises(TrajectoryError, match="expected chunks of at most 0 MiB unpacked, got more"):
        read_trajectory(path)


def test_a_compressed_ros_2_bag_is_refused_unread(tmp_path):
    folder = files.write_bag2(tmp_path / "bag", dive())
    described = folder / "metadata.yaml"
    described.write_text(re.sub("compression_mode: .*", "compression_mode: FILE", described.read_text()))
    with pytest.raises(TrajectoryError, match="expected a bag that is not compressed; `ros2 bag convert` writes one"):
        read_trajectory(folder)


@pytest.mark.parametrize("name", ["tf2_msgs/msg/TFMessage", "tf/msg/tfMessage"])
def test_transforms_of_a_ros_1_bag_are_read(tmp_path, name):
    path = files.write_bag1_tf(tmp_path / "tf.bag", dive(), name)
    assert_same(read_trajectory(path), dive())
    assert_same(read_trajectory(path, topic="/tf:map.base_link"), dive())


def test_an_mcap_file_of_ros_1_messages_is_read(tmp_path):
    assert_same(read_trajectory(written(tmp_path, files.mcap_of_ros1(dive()))), dive())


def test_a_real_sequence_has_one_truth_in_two_formats(shared_data):
    folder = shared_data / "floor-euroc"
    if not folder.is_dir():
        pytest.skip(f"{folder} is absent")
    one = read_trajectory(folder / "truth_body.tum")
    other = read_trajectory(folder / "mav0" / "state_groundtruth_estimate0" / "data.csv")
    assert len(one) == 640
    assert one.stamps_ns[:2].tolist() == [1_000_000_000_000, 1_000_050_000_000]
    assert_same(other, one)
    assert diagnose(one, other) == []


@pytest.mark.parametrize("storage", list(StoragePlugin))
def test_a_ros_2_folder_and_the_file_in_it_are_read(tmp_path, storage):
    folder = files.write_bag2(tmp_path / "bag", dive(), storage)
    assert_same(read_trajectory(folder), dive())
    (inside,) = [path for path in folder.iterdir() if path.suffix in (".db3", ".mcap")]
    assert_same(read_trajectory(inside), dive())


@pytest.mark.parametrize("kind", ["pose_stamped", "pose_with_covariance", "odometry", "transform", "tf"])
def test_every_kind_of_message_with_a_pose_is_read(tmp_path, kind):
    messages = Messages(dive())
    topics = {"/where": [getattr(messages, kind)(i) for i in range(len(dive()))]}
    path = written(tmp_path, files.mcap(dive(), topics))
    trajectory = read_trajectory(path)
    assert_same(trajectory, dive())
    assert trajectory.notes == ("poses.dat: the poses are those of its only topic with poses, /where",)


def test_the_last_of_several_paths_is_read(tmp_path):
    messages = Messages(dive())
    path = written(tmp_path, files.mcap(dive(), {"/path": [messages.path(n) for n in range(1, 13)]}))
    trajectory = read_trajectory(path, topic="/path")
    assert_same(trajectory, dive())
    assert trajectory.notes == ("poses.dat: /path holds 12 paths, of which the last is read",)


@pytest.mark.parametrize("kind", ["path", "pose_stamped"])
def test_the_pieces_of_a_split_recording_are_read_in_the_order_of_time(tmp_path, kind):
    """ROS 2 names them NAME_0 to NAME_11: as text, NAME_10 and NAME_11 precede NAME_2."""
    for k in range(len(dive())):
        now = Messages(dive())
        message = now.path(k + 1) if kind == "path" else now.pose_stamped(k)
        written(tmp_path, files.mcap(dive().select(slice(k, k + 1)), {"/where": [message]}), f"rec_{k}.mcap")
    assert_same(read_trajectory(tmp_path), dive())


def test_a_topic_among_several_must_be_chosen(tmp_path):
    messages = Messages(dive())
    other = Messages(dive().select(slice(0, 5)))
    topics = {
        "/a": [messages.odometry(i) for i in range(12)],
        "/b": [other.pose_stamped(i) for i in range(5)],
    }
    path = written(tmp_path, files.mcap(dive(), topics))
    with pytest.raises(TrajectoryError, match="expected one topic with poses, got 2; choose it with --topic: /a, /b"):
        read_trajectory(path)
    assert len(read_trajectory(path, topic="/b")) == 5
    with pytest.raises(TrajectoryError, match="expected '/c' to be a topic with poses, got none of that name"):
        read_trajectory(path, topic="/c")


def test_a_transform_among_several_must_be_chosen(tmp_path):
    messages = Messages(dive())
    topics = {"/tf": [messages.tf(i, "base_link", "camera") for i in range(12)]}
    path = written(tmp_path, files.mcap(dive(), topics))
    with pytest.raises(TrajectoryError, match=r"choose it with --topic: /tf:map.base_link, /tf:map.camera"):
        read_trajectory(path)
    assert_same(read_trajectory(path, topic="/tf:map.base_link"), dive())


def test_covariances_of_zero_are_unknown(tmp_path):
    assert read_trajectory(written(tmp_path, files.mcap(dive()))).covariances is None


def test_messages_without_stamps_are_refused(tmp_path):
    still = Trajectory(np.zeros(12, dtype=np.int64), dive().positions, dive().quaternions)
    topics = {"/odom": [Messages(still).odometry(i) for i in range(12)]}
    with pytest.raises(TrajectoryError, match="carry no timestamps"):
        read_trajectory(written(tmp_path, files.mcap(dive(), topics)))


def test_damage_in_a_checked_mcap_file_is_found(tmp_path):
    data = bytearray(files.mcap(dive()))
    data[len(data) // 3] ^= 4
    with pytest.raises(TrajectoryError, match="damaged"):
        read_trajectory(written(tmp_path, bytes(data)))


def test_kitti_poses_take_the_given_times_one_to_one(tmp_path):
    path = written(tmp_path, files.kitti(dive()))
    lines = "\n".join(files.seconds(stamp) for stamp in dive().stamps_ns.tolist())
    times = read_times(written(tmp_path, lines.encode(), "times.txt"))
    trajectory = read_trajectory(path, times=times)
    assert_same(trajectory, dive(), atol=1e-12)
    assert trajectory.notes == ("poses.dat: its 12 poses carry no timestamps and take the given times one to one",)


def test_times_are_in_the_unit_that_is_named_and_all_in_one(tmp_path):
    path = written(tmp_path, b"0\n100\n200\n", "times.txt")
    assert read_times(path, "ms").tolist() == [0, 10**8, 2 * 10**8]
    given = {"times": path, "time-unit": "ms", "truth-time-unit": "ms"}
    assert read_options(given, path, path)[1].times.tolist() == [0, 10**8, 2 * 10**8]
    mixed = written(tmp_path, b"0\n1\n100000000000000000\n", "mixed.txt")
    with pytest.raises(TrajectoryError, match=r"mixed.txt:3: expected a time in seconds, or nanoseconds .*--time-unit"):
        read_times(mixed)


def test_kitti_poses_without_times_are_refused_with_the_option(tmp_path):
    path = written(tmp_path, files.kitti(dive()))
    with pytest.raises(TrajectoryError, match=r"have no timestamps; write lines of TUM, or .* line \(--times FILE\)"):
        read_trajectory(path)
    with pytest.raises(TrajectoryError, match="expected a time for each of 12 poses, got 3 times"):
        read_trajectory(path, times=np.arange(3))


def test_a_kitti_matrix_that_is_no_rotation_is_refused_with_its_line(tmp_path):
    lines = files.kitti(dive()).decode().splitlines()
    lines[4] = " ".join(["1"] * 12)
    path = written(tmp_path, "\n".join(lines).encode())
    with pytest.raises(TrajectoryError, match=r"poses.dat:5: expected the columns .* to be a rotation matrix"):
        read_trajectory(path, times=dive().stamps_ns)


def test_a_pipe_is_read_whole(tmp_path):
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    data = files.tum(dive(300))
    writer = threading.Thread(target=pipe.write_bytes, args=(data,))
    writer.start()
    assert_same(read_trajectory(pipe), dive(300))
    writer.join()


def test_a_header_that_names_no_pose_is_refused(tmp_path):
    with pytest.raises(TrajectoryError, match="expected a header that names a column for each of t, x, y"):
        read_trajectory(written(tmp_path, b"a,b,c,d,e,f,g,h\n1,1,2,3,0,0,0,1\n"))


def test_an_option_decides_the_format_the_unit_and_the_order(tmp_path):
    path = written(tmp_path, b"1500,1000,2000,3000,0.8,0,0,0.6\n")
    trajectory = read_trajectory(path, format="tum", time_unit="ms", quaternion="wxyz", unit="mm")
    assert trajectory.stamps_ns.tolist() == [1_500_000_000]
    np.testing.assert_array_equal(trajectory.positions, [[1, 2, 3]])
    np.testing.assert_array_equal(trajectory.quaternions, [[0, 0, 0.6, 0.8]])


def test_an_option_that_is_none_of_its_choices_is_refused(tmp_path):
    with pytest.raises(TrajectoryError, match="quaternion: expected one of xyzw, wxyz, got 'zyxw'"):
        read_trajectory(tmp_path, quaternion="zyxw")


def test_an_npz_says_what_is_missing_in_it(tmp_path):
    np.savez(tmp_path / "a.npz", stamps_ns=np.arange(3), positions=np.zeros((3, 3)))
    with pytest.raises(TrajectoryError, match="expected an array 'quaternions', got positions, stamps_ns"):
        read_trajectory(tmp_path / "a.npz")
    np.savez(tmp_path / "b.npz", stamps_ns=np.arange(3), positions=np.zeros((2, 3)), quaternions=np.zeros((3, 4)))
    with pytest.raises(TrajectoryError, match=r"expected 'positions' as numbers \(3, 3\), got float64 \(2, 3\)"):
        read_trajectory(tmp_path / "b.npz")


def test_an_npz_with_objects_runs_no_code(tmp_path):
    np.savez(tmp_path / "a.npz", stamps_ns=np.array([object()]), positions=np.zeros((1, 3)))
    with pytest.raises(TrajectoryError, match=r"not an \.npz of plain arrays"):
        read_trajectory(tmp_path / "a.npz")


def test_float_stamps_of_an_npz_are_said_to_be_rounded(tmp_path):
    t = dive()
    np.savez(
        tmp_path / "a.npz",
        t=np.array([float(files.seconds(s)) for s in t.stamps_ns.tolist()]),
        positions=t.positions,
        quaternions=t.quaternions,
    )
    trajectory = read_trajectory(tmp_path / "a.npz")
    assert np.abs(trajectory.stamps_ns - t.stamps_ns).max() <= 120
    assert trajectory.notes == ("a.npz: 't' is float64, which holds these timestamps to 238 ns only",)


def test_what_is_written_reads_back(tmp_path):
    expected = dive(covariances=True)
    write_npz(tmp_path / "a.npz", expected)
    assert_same(read_trajectory(tmp_path / "a.npz"), expected)
    write_tum(tmp_path / "a.tum", dive())
    assert (tmp_path / "a.tum").read_text().splitlines()[1].startswith("1700000000.123456789 ")
    assert_same(read_trajectory(tmp_path / "a.tum"), dive(), atol=1e-11)


def test_poses_of_a_camera_become_poses_of_the_body(tmp_path):
    place = transform(ROTATION_BODY_OPTICAL, [0.18, 0.02, -0.1])
    camera = dive().matrices @ place
    times = dive().stamps_ns
    lines = "".join(" ".join(map(repr, matrix[:3].ravel().tolist())) + "\n" for matrix in camera)
    body = read_trajectory(written(tmp_path, lines.encode()), times=times, T_body_estimate=place)
    np.testing.assert_allclose(body.matrices, dive().matrices, rtol=0, atol=1e-12)
    turned = read_trajectory(tmp_path / "poses.dat", times=times, frame="optical")
    np.testing.assert_allclose(turned.matrices[:, :3, :3], dive().matrices[:, :3, :3], rtol=0, atol=1e-12)
    np.testing.assert_allclose(turned.positions, camera[:, :3, 3], rtol=0, atol=1e-12)


def test_the_covariance_of_a_lever_arm_is_that_of_drawn_poses():
    rng = np.random.Generator(np.random.Philox(3))
    place = transform(np.eye(3), [0.5, -0.3, 0.8])
    pose = dive(covariances=True).select(slice(4, 5))
    covariance = np.diag([1, 2, 3, 4, 5, 6]) * 1e-6
    pose = Trajectory(pose.stamps_ns, pose.positions, pose.quaternions, covariance[None])
    moved = poses_of_body(pose, place)
    from scipy.spatial.transform import Rotation

    drawn = rng.multivariate_normal(np.zeros(6), covariance, 200_000)
    turns = Rotation.from_rotvec(drawn[:, 3:]) * Rotation.from_quat(pose.quaternions[0])
    places = pose.positions[0] + drawn[:, :3] + turns.apply(invert(place)[:3, 3])
    sample = np.cov(np.column_stack([places, drawn[:, 3:]]).T)
    np.testing.assert_allclose(moved.covariances[0], sample, rtol=0.02, atol=5e-8)


def test_a_matrix_that_is_no_rigid_transform_is_refused(tmp_path):
    with pytest.raises(TrajectoryError, match="expected a rigid transform"):
        read_trajectory(tmp_path, T_body_estimate=2 * np.eye(4))


@pytest.mark.parametrize("wrong", [-1.0, np.nan, np.inf])
def test_where_one_covariance_is_none_all_are_left_out_and_that_is_said(tmp_path, wrong):
    """No score depends on them: the path is as good as one without."""
    bad = dive(covariances=True)
    bad.covariances[3, 2, 2] = wrong
    read = read_trajectory(written(tmp_path, files.mcap(bad)))
    assert read.covariances is None
    assert any("the covariances are left out" in note and "message 4 has the diagonal" in note for note in read.notes)
    np.testing.assert_array_equal(read.positions, bad.positions)


def test_a_covariance_marked_as_unknown_is_none_in_bags_and_in_text(tmp_path):
    """By -1 in its first cell, as in ROS: in one message, or in all lines of what `rostopic echo -p` writes."""
    marked = dive(covariances=True)
    marked.covariances[0, 0, 0] = -1.0
    read = read_trajectory(written(tmp_path, files.mcap(marked)))
    assert read.covariances is None
    assert not any("covariance" in note for note in read.notes)
    names = ["t", "x", "y", "z", "qx", "qy", "qz", "qw", *(f"field.pose.covariance{k}" for k in range(36))]
    line = ",".join(["0,1,2,3,0,0,0,1", *["-1"] * 36])
    read = read_trajectory(written(tmp_path, f"{','.join(names)}\n{line}\n{line.replace('0', '1', 1)}\n".encode()))
    assert len(read) == 2
    assert read.covariances is None
