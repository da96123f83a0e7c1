"""The adapter to OKVIS2: its configuration, and, where it is built, what it reaches."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest

import oysterbench
from oysterbench.core.errors import MethodError
from oysterbench.methods.systems import find_system
from oysterbench.methods.systems.building import built
from oysterbench.results.records import read_results
from oysterbench_baselines.external.okvis2.configure import command, configuration, replace_nested
from tests.helpers.command import run
from tests.helpers.launches import launch_of
from tests.helpers.paths import SHARED_DATA

AUTHORS = """%YAML:1.0
cameras:
     - {T_SC:
        [ 0.0148, -0.9998,
           0.0, 1.0],
        focal_length: [458.6, 457.2]}

     - {T_SC:
        [ 0.0125, -0.9997,
           0.0, 1.0],
        focal_length: [457.5, 456.1]}


# additional camera parameters
camera_parameters:
    sync_cameras: [0, 1] # the cameras that will be synchronised

imu_parameters:
    use: true
    sigma_g_c: 20.0e-4 # gyro noise density [rad/s/sqrt(Hz)]
    sigma_a_c: 20.0e-3
    sigma_gw_c: 20.0e-5
    sigma_aw_c: 20.0e-3
    g: 9.81007 # gravity
    g0: [ 0.0, 0.0, 0.0 ]
    a0: [ -0.05, 0.09, 0.01 ] # initial accelerometer bias [m/s^2]

frontend_parameters:
    detection_threshold: 38.0 #42.0 # uniformity radius in pixels
    max_num_keypoints: 700
    parallelise_detection: true # Run parallel detect & describe.
    num_matching_threads: 4

estimator_parameters:
    do_final_ba: false # Whether to run a full final BA

output_parameters:
    display_matches: true
    display_overhead: false
"""
OPTIONS = {"noise_factor": 10.0}


@pytest.fixture
def sequence(dive_file):
    return oysterbench.open(dive_file)


def read_back(text, tmp_path):
    (tmp_path / "config.yaml").write_text(text)
    return cv2.FileStorage(str(tmp_path / "config.yaml"), cv2.FILE_STORAGE_READ)


def numbers(node):
    return np.array([node.at(index).real() for index in range(node.size())])


def test_the_file_is_the_authors_with_what_the_sequence_says(sequence, tmp_path):
    cameras = list(sequence.cameras.values())[:2]
    options = {**OPTIONS, "detection_threshold": 30.0, "max_num_keypoints": 900, "do_final_ba": True}
    text = configuration(AUTHORS, sequence, cameras, options)
    found = read_back(text, tmp_path)
    assert found.getNode("cameras").size() == 2
    unit = sequence.imu_calibration
    for index, camera in enumerate(cameras):
        entry = found.getNode("cameras").at(index)
        expected = np.linalg.inv(unit.T_base_imu) @ camera.T_base_cam  # takes points of a camera into the inertial unit
        np.testing.assert_allclose(numbers(entry.getNode("T_SC")).reshape(4, 4), expected, atol=1e-12)
        assert numbers(entry.getNode("focal_length")).tolist() == [camera.matrix[0, 0], camera.matrix[1, 1]]
        assert numbers(entry.getNode("image_dimension")).tolist() == [camera.width, camera.height]
        assert entry.getNode("distortion_type").string() == "radialtangential"
    measured = found.getNode("imu_parameters")
    assert measured.getNode("g").real() == unit.gravity
    assert measured.getNode("sigma_g_c").real() == pytest.approx(10 * unit.gyro_noise_density)
    assert numbers(measured.getNode("a0")).tolist() == [0, 0, 0]
    front = found.getNode("frontend_parameters")
    assert front.getNode("detection_threshold").isReal()  # OKVIS2 ends where it is an integer
    assert front.getNode("detection_threshold").real() == 30
    assert front.getNode("max_num_keypoints").isInt()
    assert front.getNode("num_matching_threads").real() == 1
    assert "parallelise_detection: false # Run parallel" in text
    assert "do_final_ba: true # Whether" in text
    assert "# additional camera parameters" in text


def test_one_camera_is_not_waited_for_by_another(sequence, tmp_path):
    cameras = list(sequence.cameras.values())[:1]
    found = read_back(configuration(AUTHORS, sequence, cameras, OPTIONS), tmp_path)
    assert found.getNode("cameras").size() == 1
    assert numbers(found.getNode("camera_parameters").getNode("sync_cameras")).tolist() == [0]


def test_models_that_it_has_not_are_refused(sequence):
    (camera, *_) = sequence.cameras.values()
    bent = replace(camera, distortion=np.array([0.1, 0.02, 0.0, 0.0, 0.003]))
    with pytest.raises(MethodError, match="expected four coefficients of plumb_bob or equidistant, got 5 of plumb_bob"):
        configuration(AUTHORS, sequence, [bent], OPTIONS)
    fisheye = replace(camera, distortion_model="equidistant", distortion=np.array([0.43, 2.4, -6.3, 10.0]))
    assert "distortion_type: equidistant" in configuration(AUTHORS, sequence, [fisheye], OPTIONS)


def test_keys_that_the_authors_lack_are_named():
    with pytest.raises(MethodError, match="has 0 keys 'octaves'"):
        replace_nested(AUTHORS, {"octaves": 1})


def test_the_offset_of_the_clocks_is_on_its_command_line(dive_file, tmp_path):
    (tmp_path / "source" / "config").mkdir(parents=True)
    (tmp_path / "source" / "config" / "euroc.yaml").write_text(AUTHORS)
    launch = launch_of("okvis2_mono[noise_factor=2.0]", dive_file, tmp_path)
    (camera, *_) = launch.sequence.cameras.values()
    assert command(launch) == [
        str(tmp_path / "build" / "okvis2"),
        str(tmp_path / "config.yaml"),
        str(tmp_path / "source" / "resources"),
        str(dive_file),
        str(tmp_path / "trajectory.tum"),
        str(0.0 - camera.time_offset_s),
    ]


def test_its_options_are_keys_of_the_authors_example():
    """Where OKVIS2 is built, its source is here."""
    system = find_system("okvis2")
    if built(system) is None:
        pytest.skip("OKVIS2 is not built here: oysterbench systems build okvis2")
    authors = (system.place / "source" / "config" / "euroc.yaml").read_text()
    known = {line.partition(":")[0].strip() for line in authors.splitlines() if ":" in line}
    assert set(system.description.options) - {"noise_factor"} <= known


def test_it_reaches_on_floor_euroc_what_others_reach(tmp_path):
    """6.7 to 11 mm over all pictures, says the sequence's own README of OpenVINS and ORB-SLAM3 with its one camera."""
    floor = SHARED_DATA / "floor-euroc"
    if not floor.is_dir():
        pytest.skip(f"{floor} is absent; OYSTERBENCH_SHARED_DATA names the folder that holds floor-euroc")
    if built(find_system("okvis2")) is None:
        pytest.skip("OKVIS2 is not built here: oysterbench systems build okvis2")
    done = run("run", "okvis2_mono", "--on", floor, "--align", "se3", "--out", tmp_path)
    assert done.returncode == 0, done.stderr
    (record,) = read_results(tmp_path / "results.json")
    assert record.metrics["ate_rmse_m"] < 0.006
