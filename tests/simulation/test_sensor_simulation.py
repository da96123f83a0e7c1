"""What a rig with every sensor records: all of it in one file, on the clocks and with the losses asked for."""

from __future__ import annotations

import weakref

import numpy as np
import pytest

import oysterbench
from oysterbench.core.ros import EPOCH_NS
from oysterbench.recipe import load_split, parse_split
from oysterbench.simulation import simulated_sequence
from oysterbench.simulation.generate import generate_split
from oysterbench.simulation.simulated_sequence import build_sequence
from tests.helpers.tiny import TINY_RIG, TINY_SPLIT, make_split

SENSORS = """
[[sonar]]
name = "fan"
rate_hz = 5.0
beams = 32
bins = 64
max_range_m = 4.0
pitch_deg = 30.0
cloud = true

[[scanner]]
name = "scan"
rate_hz = 10.0
bins = 100
max_range_m = 4.0

[[altimeter]]
name = "echo"
rate_hz = 10.0
noise_share = 0.0

[dvl]
rate_hz = 5.0
position_m = [-0.1, 0.0, -0.1]

[pressure]
rate_hz = 20.0
offset_m = 0.0
clock_offset_ms = 12.0

[magnetometer]
rate_hz = 50.0
dropout = 0.3
dropout_burst = 4.0
"""


@pytest.fixture(scope="module")
def split():
    return parse_split(TINY_SPLIT.replace("duration_s = 2.5", "duration_s = 4.0"), "tiny.toml", TINY_RIG + SENSORS)


@pytest.fixture(scope="module")
def path(split, tmp_path_factory):
    return generate_split(split, tmp_path_factory.mktemp("full"))["tiny-01"]


@pytest.fixture(scope="module")
def sequence(path):
    return oysterbench.open(path)


def test_every_sensor_of_the_rig_is_in_the_file(sequence):
    counts = {topic: n for topic, _, n in sequence.contents()}
    lossy = counts.pop("/magnetometer")
    assert 100 < lossy < 180  # of 200
    assert counts == {
        "/tf_static": 1,
        "/imu": 400,
        "/truth/odometry": 200,
        "/truth/pose": 200,
        "/tf": 200,
        "/dvl/velocity": 20,
        "/dvl/beams": 20,
        "/dvl/altitude": 20,
        "/pressure": 80,
        "/echo/range": 40,
        "/scan/ping": 40,
        "/scan/head": 40,
        "/cam_front/image": 40,
        "/cam_front/camera_info": 40,
        "/cam_front/depth": 8,
        "/cam_front/class": 8,
        "/cam_front/instance": 8,
        "/fan/image": 20,
        "/fan/cloud": 20,
    }


def test_what_is_measured_fits_the_truth(sequence):
    truth = sequence.truth()
    poses = truth.matrices @ sequence.dvl_calibration.T_base_sensor
    for sample in sequence.dvl():
        (k,) = np.flatnonzero(truth.stamps_ns == sample.stamp_ns)
        if not 0 < k < len(truth) - 1:
            continue
        step = (truth.stamps_ns[k + 1] - truth.stamps_ns[k - 1]) * 1e-9
        velocity = poses[k, :3, :3].T @ (poses[k + 1, :3, 3] - poses[k - 1, :3, 3]) / step
        np.testing.assert_allclose(sample.velocity, velocity, atol=0.03)  # four sigma
        assert 0.5 < sample.altitude < 1.3
    depths = -truth.at(np.array([s.stamp_ns - 12_000_000 for s in sequence.pressure()])).positions[:, 2]
    calibration = sequence.pressure_calibration
    measured = [(s.pressure - calibration.atmosphere) / (calibration.density * 9.80665) for s in sequence.pressure()]
    np.testing.assert_allclose(measured, depths, atol=0.012)
    assert all(0.4 < sample.range < 1.3 for sample in sequence.ranges("echo"))


def test_a_clock_offset_shifts_stamps_and_nothing_else(sequence):
    stamps = np.array([sample.stamp_ns for sample in sequence.pressure()])
    assert np.array_equal(stamps, EPOCH_NS + 12_000_000 + np.arange(80) * 50_000_000)


def test_the_sonar_sees_the_reef_that_the_camera_sees(sequence):
    cloud = next(sequence.clouds("fan"))
    T_map_sonar = sequence.truth().matrices[0] @ sequence.sonars["fan"].T_base_sensor
    points = cloud.points @ T_map_sonar[:3, :3].T + T_map_sonar[:3, 3]
    assert len(points) > 100
    assert abs(np.median(points[:, 2]) + 3.0) < 0.3  # the bottom lies 3 m deep
    assert set(np.unique(cloud.classes)) <= {1, 2, 3}
    image = next(sequence.sonar("fan"))
    assert image.pixels.shape == (64, 32)
    assert image.pixels.max() > 10 * np.median(image.pixels[:4])


@pytest.mark.slow
def test_the_bytes_do_not_depend_on_the_workers(split, path, tmp_path):
    assert generate_split(split, tmp_path, workers=2)["tiny-01"].read_bytes() == path.read_bytes()


def test_the_rigs_that_come_along_fit_a_split():
    for name in ("bluerov2", "bluerov2-views", "bluerov2-stereo", "bluerov2-full"):
        rig = load_split("slam-mini").source.replace('rig = "bluerov2"', f'rig = "{name}"')
        assert parse_split(rig, "slam-mini.toml").rig.name == name


def test_a_sequence_goes_before_the_next_is_built(monkeypatch):
    split = make_split()
    first = weakref.ref(build_sequence(split, "tiny-01", b"one").world)
    there = []
    real = simulated_sequence.build_world
    monkeypatch.setattr(simulated_sequence, "build_world", lambda *given: there.append(first()) or real(*given))
    build_sequence(split, "tiny-01", b"another")
    assert there == [None], "two at a time would take twice the memory"
