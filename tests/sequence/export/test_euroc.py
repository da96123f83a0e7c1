"""EuRoC's layout, and what it says of a dive."""

from __future__ import annotations

import shutil
from dataclasses import replace

import numpy as np
import pytest
import yaml
from evo.tools import file_interface
from scipy.spatial.transform import Rotation

import oysterbench
from oysterbench.core.errors import SequenceError
from oysterbench.core.geometry import invert
from oysterbench.sequence.export import export_sequence
from oysterbench.sequence.export.readme import camera_lines, write_readme
from oysterbench.sequence.types import imu_arrays
from tests.helpers import hand_made_dive as dive

T_BASE_IMU = np.array(dive.calibration()["imu"]["T_base_imu"])


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


def test_euroc_has_its_cameras_in_the_order_of_their_numbers(folders, tmp_path):
    root = tmp_path / "rig" / "mav0"
    shutil.copytree(folders["euroc"] / "mav0", root)
    for number in (2, 10, 9):
        shutil.copytree(root / "cam0", root / f"cam{number}")
    (root / "camera_notes").mkdir()
    assert list(oysterbench.open(tmp_path / "rig").cameras) == ["cam0", "cam1", "cam2", "cam9", "cam10"]


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
    with pytest.raises(SequenceError, match="has no ground truth"):
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


@pytest.mark.parametrize(
    ("lens", "said", "unsaid"),
    [
        ({"distortion": np.zeros(5)}, ("VINS-Fusion: PINHOLE\n", "DSO: RadTan\n", "COLMAP: OPENCV\n"), "undistort"),
        (
            {"distortion": np.array([0.1, 0, 0, 0, 0.2])},
            (
                "VINS-Fusion: PINHOLE_FULL\n",
                "DSO: none, as their",
                "COLMAP: FULL_OPENCV\n",
                "OKVIS2: radialtangential8\n",
            ),
            ": radtan",
        ),
        ({"distortion_model": "equidistant"}, ("Basalt: kb4\n", "COLMAP: OPENCV_FISHEYE\n"), "radtan"),
    ],
)
def test_a_folder_names_the_models_that_a_lens_fits(lens, said, unsaid, sequence, dive_file, tmp_path):
    bent = oysterbench.open(dive_file)
    bent.cameras = {"cam_left": replace(sequence.cameras["cam_left"], **lens)}
    write_readme(bent, tmp_path, "EuRoC/ASL", {"cam0": "cam_left"}, False, [])
    text = (tmp_path / "README.txt").read_text()
    assert [words for words in said if words not in text] == []
    assert unsaid not in text
    assert ("Basalt: pinhole-radtan8\n" in text) == ("distortion_model" not in lens)


@pytest.mark.parametrize(
    ("late_s", "said"),
    [
        (0.0, "its stamps have no time offset, by the given calibration: Kalibr's"),
        (0.03, "its stamps are 0.03 s late, by the given"),
        (-0.03, "its stamps are 0.03 s early, by the given"),
    ],
)
def test_a_folder_says_how_late_the_stamps_of_a_camera_are(late_s, said, sequence):
    late = replace(sequence.cameras["cam_left"], time_offset_s=late_s)
    assert any(said in line for line in camera_lines("cam0", "cam_left", late, np.eye(4)))


@pytest.mark.parametrize("form", ["euroc", "kalibr", "kitti", "rosbag", "tum"])
def test_every_layout_says_how_long_a_rolling_shutter_reads(form, sequence, folders, dive_file, tmp_path, monkeypatch):
    rolling = oysterbench.open(dive_file)
    cameras = {name: replace(camera, readout_s=0.024) for name, camera in sequence.cameras.items()}
    monkeypatch.setattr(rolling, "cameras", cameras)
    folder, _ = export_sequence(rolling, form, tmp_path / "out")
    text = (folder / "README.txt").read_text()
    assert "48 rows are read in 0.024 s (readout_s)" in text
    assert "one every 0.0005 s (Kalibr's line_delay); stamps are those of the middle row" in text
    assert "rolling" not in (folders[form] / "README.txt").read_text()
    if form in ("euroc", "kalibr", "rosbag"):
        chain = yaml.safe_load((folder / "camchain-imucam.yaml").read_text())
        assert [camera["line_delay"] for camera in chain.values()] == [0.0005, 0.0005]
        assert "line_delay" not in (folders[form] / "camchain-imucam.yaml").read_text()
    if form == "euroc":
        assert oysterbench.open(folder).cameras["cam0"].readout_s == 0.024
        assert oysterbench.open(folders[form]).cameras["cam0"].readout_s == 0.0


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
