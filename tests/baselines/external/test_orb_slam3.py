"""The adapter to ORB-SLAM3: its settings, and, where it is built, what it reaches."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest

import oysterbench
from oysterbench.core.errors import MethodError
from oysterbench.methods.systems import find_system, split_reference
from oysterbench.methods.systems.building import built
from oysterbench.results.records import read_results
from oysterbench_baselines.external.common.yaml import opencv_matrix, replace_block
from oysterbench_baselines.external.orb_slam3.configure import command, settings
from tests.helpers.command import run
from tests.helpers.launches import launch_of
from tests.helpers.paths import SHARED_DATA

AUTHORS = """%YAML:1.0
File.version: "1.0"
Camera.type: "PinHole"
Camera1.fx: 458.654
Camera1.fy: 457.296
Camera1.cx: 367.215
Camera1.cy: 248.375
Camera1.k1: -0.28340811
Camera1.k2: 0.07395907
Camera1.p1: 0.00019359
Camera1.p2: 1.76187114e-05
Camera.width: 752
Camera.height: 480
Camera.newWidth: 600
Camera.newHeight: 350
Camera.fps: 20
# into the body
IMU.T_b_c1: !!opencv-matrix
   rows: 4
   cols: 4
   dt: f
   data: [1.0, 0.0,
         0.0, 1.0]
IMU.NoiseGyro: 1.7e-4 #1.6968e-04
IMU.NoiseAcc: 2.0000e-3
IMU.GyroWalk: 1.9393e-05
IMU.AccWalk: 3.0000e-03
IMU.Frequency: 200.0
ORBextractor.iniThFAST: 20
"""


@pytest.fixture
def sequence(dive_file):
    return oysterbench.open(dive_file)


def read_back(text, tmp_path):
    (tmp_path / "settings.yaml").write_text(text)
    return cv2.FileStorage(str(tmp_path / "settings.yaml"), cv2.FILE_STORAGE_READ)


def test_the_settings_are_the_authors_with_the_calibration_of_the_sequence(sequence, tmp_path):
    text = settings(AUTHORS, sequence, "mono_inertial", {"iniThFAST": 8, "vocabulary": ""})
    (camera, *_) = sequence.cameras.values()
    found = read_back(text, tmp_path)
    assert found.getNode("Camera1.fx").isReal()  # ORB-SLAM3 ends where it is an integer
    assert found.getNode("Camera1.fx").real() == camera.matrix[0, 0]
    assert found.getNode("IMU.Frequency").isReal()
    assert found.getNode("IMU.NoiseGyro").real() == sequence.imu_calibration.gyro_noise_density
    assert found.getNode("Camera.newWidth").real() == camera.width
    assert found.getNode("ORBextractor.iniThFAST").isInt()
    assert found.getNode("ORBextractor.iniThFAST").real() == 8
    expected = np.linalg.inv(sequence.imu_calibration.T_base_imu) @ camera.T_base_cam
    np.testing.assert_allclose(found.getNode("IMU.T_b_c1").mat(), expected, atol=1e-6)
    keys = {line.partition(":")[0] for line in AUTHORS.splitlines() if line[:1].isalpha()}
    assert {line.partition(":")[0] for line in text.splitlines() if line[:1].isalpha()} == keys
    assert "# into the body" in text


def test_a_third_coefficient_of_distortion_gets_its_key(sequence, tmp_path):
    (name, *_) = sequence.cameras
    bent = replace(sequence.cameras[name], distortion=np.array([0.1, 0.02, 0.0, 0.0, 0.003]))
    sequence.cameras = {name: bent}
    found = read_back(settings(AUTHORS, sequence, "mono_inertial", {}), tmp_path)
    assert found.getNode("Camera1.k3").real() == 0.003


def test_a_fisheye_is_one_of_kannala_and_brandt(sequence, tmp_path):
    bent = {"distortion_model": "equidistant", "distortion": np.array([0.43, 2.4, -6.3, 10.0])}
    sequence.cameras = {name: replace(camera, **bent) for name, camera in sequence.cameras.items()}
    found = read_back(settings(AUTHORS, sequence, "mono_inertial", {}), tmp_path)
    assert found.getNode("Camera.type").string() == "KannalaBrandt8"
    assert [found.getNode(f"Camera1.k{n}").real() for n in (1, 2, 3, 4)] == [0.43, 2.4, -6.3, 10.0]
    assert found.getNode("Camera1.p1").empty()


def test_the_second_camera_stands_where_the_calibration_has_it(sequence, tmp_path):
    keys = ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2")
    other = "".join(f"Camera2.{key}: 0.5\n" for key in keys)
    block = "Stereo.T_c1_c2: !!opencv-matrix\n  rows: 4\n  cols: 4\n  dt: f\n  data: [1.0]\n"
    found = read_back(settings(AUTHORS + other + block, sequence, "stereo_inertial", {}), tmp_path)
    left, right, *_ = sequence.cameras.values()
    assert found.getNode("Camera2.fx").real() == right.matrix[0, 0]
    expected = np.linalg.inv(left.T_base_cam) @ right.T_base_cam  # takes points of the second into the first
    np.testing.assert_allclose(found.getNode("Stereo.T_c1_c2").mat(), expected, atol=1e-6)


def test_it_may_be_told_to_initialise_at_constant_speed(sequence, tmp_path):
    options = split_reference("orb_slam3_stereo_inertial_smooth")[2]
    asked = read_back(settings(AUTHORS, sequence, "mono_inertial", options), tmp_path)
    assert asked.getNode("IMU.fastInit").real() == 1
    options = split_reference("orb_slam3_stereo_inertial")[2]
    assert read_back(settings(AUTHORS, sequence, "mono_inertial", options), tmp_path).getNode("IMU.fastInit").empty()


def test_the_number_of_a_run_is_its_seed_and_another_vocabulary_is_taken(dive_file, tmp_path):
    vocabulary = tmp_path / "ORBvoc.txt"
    vocabulary.touch()
    example = tmp_path / "source" / "Examples" / "Monocular-Inertial" / "EuRoC.yaml"
    example.parent.mkdir(parents=True)
    example.write_text(AUTHORS)
    launch = launch_of(f"orb_slam3_mono_inertial[vocabulary={vocabulary}]", dive_file, tmp_path, number=3)
    (camera, *_) = launch.sequence.cameras.values()
    assert command(launch) == [
        str(tmp_path / "build" / "orb_slam3"),
        "mono_inertial",
        str(tmp_path / "settings.yaml"),
        str(vocabulary),
        str(dive_file),
        str(tmp_path / "trajectory.tum"),
        str(0.0 - camera.time_offset_s),
        "3",
    ]


def test_blocks_that_the_authors_lack_are_named():
    with pytest.raises(MethodError, match="has no block"):
        replace_block(AUTHORS, "Stereo.T_c1_c2", opencv_matrix(np.eye(4)))


def test_its_settings_have_the_keys_of_the_authors_examples(sequence):
    """Where ORB-SLAM3 is built, its source is here."""
    system = find_system("orb_slam3")
    if built(system) is None:
        pytest.skip("ORB-SLAM3 is not built here: oysterbench systems build orb_slam3")
    for mode, folder in (("mono", "Monocular"), ("mono_inertial", "Monocular-Inertial")):
        authors = (system.place / "source" / "Examples" / folder / "EuRoC.yaml").read_text()
        text = settings(authors, sequence, mode, {"nFeatures": 900})
        keys = {line.partition(":")[0] for line in authors.splitlines() if line[:1].isalpha()}
        assert {line.partition(":")[0] for line in text.splitlines() if line[:1].isalpha()} == keys


def test_it_reaches_on_floor_euroc_what_it_reached_elsewhere(tmp_path):
    """11 mm over all frames, says the sequence's own README."""
    floor = SHARED_DATA / "floor-euroc"
    if not floor.is_dir():
        pytest.skip(f"{floor} is absent; OYSTERBENCH_SHARED_DATA names the folder that holds floor-euroc")
    if built(find_system("orb_slam3")) is None:
        pytest.skip("ORB-SLAM3 is not built here: oysterbench systems build orb_slam3")
    done = run("run", "orb_slam3_mono_inertial", "--on", floor, "--align", "se3", "--out", tmp_path)
    assert done.returncode == 0, done.stderr
    (record,) = read_results(tmp_path / "results.json")
    assert record.metrics["ate_rmse_m"] < 0.015
