"""A dive whose sensors all have faults: what methods read, and what only the truth knows."""

from __future__ import annotations

import numpy as np
import pytest

import oysterbench
from oysterbench.core.errors import MethodError, RecipeError
from oysterbench.core.ros import EPOCH_NS
from oysterbench.recipe import parse_split
from oysterbench.sequence.cut import cut_public
from oysterbench.sequence.read import FAULTS
from oysterbench.simulation.generate import generate_split
from tests.helpers.tiny import TINY_RIG, TINY_SPLIT
from tests.simulation.test_sensor_simulation import SENSORS

CHANGES = """
calibration = "poor"

[sequence.rig.dvl]
rate_hz = 15.0
min_rate_hz = 2.0
max_range_m = 3.0
invalid = 0.2
outliers = 0.1
outliers_risky = 0.5
low_m = 0.9
latency_ms = 80.0

[sequence.rig.pressure]
drift_m = 0.05

[sequence.rig.magnetometer]
throttle_deg = 20.0

[sequence.rig.imu]
warming_k = 20.0
gyro_bias_per_k = 5e-4
vibration = [{ on = "accel", kind = "thrusters", level = [1.0, 1.0, 1.0], frequency_hz = 58.0 }]

[sequence.rig.sonar]
interference = 0.5
interference_bearing_deg = 0.0
volume_db = -60.0

[sequence.site]
iron = 40
iron_am2 = 50.0
"""


def split(changes: str = CHANGES):
    text = TINY_SPLIT.replace("duration_s = 2.5", "duration_s = 6.0" + changes)
    return parse_split(text, "tiny.toml", TINY_RIG + SENSORS)


@pytest.fixture(scope="module")
def path(tmp_path_factory):
    return generate_split(split(), tmp_path_factory.mktemp("faults"))["tiny-01"]


def test_what_struck_is_in_the_truth_and_fits_what_was_measured(path):
    sequence = oysterbench.open(path)
    faults = sequence.faults()
    by_name = {name: faults[faults["fault"] == name] for name in faults["fault"].unique()}
    assert {"warming_k", "zero_drift_m", "latency_s", "invalid", "outlier_m_s", "iron_deg"} <= set(by_name)
    assert (faults["start_ns"] >= EPOCH_NS).all()
    assert (faults["end_ns"] >= faults["start_ns"]).all()
    assert faults["start_ns"].is_monotonic_increasing
    samples = list(sequence.dvl())
    lost = [sample for sample in samples if not sample.beam_valid.any()]
    struck = by_name["invalid"]
    for sample in lost:  # stamped on arrival, up to 120 ms after the ping
        since = sample.stamp_ns - struck["start_ns"].to_numpy()
        assert ((since > 0) & (sample.stamp_ns - struck["end_ns"].to_numpy() < 121_000_000)).any()
    assert len(lost) > 2
    stamps = np.array([sample.stamp_ns for sample in samples])
    assert (np.diff(stamps) > 0).all()
    assert 4 < len(stamps) / 6.0 < 12  # Hz, between 15 and 2 by its altitude of 0.8 of 3 m
    assert set(by_name["interference_azimuth_deg"]["sensor"]) <= {"fan"}


def test_neither_methods_nor_hidden_splits_show_it(path, tmp_path):
    with pytest.raises(MethodError, match="truth"):
        oysterbench.open(path).for_method().faults()
    with open(tmp_path / "public.mcap", "wb") as file:
        cut_public(path, file)
    assert FAULTS not in oysterbench.open(tmp_path / "public.mcap").attachments


@pytest.mark.slow
def test_the_bytes_are_the_same_for_any_number_of_workers(path, tmp_path):
    assert generate_split(split(), tmp_path, workers=2)["tiny-01"].read_bytes() == path.read_bytes()


def test_sensors_without_faults_have_none(tiny_file):
    sequence = oysterbench.open(tiny_file)
    assert FAULTS not in sequence.attachments
    assert sequence.faults().empty


@pytest.mark.parametrize(
    ("changes", "told"),
    [
        ("dvl = { min_rate_hz = 20.0 }", r"dvl.min_rate_hz': expected at most rate_hz = 5, got 20"),
        ("dvl = { invalid = 0.9 }", r"dvl.invalid': expected 0 to 0.2, got 0.9"),
        ("magnetometer = { throttle_deg = 60.0 }", r"magnetometer.throttle_deg': expected 0 to 25, got 60.0"),
        ("imu = { gyro_bias_per_k = 0.01 }", r"imu.gyro_bias_per_k': expected 0 to 0.002, got 0.01"),
        ("sonar = { interference = 2.0 }", r"sonar.interference': expected 0 to 1, got 2.0"),
    ],
)
def test_faults_past_what_the_sea_does_are_refused(changes, told):
    with pytest.raises(RecipeError, match=told):
        split(f"\nrig = {{ {changes} }}")
