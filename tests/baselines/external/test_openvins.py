"""The adapter to OpenVINS: its configuration, and, where it is built, what it reaches."""

from __future__ import annotations

from copy import copy
from dataclasses import replace

import numpy as np
import pytest

import oysterbench
from oysterbench.core.errors import MethodError
from oysterbench.methods.systems import find_system
from oysterbench.methods.systems.building import built
from oysterbench.methods.systems.manifest import split_reference
from oysterbench.results.records import read_results
from oysterbench_baselines.external.common.yaml import replace_values
from oysterbench_baselines.external.openvins.configure import camera_chain, estimator, imu_chain
from tests.helpers.command import run
from tests.helpers.paths import SHARED_DATA

AUTHORS = """%YAML:1.0 # file type
use_stereo: true # two cameras
max_cameras: 2
gravity_mag: 9.81 # of this place
track_frequency: 21.0
init_dyn_use: false
init_dyn_mle_max_time: 0.05 # s
init_dyn_mle_max_threads: 6
num_pts: 200
histogram_method: "HISTOGRAM" # NONE, HISTOGRAM, CLAHE
"""


@pytest.fixture
def sequence(dive_file):
    return oysterbench.open(dive_file)


def test_the_estimator_file_is_the_authors_with_what_the_sequence_says(sequence):
    (camera, *_) = sequence.cameras
    text = estimator(AUTHORS, sequence, [camera], {"init_dyn_use": True, "histogram_method": "CLAHE", "num_pts": 90})
    assert "use_stereo: false # two cameras" in text
    assert "max_cameras: 1\n" in text
    assert f"gravity_mag: {sequence.imu_calibration.gravity!r} # of this place" in text
    assert f"track_frequency: {sequence.cameras[camera].rate_hz + 1}\n" in text
    assert 'histogram_method: "CLAHE" # NONE' in text
    assert "num_pts: 90\n" in text
    assert "init_dyn_mle_max_time: 5.0 # s" in text  # the load of the machine decides nothing
    assert "init_dyn_mle_max_threads: 1\n" in text
    with pytest.raises(MethodError, match="the authors' configuration has 0 keys 'max_clones'"):
        estimator(AUTHORS, sequence, [camera], {"max_clones": 11})


def test_whole_reals_keep_their_point():
    assert replace_values("a: 1.5 # x\nb: 3\n", {"a": 2, "b": 4}) == "a: 2.0 # x\nb: 4\n"


def test_the_chains_hold_the_calibration(sequence):
    chain = camera_chain(sequence, list(sequence.cameras)[:1])
    (camera, *_) = sequence.cameras.values()
    rows = [line for line in chain.splitlines() if line.startswith("    - [")]
    found = np.array([[float(value) for value in row.partition("[")[2].strip("]").split(",")] for row in rows])
    expected = np.linalg.inv(sequence.imu_calibration.T_base_imu) @ camera.T_base_cam
    np.testing.assert_allclose(found, expected, atol=1e-12)
    assert f"gyroscope_noise_density: {sequence.imu_calibration.gyro_noise_density:.9e}" in imu_chain(sequence)


@pytest.mark.parametrize("bent", [{"distortion_model": "rational"}, {"distortion": np.array([0.1, 0, 0, 0, 0.2])}])
def test_a_lens_that_it_has_no_model_for_is_refused(sequence, bent):
    (name, *_) = sequence.cameras
    other = copy(sequence)
    other.cameras = {name: replace(sequence.cameras[name], **bent)}
    with pytest.raises(MethodError, match=r"OpenVINS: expected four coefficients of plumb_bob or equidistant, got \d"):
        camera_chain(other, [name])


def test_its_keys_are_those_of_the_authors_example():
    """Where OpenVINS is built, its source is here."""
    system = find_system("openvins")
    if built(system) is None:
        pytest.skip("OpenVINS is not built here: oysterbench systems build openvins")
    _, _, options = split_reference("openvins_dynamic")
    authors = (system.place / "source/config/euroc_mav/estimator_config.yaml").read_text()
    known = {line.partition(":")[0] for line in authors.splitlines() if ":" in line and line[:1].isalpha()}
    assert set(options) | set(system.description.options) <= known


def test_it_reaches_on_floor_euroc_what_it_reached_elsewhere(tmp_path):
    """6.7 to 8.8 mm with one camera, says the sequence's own README; calibrated exactly, and at rest when it begins."""
    floor = SHARED_DATA / "floor-euroc"
    if not floor.is_dir():
        pytest.skip(f"{floor} is absent; OYSTERBENCH_SHARED_DATA names the folder that holds floor-euroc")
    if built(find_system("openvins")) is None:
        pytest.skip("OpenVINS is not built here: oysterbench systems build openvins")
    fixed = ",".join(f"calib_cam_{what}=false" for what in ("extrinsics", "intrinsics", "timeoffset"))
    method = f"openvins[init_imu_thresh=0.5,{fixed}]"
    done = run("run", method, "--on", floor, "--align", "se3", "--out", tmp_path)
    assert done.returncode == 0, done.stderr
    (record,) = read_results(tmp_path / "results.json")
    assert record.metrics["ate_rmse_m"] < 0.009
