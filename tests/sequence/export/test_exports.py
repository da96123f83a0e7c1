"""Exports: what comes back from them is what went in, and other people's programs read them."""

from __future__ import annotations

import json

import cv2
import numpy as np
import pytest
import yaml
from evo.core import metrics, sync
from evo.tools import file_interface
from rosbags.rosbag1 import Reader
from rosbags.typesys import Stores, get_typestore
from scipy.spatial.transform import Rotation

import oysterbench
from oysterbench.core.errors import SequenceError
from oysterbench.core.geometry import invert
from oysterbench.core.trajectory import read_trajectory
from oysterbench.sequence.export import SHARED_FORMATS, export_sequence
from oysterbench.sequence.export.kitti import _projections
from oysterbench.sequence.types import imu_arrays, is_measured
from tests.helpers import hand_made_dive as dive

T_BASE_IMU = np.array(dive.calibration()["imu"]["T_base_imu"])
T_BASE_LEFT = np.array(dive.calibration()["cameras"]["cam_left"]["T_base_cam"])

pytestmark = pytest.mark.filterwarnings("ignore:__array__ implementation:DeprecationWarning")  # of pycocotools


@pytest.fixture(scope="module")
def sequence(dive_file):
    return oysterbench.open(dive_file)


@pytest.fixture(scope="module")
def folders(sequence, tmp_path_factory):
    """Every format, written once."""
    root = tmp_path_factory.mktemp("exports")
    return {form: export_sequence(sequence, form, root / form)[0] for form in SHARED_FORMATS}


def png(path):
    """Pixels as they are in the file; colour as RGB."""
    pixels = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
    return cv2.cvtColor(pixels, cv2.COLOR_BGR2RGB) if pixels.ndim == 3 else pixels


# EuRoC -------------------------------------------------------------------------------------------------------------


def test_euroc_comes_back_equal_in_stamps_samples_images_and_poses(sequence, folders):
    again = oysterbench.open(folders["euroc"])
    for one, other in zip(imu_arrays(sequence.imu()), imu_arrays(again.imu()), strict=True):
        assert np.array_equal(one, other)
    for name, cam in (("cam_left", "cam0"), ("cam_right", "cam1")):
        whole, got = list(sequence.images(name)), list(again.images(cam))
        assert [image.stamp_ns for image in got] == [image.stamp_ns for image in whole]
        assert all(np.array_equal(a.pixels, b.pixels) for a, b in zip(whole, got, strict=True))
        assert len(got) == 20
    truth, back = sequence.truth(), again.truth()
    assert np.array_equal(truth.stamps_ns, back.stamps_ns)
    np.testing.assert_allclose(back.matrices @ invert(T_BASE_IMU), truth.matrices, atol=1e-12)


def test_euroc_keeps_the_calibration_relative_to_the_imu(sequence, folders):
    again = oysterbench.open(folders["euroc"])
    for name, cam in (("cam_left", "cam0"), ("cam_right", "cam1")):
        was, now = sequence.cameras[name], again.cameras[cam]
        np.testing.assert_allclose(T_BASE_IMU @ now.T_base_cam, was.T_base_cam, atol=1e-12)
        assert np.array_equal(was.matrix, now.matrix)
        assert (was.width, was.height, was.rate_hz) == (now.width, now.height, now.rate_hz)
    unit = again.imu_calibration
    assert (unit.gyro_noise_density, unit.accel_random_walk, unit.gravity) == (1e-4, 1e-4, 9.80665)
    for path in folders["euroc"].glob("mav0/*/sensor.yaml"):
        settings = yaml.safe_load(path.read_text())
        assert np.array(settings["T_BS"]["data"]).size == 16, path


def test_euroc_loads_in_evo(sequence, folders):
    loaded = file_interface.read_euroc_csv_trajectory(
        str(folders["euroc"] / "mav0" / "state_groundtruth_estimate0" / "data.csv")
    )
    truth = sequence.truth()
    assert loaded.num_poses == len(truth)
    poses = truth.matrices @ T_BASE_IMU
    np.testing.assert_allclose(loaded.positions_xyz, poses[:, :3, 3], atol=1e-12)
    turns = Rotation.from_quat(loaded.orientations_quat_wxyz[:, [1, 2, 3, 0]]).as_matrix()
    np.testing.assert_allclose(turns, poses[:, :3, :3], atol=1e-12)
    np.testing.assert_allclose(loaded.timestamps, truth.stamps_ns * 1e-9, atol=1e-6)


def test_euroc_velocities_are_those_of_the_imu_in_the_world(folders):
    table = np.genfromtxt(folders["euroc"] / "mav0/state_groundtruth_estimate0/data.csv", delimiter=",", skip_header=1)
    middle = (table[2:, 1:4] - table[:-2, 1:4]) / 0.04
    np.testing.assert_allclose(table[1:-1, 8:11], middle, atol=1e-5)
    assert np.isnan(table[:, 11:17]).all(), "biases are not known"


def test_euroc_without_truth_has_none(sequence, tmp_path):
    folder, _ = export_sequence(sequence, "euroc", tmp_path / "blind", truth=False)
    assert not (folder / "mav0" / "state_groundtruth_estimate0").exists()
    assert len(list((folder / "mav0" / "cam0" / "data").iterdir())) == 20
    with pytest.raises(SequenceError, match="has no truth"):
        oysterbench.open(folder).truth()


def test_what_a_method_is_given_can_be_exported_for_one_that_is_not_ours(sequence, tmp_path):
    folder, _ = export_sequence(sequence.for_method(), "euroc", tmp_path / "blind", truth=False)
    assert len(list(oysterbench.open(folder).imu())) == 200


@pytest.mark.parametrize(
    ("form", "said"),
    [
        ("euroc", ("cam1: cam_right, 64 x 48, 10 Hz", "IMU: 100 Hz", "walk of its bias 1.0e-05", "timeshift_cam_imu")),
        ("tum", ("rgb: cam_left", "Kalibr, OpenVINS: radtan", "T_imu_cam", "no place for a gyroscope")),
        ("kitti", ("image_1: cam_right", "0.120000 m to the right", "whose stamp is 1767225600")),
        ("rosbag", ("/cam0/image_raw: cam_left", "VINS-Fusion: PINHOLE", "OKVIS2: radialtangential")),
    ],
)
def test_a_folder_says_what_its_layout_has_no_place_for(form, said, sequence, folders, tmp_path):
    text = (folders[form] / "README.txt").read_text()
    assert [words for words in said if words not in text] == []
    assert "The truth is in " in text
    blind, _ = export_sequence(sequence, form, tmp_path / "blind", truth=False)
    assert "The truth was left out." in (blind / "README.txt").read_text()


def test_euroc_has_kalibrs_files_for_its_cameras(sequence, folders):
    chain = yaml.safe_load((folders["euroc"] / "camchain-imucam.yaml").read_text())
    for cam in ("cam0", "cam1"):
        settings = yaml.safe_load((folders["euroc"] / "mav0" / cam / "sensor.yaml").read_text())
        T_imu_cam = np.array(settings["T_BS"]["data"]).reshape(4, 4)
        np.testing.assert_allclose(np.array(chain[cam]["T_cam_imu"]) @ T_imu_cam, np.eye(4), atol=1e-12)
        assert chain[cam]["timeshift_cam_imu"] == settings["timeshift_cam_imu"]
        assert chain[cam]["intrinsics"] == settings["intrinsics"]
    unit = yaml.safe_load((folders["euroc"] / "imu.yaml").read_text())
    settings = yaml.safe_load((folders["euroc"] / "mav0" / "imu0" / "sensor.yaml").read_text())
    assert unit["update_rate"] == settings["rate_hz"]
    assert {key: settings[key] for key in unit if key in settings} == {k: v for k, v in unit.items() if k in settings}


# TUM ---------------------------------------------------------------------------------------------------------------


def rows(path):
    return [line.split() for line in path.read_text().splitlines() if not line.startswith("#")]


def test_tum_images_and_depth_are_equal(sequence, folders):
    root = folders["tum"]
    colour, depth = rows(root / "rgb.txt"), rows(root / "depth.txt")
    images, maps = list(sequence.images("cam_left")), list(sequence.layer("cam_left", "depth"))
    assert len(colour) == len(images) == 20
    assert len(depth) == len(maps) == 4
    for (stamp, file), image in zip(colour, images, strict=True):
        assert stamp.replace(".", "") == str(image.stamp_ns)
        assert np.array_equal(png(root / file), image.pixels)
    for (stamp, file), image in zip(depth, maps, strict=True):
        steps = png(root / file)
        assert steps.dtype == np.uint16
        assert stamp.replace(".", "") == str(image.stamp_ns)
        far = image.pixels > 65535 / 5000
        np.testing.assert_allclose(steps[~far] / 5000, image.pixels[~far], atol=1e-6)
        assert not steps[far].any()
        assert (steps > 0).mean() > 0.9


def test_tum_ground_truth_is_the_camera_and_loads_in_evo(sequence, folders):
    path = folders["tum"] / "groundtruth.txt"
    poses = sequence.truth().matrices @ T_BASE_LEFT
    back = read_trajectory(path)
    assert np.array_equal(back.stamps_ns, sequence.truth().stamps_ns)
    np.testing.assert_allclose(back.matrices, poses, atol=1e-9)
    loaded = file_interface.read_tum_trajectory_file(str(path))
    np.testing.assert_allclose(loaded.positions_xyz, poses[:, :3, 3], atol=1e-9)
    pair = sync.associate_trajectories(loaded, loaded)
    error = metrics.APE(metrics.PoseRelation.full_transformation)
    error.process_data(pair)
    assert error.get_statistic(metrics.StatisticsType.max) < 1e-9


def test_tum_accelerometer_is_the_imus(sequence, folders):
    table = rows(folders["tum"] / "accelerometer.txt")
    _, _, accel = imu_arrays(sequence.imu())
    assert np.array_equal(np.array([row[1:] for row in table], dtype=float), accel)


def test_tum_without_truth_has_neither_poses_nor_depth(sequence, tmp_path):
    folder, notes = export_sequence(sequence, "tum", tmp_path / "blind", truth=False)
    assert sorted(path.name for path in folder.iterdir()) == [
        "README.txt",
        "accelerometer.txt",
        "calibration.txt",
        "rgb",
        "rgb.txt",
    ]
    assert any("depth is truth" in note for note in notes)


# KITTI -------------------------------------------------------------------------------------------------------------


def test_kitti_is_a_stereo_pair_with_poses_of_the_left_camera(sequence, folders):
    root = folders["kitti"]
    place = root / "sequences" / "00"
    times = np.loadtxt(place / "times.txt")
    images = list(sequence.images("cam_left"))
    np.testing.assert_allclose(times, np.arange(20) * 0.1, atol=1e-9)
    for index, name in enumerate(("cam_left", "cam_right")):
        files = sorted((place / f"image_{index}").iterdir())
        assert [file.name for file in files] == [f"{k:06d}.png" for k in range(20)]
        whole = list(sequence.images(name))
        assert all(
            np.array_equal(cv2.imread(str(file), cv2.IMREAD_UNCHANGED), cv2.cvtColor(image.pixels, cv2.COLOR_RGB2GRAY))
            for file, image in zip(files, whole, strict=True)
        )
    loaded = file_interface.read_kitti_poses_file(str(root / "poses" / "00.txt"))
    stamps = np.array([image.stamp_ns for image in images])
    poses = sequence.truth().at(stamps[stamps <= sequence.truth().stamps_ns[-1]]).matrices @ T_BASE_LEFT
    np.testing.assert_allclose(np.array(loaded.poses_se3), invert(poses[0]) @ poses, atol=1e-9)
    np.testing.assert_allclose(loaded.poses_se3[0], np.eye(4), atol=1e-12)


def test_kitti_projects_a_point_where_each_camera_sees_it(sequence, folders):
    lines = rows(folders["kitti"] / "sequences" / "00" / "calib.txt")
    assert [line[0] for line in lines] == ["P0:", "P1:", "P2:", "P3:", "Tr:"]
    T_left_base = np.vstack([np.array(lines[4][1:], dtype=float).reshape(3, 4), [0, 0, 0, 1]])
    np.testing.assert_allclose(T_left_base @ T_BASE_LEFT, np.eye(4), atol=1e-9)
    point = np.array([0.1, -0.05, 1.3, 1.0])  # in the left camera's frame
    for line, name in zip(lines, ("cam_left", "cam_right"), strict=False):
        camera = sequence.cameras[name]
        u = np.array(line[1:], dtype=float).reshape(3, 4) @ point
        here = invert(camera.T_base_cam) @ T_BASE_LEFT @ point
        v = camera.matrix @ here[:3]
        np.testing.assert_allclose(u[:2] / u[2], v[:2] / v[2], atol=1e-9)
    baseline = (float(lines[0][4]) - float(lines[1][4])) / float(lines[1][1])
    assert baseline == pytest.approx(0.12)


def test_kitti_opens_in_pykitti(sequence, folders):
    pykitti = pytest.importorskip("pykitti", reason="pykitti is not installed")
    loaded = pykitti.odometry(str(folders["kitti"]), "00")
    assert len(loaded) == len(loaded.cam0_files) == len(loaded.cam1_files) == 20
    assert loaded.calib.b_gray == pytest.approx(0.12)
    np.testing.assert_allclose(loaded.calib.T_cam0_velo @ T_BASE_LEFT, np.eye(4), atol=1e-9)
    np.testing.assert_allclose(loaded.calib.K_cam0, sequence.cameras["cam_left"].matrix)
    assert [time.total_seconds() for time in loaded.timestamps] == pytest.approx(np.arange(20) * 0.1, abs=1e-6)
    assert len(loaded.poses) == len(loaded.cam0_files)
    left, right = next(loaded.gray)
    whole = next(iter(sequence.images("cam_left"))).pixels
    assert np.array_equal(np.array(left), cv2.cvtColor(whole, cv2.COLOR_RGB2GRAY))
    assert right.size == left.size


def test_kitti_has_four_projections_of_a_camera_alone(sequence):
    lines = _projections(sequence, ["cam_left"], sequence.cameras["cam_left"].matrix)
    assert [line[:3] for line in lines] == ["P0:", "P1:", "P2:", "P3:"]
    assert len({line[3:] for line in lines}) == 1


# COCO --------------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def coco(folders):
    api = pytest.importorskip("pycocotools.coco")
    return api.COCO(str(folders["coco"] / "instances.json"))


def test_coco_loads_with_ids_from_1(coco, folders):
    assert sorted(coco.getImgIds()) == [1, 2, 3, 4]
    assert sorted(coco.getAnnIds()) == list(range(1, 9))
    assert {category["name"] for category in coco.loadCats(coco.getCatIds())} >= {"oyster", "stone", "plant"}
    assert min(coco.getCatIds()) == 1
    assert coco.loadCats([2])[0]["name"] == "oyster"
    for image in coco.loadImgs(coco.getImgIds()):
        assert (folders["coco"] / "images" / image["file_name"]).is_file()


def test_coco_polygons_give_back_each_mask(coco, sequence):
    labels = list(sequence.layer("cam_left", "instance"))
    for image, layer in zip(coco.loadImgs(coco.getImgIds()), labels, strict=True):
        assert image["stamp_ns"] == layer.stamp_ns
        found = coco.loadAnns(coco.getAnnIds(imgIds=image["id"]))
        assert {entry["instance"] for entry in found} == {7, 40_000}
        for entry in found:
            mask = layer.pixels == entry["instance"]
            assert np.array_equal(coco.annToMask(entry).astype(bool), mask)
            assert entry["area"] == mask.sum()
            assert entry["iscrowd"] == 0
            assert entry["category_id"] == 2
            assert entry["visibility"] == (0.5 if entry["instance"] == 7 else 1.0)
            y, x = np.nonzero(mask)
            assert entry["bbox"] == [x.min(), y.min(), np.ptp(x) + 1, np.ptp(y) + 1]
        assert len(found[0]["segmentation"]) == 2, "two pieces"


def test_coco_says_which_oysters_are_alive(coco, sequence):
    living = sequence.living()
    found = [one for one in coco.loadAnns(coco.getAnnIds()) if one["instance"] in living]
    assert {one["state"] for one in found} <= {"live", "dead"}
    assert all((one["state"] == "live") == living[one["instance"]] for one in found)
    assert len(found) == (0 if not living else len(coco.getAnnIds()))


def test_coco_images_are_the_frames_of_the_layers(coco, folders, sequence):
    frames = {image.stamp_ns: image.pixels for image in sequence.images("cam_left")}
    for image in coco.loadImgs(coco.getImgIds()):
        assert np.array_equal(png(folders["coco"] / "images" / image["file_name"]), frames[image["stamp_ns"]])


@pytest.mark.parametrize("form", ["coco", "ply"])
def test_what_is_made_of_truth_cannot_be_had_without(sequence, tmp_path, form):
    with pytest.raises(SequenceError, match=r"truth.*no --no-truth, got --no-truth"):
        export_sequence(sequence, form, tmp_path / "out", truth=False)
    assert list(tmp_path.iterdir()) == []


# Kalibr ------------------------------------------------------------------------------------------------------------


def test_kalibr_chains_imu_and_cameras(sequence, folders):
    chain = yaml.safe_load((folders["kalibr"] / "camchain-imucam.yaml").read_text())
    point_imu = np.array([1.0, 0.2, -0.4, 1.0])
    point_base = T_BASE_IMU @ point_imu
    for key, name in (("cam0", "cam_left"), ("cam1", "cam_right")):
        entry = chain[key]
        there = invert(sequence.cameras[name].T_base_cam) @ point_base
        np.testing.assert_allclose(np.array(entry["T_cam_imu"]) @ point_imu, there, atol=1e-12)
        assert entry["intrinsics"] == [60.0, 60.0, 31.5, 23.5]
        assert entry["rostopic"] == f"/{name}/image"
        assert (entry["camera_model"], entry["distortion_model"]) == ("pinhole", "radtan")
    T_right_left = np.array(chain["cam1"]["T_cn_cnm1"])
    np.testing.assert_allclose(T_right_left[:3, 3], [-0.12, 0, 0], atol=1e-12)
    # The IMU's stamps are 1 ms late, the left camera's 4 ms: t_imu = t_cam + shift.
    assert chain["cam0"]["timeshift_cam_imu"] == pytest.approx(-0.003)
    assert chain["cam1"]["timeshift_cam_imu"] == pytest.approx(0.001)
    unit = yaml.safe_load((folders["kalibr"] / "imu.yaml").read_text())
    assert unit == {
        "accelerometer_noise_density": 1e-3,
        "accelerometer_random_walk": 1e-4,
        "gyroscope_noise_density": 1e-4,
        "gyroscope_random_walk": 1e-5,
        "rostopic": "/imu",
        "update_rate": 100.0,
    }


def test_kalibr_without_truth_knows_no_offset_that_was_not_measured(sequence, tmp_path):
    folder, _ = export_sequence(sequence, "kalibr", tmp_path / "blind", truth=False)
    chain = yaml.safe_load((folder / "camchain-imucam.yaml").read_text())
    assert [chain[cam]["timeshift_cam_imu"] for cam in ("cam0", "cam1")] == [0.0, 0.0]


# ROS ---------------------------------------------------------------------------------------------------------------


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
    with pytest.raises(SequenceError, match="has no truth"):
        blind.truth()
    assert len(list(blind.images("cam_left"))) == 20
    (whole,) = folders["mcap"].iterdir()
    assert whole.read_bytes() == dive_file.read_bytes()


def test_a_folder_is_no_sequence_file_that_could_be_cut(folders, tmp_path):
    with pytest.raises(SequenceError, match="the format mcap is cut from a sequence file, and this is none"):
        export_sequence(oysterbench.open(folders["euroc"]), "mcap", tmp_path / "out")


# PLY ---------------------------------------------------------------------------------------------------------------


def vertices(path):
    trimesh = pytest.importorskip("trimesh")
    return trimesh.load(path, process=False)


def test_ply_of_the_level_bottom_is_level(folders):
    cloud = vertices(folders["ply"] / "cam_left.ply")
    near = np.linalg.norm(cloud.vertices[:, :2], axis=1) < 3
    assert near.sum() > 1000
    assert np.abs(cloud.vertices[near, 2] - dive.BOTTOM_Z).max() < 0.003, "depth is rounded to a millimetre"
    raw = cloud.metadata["_ply_raw"]["vertex"]["data"]
    assert set(np.unique(raw["instance"])) == {0, 7, 40_000}
    bright = cloud.colors[:, 0] > 120
    assert np.array_equal(bright, raw["class"] == 2), "oysters are the bright ones"


def test_ply_keeps_one_point_to_a_voxel(folders):
    cloud = vertices(folders["ply"] / "cam_left.ply")
    cells = np.floor(cloud.vertices.astype(np.float64) / 0.01)
    assert len(np.unique(cells, axis=0)) > 0.99 * len(cells)  # float32 moves a few over the edge of their voxel


def test_ply_of_a_sonar_is_its_returns_in_map(sequence, folders):
    raw = vertices(folders["ply"] / "fls.ply").metadata["_ply_raw"]["vertex"]["data"]
    made = dive.measurements()
    clouds = [cloud for cloud in made.clouds if cloud.stamp_ns <= sequence.truth().stamps_ns[-1]]
    mount = np.array(dive.calibration()["sonars"]["fls"]["T_base_sensor"])
    poses = [sequence.truth().at(np.array([cloud.stamp_ns])).matrices[0] @ mount for cloud in clouds]
    expected = np.concatenate([c.points @ T[:3, :3].T + T[:3, 3] for c, T in zip(clouds, poses, strict=True)])
    np.testing.assert_allclose(np.column_stack([raw[axis] for axis in "xyz"]), expected, atol=1e-5)
    assert np.array_equal(raw["instance"], np.concatenate([cloud.instances for cloud in clouds]))


# All ---------------------------------------------------------------------------------------------------------------


def test_nothing_is_overwritten(sequence, tmp_path):
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "mine.txt").write_text("mine")
    with pytest.raises(SequenceError, match="is there already; it was left as it is"):
        export_sequence(sequence, "kalibr", tmp_path / "out")
    assert [path.name for path in (tmp_path / "out").iterdir()] == ["mine.txt"]


def test_an_export_that_fails_leaves_nothing(dive_file, tmp_path):
    data = bytearray(dive_file.read_bytes())
    data[len(data) // 2] ^= 255  # among the images
    damaged = tmp_path / "damaged.mcap"
    damaged.write_bytes(data)
    with pytest.raises(SequenceError, match=r"damaged\.mcap: truncated or damaged"):
        export_sequence(oysterbench.open(damaged), "euroc", tmp_path / "out" / "here")
    assert list((tmp_path / "out").iterdir()) == []


def test_an_unknown_format_is_named(sequence, tmp_path):
    with pytest.raises(SequenceError, match="unknown format 'pcap'; formats: euroc, tum"):
        export_sequence(sequence, "pcap", tmp_path / "out")


def test_the_documents_are_json_and_yaml_of_others(folders):
    document = json.loads((folders["coco"] / "instances.json").read_text())
    assert set(document) == {"info", "licenses", "images", "annotations", "categories"}
