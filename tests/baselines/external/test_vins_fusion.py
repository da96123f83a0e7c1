"""The adapter to VINS-Fusion: its configuration, and, where it is built, what it reaches."""

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
from oysterbench_baselines.external.vins_fusion.configure import (
    EUROC_NOISE,
    EUROC_RATE_HZ,
    camera_file,
    command,
    configuration,
    number,
)
from tests.helpers.command import run
from tests.helpers.launches import launch_of
from tests.helpers.paths import SHARED_DATA

BLOCK = """body_T_cam{}: !!opencv-matrix
   rows: 4
   cols: 4
   dt: d
   data: [0.0148655429818, -0.999880929698,
           0, 0]

"""
AUTHORS = f"""%YAML:1.0

imu: 1
num_of_cam: 2
output_path: "~/output/"
cam0_calib: "cam0_mei.yaml"
cam1_calib: "cam1_mei.yaml"
image_width: 752
image_height: 480

{BLOCK.format(0)}{BLOCK.format(1)}multiple_thread: 1
max_cnt: 150            # max feature number in feature tracking
show_track: 1           # publish tracking image as topic
max_solver_time: 0.04  # max solver itration time (ms), to guarantee real time
keyframe_parallax: 10.0 # keyframe selection threshold (pixel)
acc_n: 0.1          # accelerometer measurement noise standard deviation.
gyr_n: 0.01         # gyroscope measurement noise standard deviation.
acc_w: 0.001        # accelerometer bias random work noise standard deviation.
gyr_w: 0.0001       # gyroscope bias random work noise standard deviation.
g_norm: 9.81007     # gravity magnitude
td: 0.0                             # initial value of time offset. unit: s.
"""


@pytest.fixture
def sequence(dive_file):
    return oysterbench.open(dive_file)


def read_back(text, path):
    path.write_text(text)
    return cv2.FileStorage(str(path), cv2.FILE_STORAGE_READ)


def test_the_configuration_is_the_authors_with_what_the_sequence_says(sequence, tmp_path):
    cameras = list(sequence.cameras.values())[:2]
    text = configuration(AUTHORS, sequence, cameras, {"max_cnt": 90})
    found = read_back(text, tmp_path / "vins.yaml")
    assert found.getNode("cam0_calib").string() == "cam0.yaml"
    assert found.getNode("max_cnt").real() == 90
    assert found.getNode("keyframe_parallax").real() == 10.0
    assert found.getNode("g_norm").real() == sequence.imu_calibration.gravity
    for index, camera in enumerate(cameras):
        expected = np.linalg.inv(sequence.imu_calibration.T_base_imu) @ camera.T_base_cam
        np.testing.assert_allclose(found.getNode(f"body_T_cam{index}").mat(), expected, atol=1e-12)
    keys = {line.partition(":")[0] for line in AUTHORS.splitlines() if line[:1].isalpha()}
    assert {line.partition(":")[0] for line in text.splitlines() if line[:1].isalpha()} == keys


def test_the_load_of_the_machine_decides_nothing(sequence):
    text = configuration(AUTHORS, sequence, list(sequence.cameras.values())[:2], {})
    assert "max_solver_time: 10.0  # max" in text


@pytest.mark.parametrize(("rate_hz", "threads"), [(10.0, 0), (20.0, 1)])
def test_pictures_are_left_out_only_where_enough_are_left(sequence, rate_hz, threads):
    cameras = [replace(camera, rate_hz=rate_hz) for camera in sequence.cameras.values()][:2]
    assert f"multiple_thread: {threads}\n" in configuration(AUTHORS, sequence, cameras, {})


def test_the_authors_noise_follows_the_inertial_unit_unless_it_is_given(sequence):
    unit = sequence.imu_calibration
    text = configuration(AUTHORS, sequence, list(sequence.cameras.values())[:2], {"gyr_n": 0.004})
    per_sample = (unit.rate_hz / EUROC_RATE_HZ) ** 0.5
    assert number(text, "acc_n") == pytest.approx(0.1 * unit.accel_noise_density / EUROC_NOISE["acc_n"] * per_sample)
    assert "gyr_n: 0.004 " in text


def test_the_authors_noise_is_of_a_sample_so_a_faster_unit_has_more_of_it(sequence):
    unit, cameras, found = sequence.imu_calibration, list(sequence.cameras.values())[:2], []
    for rate_hz in (EUROC_RATE_HZ, 4 * EUROC_RATE_HZ):
        sequence.imu_calibration = replace(unit, rate_hz=rate_hz)
        text = configuration(AUTHORS, sequence, cameras, {})
        found.append([number(text, key) for key in EUROC_NOISE])
    np.testing.assert_allclose(found[1], 2 * np.array(found[0]))


def test_pictures_of_two_sizes_are_refused(sequence):
    first, second = list(sequence.cameras.values())[:2]
    with pytest.raises(MethodError, match=r"one size for all pictures, got .* with \d+ x \d+ and \d+ x 8; run vins_f"):
        configuration(AUTHORS, sequence, [first, replace(second, height=8)], {})


def test_a_camera_has_the_model_of_its_distortion(sequence, tmp_path):
    (camera, *_) = sequence.cameras.values()
    plain = read_back(camera_file(camera), tmp_path / "plain.yaml")
    assert plain.getNode("model_type").string() == "PINHOLE"
    assert plain.getNode("projection_parameters").getNode("fx").real() == camera.matrix[0, 0]
    bent = replace(camera, distortion=np.array([0.1, 0.02, 0.0, 0.0, 0.003]))
    full = read_back(camera_file(bent), tmp_path / "full.yaml")
    assert full.getNode("model_type").string() == "PINHOLE_FULL"
    assert full.getNode("distortion_parameters").getNode("k3").real() == 0.003
    fisheye = replace(camera, distortion_model="equidistant", distortion=np.array([0.43, 2.4, -6.3, 10.0]))
    found = read_back(camera_file(fisheye), tmp_path / "fisheye.yaml")
    projection = found.getNode("projection_parameters")
    assert [projection.getNode(f"k{n}").real() for n in (2, 3, 4, 5)] == [0.43, 2.4, -6.3, 10.0]
    assert projection.getNode("mu").real() == camera.matrix[0, 0]
    with pytest.raises(MethodError, match="expected cameras plumb_bob or equidistant, got rational"):
        camera_file(replace(camera, distortion_model="rational"))


@pytest.mark.parametrize(
    ("method", "count", "example"), [("vins_fusion", 2, "stereo"), ("vins_fusion_mono", 1, "mono")]
)
def test_it_is_given_its_configuration_and_the_folder(dive_file, tmp_path, method, count, example):
    authors = tmp_path / "source" / "config" / "euroc" / f"euroc_{example}_imu_config.yaml"
    authors.parent.mkdir(parents=True)
    authors.write_text(AUTHORS if count == 2 else AUTHORS.replace(BLOCK.format(1), ""))
    launch = launch_of(method, dive_file, tmp_path)
    program, *words = command(launch)
    assert program == str(tmp_path / "build" / "vins_fusion")
    assert words == [str(tmp_path / "vins.yaml"), str(dive_file), str(tmp_path / "trajectory.tum")]
    assert len(list(tmp_path.glob("cam?.yaml"))) == count


def test_its_options_are_keys_of_the_authors_examples(sequence):
    """Where VINS-Fusion is built, its source is here."""
    system = find_system("vins_fusion")
    if built(system) is None:
        pytest.skip("VINS-Fusion is not built here: oysterbench systems build vins_fusion")
    for example, count in (("stereo", 2), ("mono", 1)):
        authors = (system.place / "source" / "config" / "euroc" / f"euroc_{example}_imu_config.yaml").read_text()
        text = configuration(authors, sequence, list(sequence.cameras.values())[:count], {"max_cnt": 90})
        known = {line.partition(":")[0] for line in authors.splitlines() if line[:1].isalpha()}
        assert set(system.description.options) <= known
        assert {line.partition(":")[0] for line in text.splitlines() if line[:1].isalpha()} == known


def test_it_reaches_on_floor_euroc_what_its_page_says(tmp_path):
    floor = SHARED_DATA / "floor-euroc"
    if not floor.is_dir():
        pytest.skip(f"{floor} is absent; OYSTERBENCH_SHARED_DATA names the folder that holds floor-euroc")
    if built(find_system("vins_fusion")) is None:
        pytest.skip("VINS-Fusion is not built here: oysterbench systems build vins_fusion")
    done = run("run", "vins_fusion_mono", "--on", floor, "--out", tmp_path)
    assert done.returncode == 0, done.stderr
    (record,) = read_results(tmp_path / "results.json")
    assert record.metrics["ate_rmse_m"] < 0.02
