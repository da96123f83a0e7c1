"""The true time offset of a camera, clocks included, for evaluators; and the given one in every export."""

from __future__ import annotations

from itertools import islice

import pytest
import yaml

import oysterbench
from oysterbench.core.ros import EPOCH_NS
from oysterbench.recipe import load_split
from oysterbench.recipe.split import rig_tables
from oysterbench.sequence.export import export_sequence

SPLIT = b"""
[defaults.rig.camera]
clock_offset_ms = 20.0
[[sequence]]
name = "another"
[[sequence]]
name = "hand-made"
rig = { camera = { clock_offset_ms = 60.0 } }
"""


@pytest.fixture
def late(dive_file, monkeypatch):
    """A dive whose cameras are late by 60 ms, which their given calibration does not know."""
    sequence = oysterbench.open(dive_file)
    monkeypatch.setattr(sequence, "attachments", {**sequence.attachments, "split.toml": SPLIT})
    return sequence


def test_the_true_calibration_knows_the_offset_of_the_clock(late, dive_file):
    assert late.cameras["cam_left"].time_offset_s == 0.0
    true = late.truly_calibrated()
    assert {name: camera.time_offset_s for name, camera in true.cameras.items()} == {
        "cam_left": 0.06,
        "cam_right": 0.06,
    }
    assert true.cameras["cam_left"].taken_ns(10**9) == 940_000_000
    without = oysterbench.open(dive_file)  # has no recipe
    assert without.truly_calibrated() is without


def test_the_offset_adds_to_that_of_a_measured_calibration(late, monkeypatch):
    measured = late.attachments["calibration.json"].replace(
        b'"rate_hz": 10.0', b'"rate_hz": 10.0, "time_offset_s": 0.004'
    )
    monkeypatch.setattr(late, "attachments", {**late.attachments, "truth/calibration.json": measured})
    assert late.truly_calibrated().cameras["cam_left"].time_offset_s == 0.064


def test_the_true_time_of_a_repeated_frame_is_that_of_the_image_that_it_shows(dive_file, monkeypatch):
    sequence = oysterbench.open(dive_file)
    first, second = (image.stamp_ns for image in islice(sequence.images("cam_left"), 2))
    rows = f"cam_left,{first},{first}\ncam_left,{second},{first}\n"
    frames = f"camera,stamp_ns,shown_ns\n{rows}".encode()
    monkeypatch.setattr(sequence, "attachments", {**sequence.attachments, "truth/frames.csv": frames})
    true = sequence.truly_calibrated().cameras
    assert true["cam_left"].taken_ns(second) == true["cam_left"].taken_ns(first) == first
    assert true["cam_right"].taken_ns(second) == second
    assert true["cam_left"].rows_taken_ns(second)[0] == first
    assert sequence.for_method().cameras["cam_left"].taken_ns(second) == second


def test_true_times_have_no_jitter(late, monkeypatch):
    jittery = SPLIT.replace(b"clock_offset_ms = 60.0", b"clock_offset_ms = 60.0, clock_jitter_ms = 4.0")
    monkeypatch.setattr(late, "attachments", {**late.attachments, "split.toml": jittery})
    true = late.truly_calibrated().cameras["cam_left"]
    assert (true.time_offset_s, true.time_jitter_s) == (0.06, 0.004)
    assert [true.taken_ns(EPOCH_NS + 360_000_000 + off) - EPOCH_NS for off in (-44_999_999, 0, 12_345)] == [
        300_000_000
    ] * 3


def test_rigs_of_released_recipes_have_the_offsets_of_their_sequences():
    split = load_split("slam-stress")
    for sequence in split.sequence:
        tables = rig_tables(split.source, split.rig_source, sequence.name)
        wanted = {camera.name: camera.clock_offset_ms for camera in split.rig_of(sequence).camera}
        assert {one["name"]: one.get("clock_offset_ms", 0.0) for one in tables["camera"]} == wanted


@pytest.mark.parametrize("truth", [True, False])
@pytest.mark.parametrize("form", ["euroc", "kalibr", "rosbag", "tum"])
def test_every_format_has_the_given_offset_and_with_truth_says_the_true_one(late, tmp_path, form, truth):
    folder, _ = export_sequence(late, form, tmp_path / form, truth)
    text = (folder / "README.txt").read_text()
    assert "timeshift_cam_imu is 0.0" in text
    assert ("in truth they are late by 0.06 s" in text) == truth
    if form != "tum":
        chain = yaml.safe_load((folder / "camchain-imucam.yaml").read_text())
        assert {camera["timeshift_cam_imu"] for camera in chain.values()} == {0.0}


def test_changes_of_what_a_rig_does_not_have_change_nothing():
    split = "[[sequence]]\nname = 'one'\nrig = { lamp = { power = 2.0 }, camera = { rate_hz = 5 } }"
    tables = rig_tables(split, "[[camera]]\nname = 'cam'", "one")
    assert tables == {"camera": [{"name": "cam", "rate_hz": 5}], "lamp": []}
