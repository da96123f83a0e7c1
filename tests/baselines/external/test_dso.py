"""The adapter to DSO: its camera, and, where it is built, what it reaches."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest

import oysterbench
from oysterbench.core.errors import MethodError
from oysterbench.methods.systems import find_system
from oysterbench.methods.systems.building import built
from oysterbench.results.records import read_results
from oysterbench_baselines.external.dso.configure import camera_file, command
from tests.helpers.command import run
from tests.helpers.launches import launch_of
from tests.helpers.paths import BASELINES, SHARED_DATA


@pytest.fixture
def camera(dive_file):
    found = next(iter(oysterbench.open(dive_file).cameras.values()))
    return replace(found, width=640, height=480, distortion=np.zeros(4), distortion_model="plumb_bob")


def test_a_camera_without_distortion_stays_as_it_is(camera):
    K = camera.matrix
    numbers = " ".join(repr(float(number)) for number in (K[0, 0], K[1, 1], K[0, 2], K[1, 2]))
    assert camera_file(camera) == f"RadTan {numbers} 0.0 0.0 0.0 0.0\n640 480\nnone\n640 480\n"


def test_a_camera_is_undistorted_to_sides_that_can_be_halved(camera):
    text = camera_file(replace(camera, width=752, height=484, distortion=np.array([0.1, 0.02, 0.0, 0.001, 0.0])))
    first, *lines = text.splitlines()
    assert first.startswith("RadTan ")
    assert first.endswith(" 0.1 0.02 0.0 0.001")
    assert lines == ["752 484", "crop", "752 480"]


def test_a_fisheye_is_one_of_kannala_and_brandt(camera):
    bent = replace(camera, distortion_model="equidistant", distortion=np.array([0.43, 2.4, -6.3, 10.0]))
    assert re.match(r"KannalaBrandt .* 0\.43 2\.4 -6\.3 10\.0\n640 480\ncrop\n", camera_file(bent))
    ideal = replace(camera, distortion_model="equidistant", distortion=np.zeros(4))
    assert camera_file(ideal).endswith("\ncrop\n640 480\n")  # equal angles are no pinhole


@pytest.mark.parametrize("bent", [{"distortion_model": "rational"}, {"distortion": np.array([0.1, 0, 0, 0, 0.01])}])
def test_what_its_undistortion_lacks_is_refused(camera, bent):
    with pytest.raises(MethodError, match="expected a camera equidistant or plumb_bob with k1, k2, p1, p2"):
        camera_file(replace(camera, **bent))


def test_it_is_given_its_camera_the_folder_and_the_options(dive_file, tmp_path):
    launch = launch_of("dso[max_frames=9]", dive_file, tmp_path)
    (camera, *_) = launch.sequence.cameras.values()
    assert command(launch) == [
        str(tmp_path / "build" / "dso"),
        str(tmp_path / "camera.txt"),
        str(dive_file),
        str(tmp_path / "trajectory.tum"),
        str(0.0 - camera.time_offset_s),
        "max_frames=9",
    ]


def test_its_options_are_those_that_the_driver_sets():
    driver = (BASELINES / "external" / "dso" / "driver.cpp").read_text()
    assert set(re.findall(r'\{"(\w+)", &dso::setting_', driver)) == set(find_system("dso").description.options)


def test_it_reaches_on_floor_euroc_what_its_page_says(tmp_path):
    floor = SHARED_DATA / "floor-euroc"
    if not floor.is_dir():
        pytest.skip(f"{floor} is absent; OYSTERBENCH_SHARED_DATA names the folder that holds floor-euroc")
    if built(find_system("dso")) is None:
        pytest.skip("DSO is not built here: oysterbench systems build dso")
    done = run("run", "dso", "--on", floor, "--out", tmp_path)
    assert done.returncode == 0, done.stderr
    (record,) = read_results(tmp_path / "results.json")
    assert record.metrics["ate_rmse_m"] < 0.005
