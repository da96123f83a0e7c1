"""Folders in EuRoC layout as others make them: read, or refused in a line that names the file."""

from __future__ import annotations

import pytest

import oysterbench
from oysterbench.core.errors import SequenceError
from tests.helpers.euroc import CAMERA, FRAMES, SAMPLES, Folder


@pytest.fixture
def folder(tmp_path):
    return Folder(tmp_path / "dive")


def test_a_folder_gives_its_calibration_and_measurements(folder):
    sequence = oysterbench.open(folder.path)
    assert sequence.cameras["cam0"].T_base_cam[:3, 3].tolist() == [0.1, 0.2, 0.3]
    assert sequence.cameras["cam0"].distortion.tolist() == [0.1, 0.0, 0.0, 0.0]
    assert [sample.accel[2] for sample in sequence.imu(SAMPLES[2], SAMPLES[4])] == [2.5, 3.5]
    assert folder.read() == sorted(SAMPLES + FRAMES)


@pytest.mark.parametrize("header", ["\ufeff#timestamp [ns],filename", "timestamp [ns],filename", ""])
def test_a_header_may_have_a_byte_order_mark_or_lack_its_hash(folder, header):
    folder.change("cam0/data.csv", "#timestamp [ns],filename", header)
    assert len(folder.read()) == len(SAMPLES + FRAMES)


def test_a_comment_may_be_in_another_encoding(folder):
    folder.write("cam0/sensor.yaml", f"# caméra\n{CAMERA}", "latin-1")
    assert len(folder.read()) == len(SAMPLES + FRAMES)


@pytest.mark.parametrize("more", [",", ",25.0", ",25.0,,nan"])
def test_columns_after_those_of_the_imu_are_none_of_ours(folder, more):
    folder.change("imu0/data.csv", ".5\n", f".5{more}\n")
    samples = list(oysterbench.open(folder.path).imu())
    assert [(*sample.gyro, *sample.accel) for sample in samples[:2]] == [(0, 0, 0, 0, 0, 0.5), (0, 0, 0, 0, 0, 1.5)]
    assert len(samples) == len(SAMPLES)


@pytest.mark.parametrize("coefficients", ["distortion_coefficients: []", ""])
def test_a_camera_without_distortion_needs_no_coefficients(folder, coefficients):
    folder.change("cam0/sensor.yaml", "radial-tangential", "none")
    folder.change("cam0/sensor.yaml", "distortion_coefficients: [0.1, 0.0, 0.0, 0.0]", coefficients)
    assert oysterbench.open(folder.path).cameras["cam0"].distortion.tolist() == [0.0, 0.0, 0.0, 0.0]


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("radial-tangential", "fov", "distortion_model: expected one of .*, got fov"),
        ("pinhole", "omni", "camera_model: expected pinhole, got omni"),
        ("[25.0, ", "[fx, ", r"intrinsics: expected 4 finite numbers, got \[fx"),
        ("[25.0, ", "[0.9, 25.0, ", "intrinsics: expected 4 finite numbers"),
        ("[25.0, ", "[-25.0, ", "focal lengths above zero"),
        ("[25.0, ", "[nan, ", "intrinsics: expected 4 finite numbers"),
        ("[0.1, 0.0, ", "[0.1, ", "distortion: expected 4 or 5 coefficients for plumb_bob"),
        ("[0.1, 0.0, ", "[0.1, 0.0, 0.0, 0.0, 0.0, 0.2, ", r"got an array \(8,\); calibrate with that model"),
        ("[0.1, 0.0, 0.0, 0.0]", "[]", "distortion_coefficients: expected finite numbers"),
        (
            "radial-tangential\ndistortion_coefficients: [",
            "equidistant\ndistortion_coefficients: [0.0, ",
            "expected 4 ",
        ),
        (", 0.0, 0.0, 0.0, 1.0]", "]", "data: expected 16 finite numbers"),
        ("[1.0, ", "[2.0, ", r"expected a rigid transform \(4, 4\)"),
        ("[32, 24]", "[32]", "resolution: expected 2 finite numbers"),
        ("resolution:", "size:", "missing key 'resolution'"),
        ("rate_hz: 20", "rate_hz: 20\ntimeshift_cam_imu: 1e300", "expected a time offset of at most"),
        ("rate_hz: 20", "rate_hz: 20\nreadout_s: 1e300", "readout_s: expected 0 to 1 s, got 1e\\+300"),
    ],
)
def test_a_calibration_that_is_not_supported_is_refused(folder, old, new, message):
    folder.change("cam0/sensor.yaml", old, new)
    with pytest.raises(SequenceError, match=f"cam0/sensor.yaml: .*{message}"):
        folder.read()


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (f"{SAMPLES[-1]},0,0,0,0,0,", f"{SAMPLES[-1]},0,0,0", "line 21: expected a stamp and 6 finite numbers"),
        (f"{SAMPLES[1]},0", f"{SAMPLES[1]},nan", r"line 3: expected a stamp and 6 finite numbers .*\['nan'"),
        (f"{SAMPLES[1]},0", f"{SAMPLES[1]},x", "line 3: expected a stamp and 6 finite numbers"),
        (f"{SAMPLES[1]},0", f"{SAMPLES[1]},0,0", "line 3: expected a stamp and 6 finite numbers"),
        (f"{SAMPLES[1]},0", f"{SAMPLES[1]},0,0", r"line 3: .* as many columns as in the first sample \(7\), got 8"),
        (f"{SAMPLES[-1]},", f"{str(SAMPLES[-1])[:9]},", f"line 21: expected a stamp in whole ns above {SAMPLES[-2]}"),
        (f"{SAMPLES[1]},", f"{SAMPLES[0]},", f"line 3: expected a stamp in whole ns above {SAMPLES[0]}"),
        (f"{SAMPLES[1]},", "1000000000.005,", "line 3: .* in whole ns .*, got '1000000000.005'"),
        (f"{SAMPLES[0]},", "1.0e18,", "line 2: expected a stamp in whole ns, got '1.0e18'"),
        (f"{SAMPLES[-1]},", f"{10**19},", "line 21: expected a stamp in whole ns"),
    ],
)
def test_samples_that_are_cut_short_or_out_of_order_are_refused(folder, old, new, message):
    folder.change("imu0/data.csv", old, new)
    with pytest.raises(SequenceError, match=f"imu0/data.csv, {message}"):
        folder.read()


@pytest.mark.parametrize(
    ("file", "old", "new", "message"),
    [
        ("sensor.yaml", "[32, 24]", "[320, 240]", "expected 320 x 240 px, as sensor.yaml says, got 32 x 24"),
        ("data.csv", f"{FRAMES[1]},", f"{FRAMES[0]},", f"line 3: expected a stamp in whole ns above {FRAMES[0]}"),
        ("data.csv", f"{FRAMES[1]},", f"{FRAMES[1]};", "line 3: expected a stamp in whole ns"),
        ("data.csv", f",{FRAMES[1]}.png", "", "line 3: expected a stamp, and the name of a file in data/"),
        ("data.csv", f"{FRAMES[1]}.png", f"../data/../../{FRAMES[1]}.png", "line 3: .* a file in data/, got"),
        ("data.csv", f"{FRAMES[1]}.png", f"/tmp/{FRAMES[1]}.png", "line 3: .* a file in data/, got"),
        ("data.csv", f"{FRAMES[1]}.png", "none.png", "none.png: expected an image, could not read one"),
    ],
)
def test_images_that_do_not_fit_their_list_or_calibration_are_refused(folder, file, old, new, message):
    folder.change(f"cam0/{file}", old, new)
    with pytest.raises(SequenceError, match=message):
        folder.read()


def test_a_camera_without_its_list_is_refused(folder):
    (folder.root / "cam0" / "data.csv").unlink()
    with pytest.raises(SequenceError, match=r"cam0/data\.csv: expected this file of the EuRoC layout"):
        folder.read()


def test_a_folder_that_holds_sequences_is_told_apart_from_one_that_is_one(tmp_path):
    expected = r"expected a sequence file \(\.mcap\) or an EuRoC folder with mav0/imu0/data\.csv, "
    with pytest.raises(SequenceError, match=expected + "found neither$"):
        oysterbench.open(tmp_path)
    (tmp_path / "1.0").mkdir()
    (tmp_path / "1.0" / "mini-01.mcap").touch()
    with pytest.raises(SequenceError, match=expected + r"got a folder of 1 file such as .*/1\.0/mini-01\.mcap$"):
        oysterbench.open(tmp_path)
