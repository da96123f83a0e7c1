"""The adapter to Basalt: its configuration, and, where it is built, what it reaches."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import oysterbench
from oysterbench.core.errors import MethodError
from oysterbench.core.geometry import invert, transform
from oysterbench.methods.systems.building import built
from oysterbench.methods.systems.manifest import find_system
from oysterbench.results.records import read_results
from oysterbench_baselines.external.basalt.configure import calibration, configuration
from tests.helpers.command import run
from tests.helpers.paths import SHARED_DATA

AUTHORS = """{
    "value0": {
        "config.optical_flow_type": "frame_to_frame",
        "config.optical_flow_pattern": 51,
        "config.vio_max_kfs": 7,
        "config.vio_obs_std_dev": 0.5
    }
}
"""


@pytest.fixture
def sequence(dive_file):
    return oysterbench.open(dive_file)


def read_back(sequence, cameras):
    return json.loads(calibration(sequence, cameras))["value0"]


def test_the_configuration_is_the_authors_with_the_options():
    found = json.loads(configuration(AUTHORS, {"vio_max_kfs": 9, "vio_obs_std_dev": 2}))["value0"]
    assert found == {
        "config.optical_flow_type": "frame_to_frame",
        "config.optical_flow_pattern": 51,
        "config.vio_max_kfs": 9,
        "config.vio_obs_std_dev": 2.0,
    }
    with pytest.raises(MethodError, match="the authors' configuration has no key 'num_pts'"):
        configuration(AUTHORS, {"num_pts": 90})


def test_the_calibration_is_that_of_the_sequence(sequence):
    (camera, *_), unit = sequence.cameras.values(), sequence.imu_calibration
    found = read_back(sequence, [replace(camera, time_offset_s=0.004)])
    (entry,) = found["T_imu_cam"]
    placed = transform(
        Rotation.from_quat([entry[key] for key in ("qx", "qy", "qz", "qw")]).as_matrix(),
        [entry[key] for key in ("px", "py", "pz")],
    )
    np.testing.assert_allclose(placed, invert(unit.T_base_imu) @ camera.T_base_cam, atol=1e-12)
    assert found["gyro_noise_std"] == [unit.gyro_noise_density] * 3
    assert found["accel_bias_std"] == [unit.accel_random_walk] * 3
    assert found["imu_update_rate"] == unit.rate_hz
    assert found["cam_time_offset_ns"] == -4_000_000  # is added to the stamps of the pictures
    assert found["resolution"] == [[camera.width, camera.height]]


def test_noise_may_be_taken_for_more_than_it_is(sequence):
    (camera, *_) = sequence.cameras.values()
    plain, tripled = (json.loads(calibration(sequence, [camera], factor))["value0"] for factor in (1.0, 3.0))
    for key in ("accel_noise_std", "gyro_noise_std", "accel_bias_std", "gyro_bias_std"):
        assert tripled[key] == [3.0 * value for value in plain[key]]


def test_lenses_keep_their_coefficients(sequence):
    (camera, *_) = sequence.cameras.values()
    bent = replace(camera, distortion=np.array([0.1, 0.02, 0.001, -0.002, 0.003]))
    fisheye = replace(camera, distortion_model="equidistant", distortion=np.array([0.43, 2.4, -6.3, 10.0]))
    first, second = read_back(sequence, [bent, fisheye])["intrinsics"]
    assert first["camera_type"] == "pinhole-radtan8"
    assert first["intrinsics"]["fx"] == camera.matrix[0, 0]
    assert [first["intrinsics"][key] for key in ("k1", "k2", "p1", "p2", "k3")] == list(bent.distortion)
    assert [first["intrinsics"][key] for key in ("k4", "k5", "k6")] == [0.0, 0.0, 0.0]
    assert second["camera_type"] == "kb4"
    assert [second["intrinsics"][f"k{n}"] for n in (1, 2, 3, 4)] == list(fisheye.distortion)
    with pytest.raises(MethodError, match="got thin_prism"):
        read_back(sequence, [replace(camera, distortion_model="thin_prism")])


def test_its_options_are_keys_of_the_authors_configuration():
    """Where Basalt is built, its source is here."""
    system = find_system("basalt")
    if built(system) is None:
        pytest.skip("Basalt is not built here: oysterbench systems build basalt")
    authors = (system.place / "source" / "data" / "euroc_config.json").read_text()
    known = {key.removeprefix("config.") for key in json.loads(authors)["value0"]}
    assert set(system.description.options) - {"noise_factor"} <= known


def test_it_reaches_on_floor_euroc_what_it_reached_elsewhere(tmp_path):
    """58 mm with one camera, says the sequence's own README."""
    floor = SHARED_DATA / "floor-euroc"
    if not floor.is_dir():
        pytest.skip(f"{floor} is absent; OYSTERBENCH_SHARED_DATA names the folder that holds floor-euroc")
    if built(find_system("basalt")) is None:
        pytest.skip("Basalt is not built here: oysterbench systems build basalt")
    done = run("run", "basalt_mono", "--on", floor, "--align", "se3", "--out", tmp_path)
    assert done.returncode == 0, done.stderr
    (record,) = read_results(tmp_path / "results.json")
    assert record.metrics["ate_rmse_m"] < 0.07
