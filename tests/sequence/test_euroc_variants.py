"""What differs between folders in EuRoC layout from different hands, and what is wrong in some of them."""

from __future__ import annotations

import json
import re
import shutil

import cv2
import numpy as np
import pytest

import oysterbench
from oysterbench.core.errors import SequenceError
from oysterbench.methods.interfaces.slam import write_input
from oysterbench.sequence import describe
from oysterbench.sequence.state import file_digests
from tests.helpers.command import run
from tests.helpers.euroc import FRAMES, SAMPLES, Folder

POSE = """T_BS:
  cols: 4
  rows: 4
  data: [1.0, 0.0, 0.0, 0.1, 0.0, 1.0, 0.0, 0.2,
         0.0, 0.0, 1.0, 0.3, 0.0, 0.0, 0.0, 1.0]
"""
NUMBERS = "1.0, 0, 0, 0.1, 0, 1.0, 0, 0.2, 0, 0, 1.0, 0.3, 0, 0, 0, 1.0"


@pytest.fixture
def folder(tmp_path):
    return Folder(tmp_path / "dive")


# Calibrations


@pytest.mark.parametrize(
    "pose",
    [
        f"T_BS: [{NUMBERS}]",
        "T_BS:\n- [1.0, 0, 0, 0.1]\n- [0, 1.0, 0, 0.2]\n- [0, 0, 1.0, 0.3]\n- [0, 0, 0, 1.0]",
        "T_BS:\n  - [1, 0, 0, 1e-1]\n  - [-0, 1, 0, +0.2]\n  - [0, 0, 1, .3]\n  - [0, 0, 0, 1]",
        "T_BS: [[1, 0, 0, 0.1], [0, 1, 0, 0.2],\n  [0, 0, 1, 0.3], [0, 0, 0, 1]]",
        f"T_BS: !!opencv-matrix\n  rows: 4\n  cols: 4\n  dt: d\n  data: [{NUMBERS}]",
        "T_BS:\n  data:\n    - [1, 0, 0, 0.1]\n    - [0, 1, 0, 0.2]\n    - [0, 0, 1, 0.3]\n    - [0, 0, 0, 1]",
        f"T_BS: {{rows: 4, cols: 4, data: [{NUMBERS}]}}",
        f"T_BS:\n  type: double\n  size: [4, 4]\n  data: [{NUMBERS}]",
        f"T_BS:\nrows: 4\ncols: 4\ndata: [{NUMBERS}]\ncamera.model: pinhole",
        f'T_BS: [{NUMBERS}]\n"comment": the front camera',
        f'T_BS: "{NUMBERS}"\n...',
    ],
)
def test_a_pose_is_read_as_a_matrix_as_a_list_and_by_rows(folder, pose):
    folder.change("cam0/sensor.yaml", POSE, f"{pose}\n")
    matrix = oysterbench.open(folder.path).cameras["cam0"].T_base_cam
    np.testing.assert_array_equal(matrix, [[1, 0, 0, 0.1], [0, 1, 0, 0.2], [0, 0, 1, 0.3], [0, 0, 0, 1]])


def test_an_inertial_unit_may_be_mounted_apart_from_the_body(folder):
    np.testing.assert_array_equal(oysterbench.open(folder.path).imu_calibration.T_base_imu, np.eye(4))
    folder.change("imu0/sensor.yaml", "rate_hz", f"{POSE}rate_hz")
    matrix = oysterbench.open(folder.path).imu_calibration.T_base_imu
    np.testing.assert_array_equal(matrix, [[1, 0, 0, 0.1], [0, 1, 0, 0.2], [0, 0, 1, 0.3], [0, 0, 0, 1]])


@pytest.mark.parametrize(
    ("pose", "message"),
    [
        ("", "missing key 'T_BS'"),
        ("T_BS: [1, 0, 0]\n", "T_BS, data: expected 16 finite numbers, got 3: 1 0 0"),
        (f"T_BS: [{NUMBERS}, 1]\n", "T_BS, data: expected 16 finite numbers, got 17: "),
        (f"T_BS: [{NUMBERS}]\n".replace("0.3", "x"), "T_BS, data: expected 16 finite numbers, got 16: 1.0 0 0 0.1 "),
        (f"T_BS: [-{NUMBERS}]\n", "got a reflection (determinant -1); is the sign of an axis wrong?"),
        (f"T_BS: [{NUMBERS}]\n".replace("1.0, 0, 0, 0.1", "0.1, 0, 0, 0.1"), "(off by 0.99)"),
        (
            f"T_BS: [{NUMBERS}]\n".replace("0, 0, 0, 1.0", "0.1, 0.2, 0.3, 1.0"),
            "the last row 0.1 0.2 0.3 1 in place of",
        ),
    ],
)
def test_a_pose_that_is_no_rigid_transform_is_named_in_one_line_with_what_it_is(folder, pose, message):
    folder.change("cam0/sensor.yaml", POSE, pose)
    with pytest.raises(SequenceError) as caught:
        oysterbench.open(folder.path)
    assert re.search(f"cam0/sensor.yaml: .*{re.escape(message)}", str(caught.value))
    assert "T_BS" in str(caught.value)
    assert "\n" not in str(caught.value)
    assert "[[" not in str(caught.value)


@pytest.mark.parametrize(
    ("file", "old", "new", "message"),
    [
        ("cam0", "rate_hz: 20", "rate_hz: 0", "rate_hz: expected a number above zero, got 0"),
        ("imu0", "rate_hz: 200", "rate_hz: -200", "rate_hz: expected a number above zero, got -200"),
        ("imu0", "noise_density: 1.0e-4", "noise_density: -1", "gyroscope_noise_density: expected zero or more"),
        ("imu0", "noise_density: 1.0e-3", "noise_density: -1", "accelerometer_noise_density: expected zero or more"),
        (
            "imu0",
            "random_walk: 1.0e-5",
            "random_walk: -1e-5",
            "gyroscope_random_walk: expected zero or more, got -1e-05",
        ),
        (
            "imu0",
            "rate_hz",
            "gravity: -9.81\nrate_hz",
            "gravity: expected its magnitude in m/s^2, about 9.81, got -9.81",
        ),
        ("imu0", "rate_hz", "gravity: 981\nrate_hz", "gravity: expected its magnitude in m/s^2, about 9.81, got 981"),
    ],
)
def test_a_number_that_no_sensor_has_is_refused(folder, file, old, new, message):
    folder.change(f"{file}/sensor.yaml", old, new)
    with pytest.raises(SequenceError, match=re.escape(f"{file}/sensor.yaml: {message}")):
        oysterbench.open(folder.path)


# Tables and images


@pytest.mark.parametrize("mark", [";", "\t", " ; "])
def test_fields_may_be_between_semicolons_or_tabs(folder, mark):
    for file in ("imu0/data.csv", "cam0/data.csv"):
        text = (folder.root / file).read_text()
        folder.write(file, text.replace(",", mark))
    assert folder.read() == sorted(SAMPLES + FRAMES)


def test_comments_may_be_indented(folder):
    folder.change("imu0/data.csv", f"{SAMPLES[3]},", f"  # a comment\n{SAMPLES[3]},")
    assert folder.read() == sorted(SAMPLES + FRAMES)


def test_fields_between_blanks_are_refused_and_commas_asked_for(folder):
    folder.write("imu0/data.csv", f"{SAMPLES[0]} 0 0 0 0 0 9.81\n")
    with pytest.raises(SequenceError, match=r"imu0/data.csv, line 1: .*; separate the fields by commas"):
        folder.read()


@pytest.mark.parametrize(
    ("content", "why"),
    [(None, "there is no such file"), (b"", "the file is empty"), (b"cut", "the file is damaged, or no image")],
)
def test_an_image_that_cannot_be_read_is_told_from_one_that_is_absent_or_empty(folder, content, why):
    picture = folder.root / "cam0" / "data" / f"{FRAMES[1]}.png"
    picture.unlink()
    if content is not None:
        picture.write_bytes(content)
    wanted = f"{picture}: expected an image, could not read one: {why}; restore it, or delete line 3 of cam0/data.csv"
    with pytest.raises(SequenceError, match=re.escape(wanted)):
        folder.read()


@pytest.mark.parametrize("suffix", ["png", "tif"])
def test_the_bits_of_images_stored_in_16_are_those_of_the_camera(folder, suffix):
    """A dark image stays as dark beside the others as it is, and the brightest value is almost 255."""
    values = [np.full((24, 32), value, np.uint16) for value in (3200, 100, 0)]
    for stamp, pixels in zip(FRAMES, values, strict=True):
        (folder.root / "cam0" / "data" / f"{stamp}.png").unlink()
        cv2.imwrite(str(folder.root / "cam0" / "data" / f"{stamp}.{suffix}"), pixels)
    folder.change("cam0/data.csv", ".png", f".{suffix}")
    sequence = oysterbench.open(folder.path)
    for _ in range(2):
        assert [int(image.pixels.max()) for image in sequence.images("cam0")] == [200, 6, 0]
    (dark,) = oysterbench.open(folder.path).images("cam0", FRAMES[1], FRAMES[2])
    assert (dark.pixels == 6).all()


def test_colours_of_8_and_of_16_bits_are_red_green_blue(folder):
    colour = np.zeros((24, 32, 3), np.uint8)
    colour[...] = (30, 20, 250)  # blue, green, red, as OpenCV has them
    for stamp, pixels in zip(FRAMES, (colour, colour.astype(np.uint16) * 257, colour), strict=True):
        cv2.imwrite(str(folder.root / "cam0" / "data" / f"{stamp}.png"), pixels)
    for image in oysterbench.open(folder.path).images("cam0"):
        assert (image.pixels == (250, 20, 30)).all()


# Ground truth


@pytest.mark.parametrize(
    "pose", [None, "T_BS: null\n", "T_BS: []", "T_BS: [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1]"]
)
def test_true_poses_are_those_of_the_body_where_nothing_else_is_said(folder, pose):
    folder.write("state_groundtruth_estimate0/data.csv", f"{SAMPLES[0]},1,2,3,1,0,0,0\n{SAMPLES[1]},2,2,3,1,0,0,0\n")
    if pose is not None:
        folder.write("state_groundtruth_estimate0/sensor.yaml", pose)
    np.testing.assert_array_equal(oysterbench.open(folder.path).truth().positions, [[1, 2, 3], [2, 2, 3]])


def test_true_poses_of_a_sensor_apart_from_the_body_become_those_of_the_body(folder):
    """A marker 1 m ahead of the body, which looks along the world's y axis."""
    half = np.sqrt(0.5)
    rows = "".join(f"{stamp},1,2,3,{half},0,0,{half}\n" for stamp in SAMPLES[:2])
    folder.write("state_groundtruth_estimate0/data.csv", rows)
    pose = "T_BS:\n  cols: 4\n  rows: 4\n  data: [1, 0, 0, 1, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1]\n"
    folder.write("state_groundtruth_estimate0/sensor.yaml", pose)
    truth = oysterbench.open(folder.path).truth()
    np.testing.assert_allclose(truth.positions, [[1, 1, 3]] * 2, atol=1e-12)
    np.testing.assert_allclose(truth.quaternions, [[0, 0, half, half]] * 2, atol=1e-12)
    assert truth.T_body_estimate is None
    assert truth.notes == (
        "dive: the true poses are those of a sensor apart from the body, by T_BS of sensor.yaml beside them, and were "
        "taken to the body",
    )
    folder.write("state_groundtruth_estimate0/sensor.yaml", "T_BS: [1, 0]")
    with pytest.raises(SequenceError, match=r"state_groundtruth_estimate0/sensor\.yaml: T_BS, data: expected 16"):
        oysterbench.open(folder.path).truth()


# Cameras


def test_a_camera_that_is_not_used_needs_no_list_of_images(folder):
    folder.add_camera("cam1")
    (folder.root / "cam1" / "data.csv").unlink()
    sequence = oysterbench.open(folder.path).for_method()
    assert len(list(sequence.images("cam0"))) == len(FRAMES)
    assert ("cam1", "camera", 0) in sequence.contents()
    with pytest.raises(SequenceError, match=r"cam1/data\.csv: expected this file"):
        next(sequence.images("cam1"))


def test_a_method_is_given_every_camera_that_the_folder_has(folder, tmp_path):
    shutil.move(folder.root / "cam0", folder.root / "cam10")
    write_input(folder.path, "sensors", tmp_path / "given")
    assert list(oysterbench.open(tmp_path / "given").cameras) == ["cam10"]


def test_a_method_is_told_of_an_image_whose_link_leads_nowhere(folder, tmp_path):
    picture = folder.root / "cam0" / "data" / f"{FRAMES[1]}.png"
    picture.unlink()
    picture.symlink_to(tmp_path / "gone.png")
    assert file_digests(folder.path)
    write_input(folder.path, "sensors", tmp_path / "given")
    with pytest.raises(SequenceError, match=f"{FRAMES[1]}.png: .*there is no such file"):
        list(oysterbench.open(tmp_path / "given").images("cam0"))


def test_a_list_of_images_whose_link_leads_nowhere_is_one_of_the_files_that_are_told_apart(folder, tmp_path):
    folder.add_camera("cam1")
    whole = file_digests(folder.path)
    (folder.root / "cam1" / "data.csv").unlink()
    (folder.root / "cam1" / "data.csv").symlink_to(tmp_path / "gone.csv")
    found = file_digests(folder.path)
    assert {name for name in found.keys() | whole.keys() if found.get(name) != whole.get(name)} == {
        "cam1/",
        "cam1/data.csv",
    }


def test_without_inertial_samples_the_images_give_the_duration_and_rates(folder):
    folder.write("imu0/data.csv", "#timestamp [ns]\n")
    facts = describe(folder.path)
    assert facts["duration_s"] == 0.1
    assert [(row["topic"], row["rate_hz"]) for row in facts["topics"]] == [("imu0", None), ("cam0", 20.0)]
    folder.write("cam0/data.csv", f"{FRAMES[0]},{FRAMES[0]}.png\n")
    told = run("info", folder.path)
    assert re.search(r"cam0 +camera +1 +-\n", told.stdout), told.stdout
    assert json.loads(run("info", folder.path, "--json").stdout)["topics"][1]["rate_hz"] is None
