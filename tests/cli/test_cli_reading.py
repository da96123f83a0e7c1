"""What `oysterbench eval` is told: a track, and how to read its files."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from click.testing import CliRunner
from scipy.spatial.transform import Rotation

from oysterbench.cli.main import main
from oysterbench.core.geometry import transform
from oysterbench.core.trajectory import write_tum
from oysterbench.core.trajectory.frames import ROTATION_BODY_OPTICAL, poses_of_body, poses_of_frame
from oysterbench.core.trajectory.options import EXPECTED
from oysterbench.sequence import open_sequence
from oysterbench.sequence.export import export_sequence
from tests.helpers.trajectory_files import dive, kitti, mcap, seconds, tum
from tests.helpers.trees import write_sequence

TRUTH = dive(100)


@pytest.fixture
def run(tmp_path):
    """Score a file of bytes against the truth with more arguments: (exit code, stdout, stderr)."""
    (tmp_path / "truth.tum").write_bytes(tum(TRUTH))

    def call(estimate: bytes, *more: str):
        (tmp_path / "estimate").write_bytes(estimate)
        command = ["eval", "--track", "slam", "--truth", str(tmp_path / "truth.tum")]
        result = CliRunner().invoke(main, [*command, "--estimate", str(tmp_path / "estimate"), *more])
        assert result.exception is None or isinstance(result.exception, SystemExit)
        return result.exit_code, result.stdout, result.stderr

    return call


def scored(outcome) -> tuple[float, list[str]]:
    """Position error in m, and notes."""
    code, stdout, stderr = outcome
    assert code == 0, stderr
    (record,) = json.loads(stdout)["results"]
    return record["metrics"]["ate_rmse_m"], record["notes"]


def refused(outcome) -> str:
    code, stdout, stderr = outcome
    assert code == 1
    assert stdout == ""
    assert stderr.startswith("oysterbench: ")
    assert stderr.count("\n") == 1
    return stderr


def test_quaternions_as_w_x_y_z_are_read_so_and_the_record_says_it(run):
    mixed = tum(replace(TRUTH, quaternions=TRUTH.quaternions[:, [3, 0, 1, 2]]))
    error_m, notes = scored(run(mixed, "--json"))
    assert error_m < 1e-9
    assert any("read accordingly (--quaternion wxyz" in note for note in notes)
    _, notes = scored(run(mixed, "--quaternion", "xyzw", "--json"))
    assert not any("read accordingly" in note for note in notes)


def test_millimetres_are_decided_by_an_option(run):
    data = tum(replace(TRUTH, positions=1000 * TRUTH.positions))
    assert "--unit mm" in refused(run(data))
    assert scored(run(data, "--unit", "mm", "--json"))[0] < 1e-9


def test_a_camera_is_decided_by_its_place_as_numbers_or_as_a_file(run, tmp_path):
    place = transform(ROTATION_BODY_OPTICAL, [0.2, 0.0, -0.1])
    camera = TRUTH.matrices @ place
    quaternions = Rotation.from_matrix(camera[:, :3, :3]).as_quat()
    data = tum(replace(TRUTH, positions=camera[:, :3, 3], quaternions=quaternions))
    assert "--frame optical" in refused(run(data))
    x, y, z, w = Rotation.from_matrix(ROTATION_BODY_OPTICAL).as_quat()
    assert scored(run(data, "--T-body-estimate", f"0.2,0,-0.1,{x},{y},{z},{w}", "--json"))[0] < 1e-9
    np.savetxt(tmp_path / "place.txt", place)
    assert scored(run(data, "--T-body-estimate", str(tmp_path / "place.txt"), "--json"))[0] < 1e-9
    assert scored(run(data, "--frame", "optical", "--json"))[0] > 0.01


@pytest.mark.parametrize("scale", [0.1, 0.5])
def test_a_camera_without_scale_is_aligned_before_it_is_carried_over(run, scale):
    camera = poses_of_body(TRUTH, np.linalg.inv(transform(np.eye(3), [0.4, 0.0, -0.1])))
    data = tum(replace(camera, positions=scale * camera.positions))
    place = ("--T-body-estimate", "0.4,0,-0.1,0,0,0,1")
    assert scored(run(data, *place, "--align", "sim3", "--json"))[0] < 1e-8
    assert scored(run(data, *place, "--align", "scale", "--json"))[0] < 1e-8


def test_a_place_that_is_none_is_a_usage_error(run):
    code, _, stderr = run(tum(TRUTH), "--T-body-estimate", "1,2,3")
    assert code == 2
    assert "expected x,y,z,qx,qy,qz,qw or a 4 x 4 matrix" in stderr


def test_kitti_takes_the_stamps_of_the_truth_or_of_a_file(run, tmp_path):
    error_m, notes = scored(run(kitti(TRUTH), "--json"))
    assert error_m < 1e-9
    assert any("take the given times one to one" in note for note in notes)
    half = TRUTH.select(slice(0, 50))
    assert "--times FILE" in refused(run(kitti(half)))
    (tmp_path / "times.txt").write_text("\n".join(map(seconds, half.stamps_ns.tolist())))
    assert scored(run(kitti(half), "--times", str(tmp_path / "times.txt"), "--json"))[0] < 1e-9


def test_a_topic_of_an_mcap_file_is_scored(run):
    assert scored(run(mcap(TRUTH), "--topic", "/odom", "--json"))[0] < 1e-9
    assert "choose it with --topic: /odom" in refused(run(mcap(TRUTH), "--topic", "/other"))


def test_poses_out_of_order_are_sorted_when_asked(run):
    lines = tum(TRUTH).splitlines()
    data = b"\n".join(lines[50:] + lines[:50])
    assert "estimate:51: expected increasing timestamps" in refused(run(data))
    assert scored(run(data, "--sort", "--json"))[0] < 1e-9


def test_reading_options_without_files_are_a_usage_error():
    result = CliRunner().invoke(main, ["eval", "--track", "slam", "--quaternion", "wxyz", "--sort"])
    assert result.exit_code == 2
    assert "--quaternion, --sort: says how to read files" in result.stderr


@pytest.mark.parametrize("words", [["slm"], ["--track", "slm"], ["--track=slm"]])
def test_a_track_that_there_is_not_is_answered_by_those_there_are(words):
    result = CliRunner().invoke(main, ["eval", *words])
    assert result.exit_code == 2
    assert "expected a track, one of slam, segmentation, detection, density, steering, got 'slm'" in result.output


@pytest.mark.parametrize("option", ["--truth", "--estimate"])
def test_a_file_to_score_is_given_once(option, tmp_path):
    """The last of several would be scored as if the others had not been given."""
    done = CliRunner().invoke(main, ["eval", "slam", "--truth", "a", "--estimate", "b", option, "c"])
    assert done.exit_code == 2
    assert f"'{option}': expected one path, got 2: score them one by one" in done.output


def test_the_frame_of_the_poses_is_named_as_in_the_sequence(tmp_path):
    dive = write_sequence(tmp_path / "dive.mcap", "dive")
    opened = open_sequence(dive)
    places = {"cam_left": opened.cameras["cam_left"].T_base_cam, "imu": opened.imu_calibration.T_base_imu}

    def call(truth, frame, *more):
        words = ["eval", "slam", "--truth", str(truth), "--estimate", str(tmp_path / "mine.tum"), "--align", "none"]
        result = CliRunner().invoke(main, [*words, "--poses-of", frame, *more])
        return result.exit_code, result.stdout, result.stderr

    for frame, place in places.items():
        write_tum(tmp_path / "mine.tum", poses_of_frame(opened.truth(), place))
        assert scored(call(dive, frame, "--json"))[0] < 1e-6
    told = call(dive, "cam_x")[2]
    assert "sequence dive has no such frame; expected base, imu, camera or one of its cameras: cam_left" in told
    assert "--poses-of, --frame: both set the frame of the poses" in call(dive, "imu", "--frame", "optical")[2]
    assert "--poses-of imu: expected a sequence with that frame" in call(tmp_path / "mine.tum", "imu")[2]


def test_poses_of_the_camera_are_the_rectified_left_ones_where_the_file_is_kittis(tmp_path):
    """The layout puts the left camera of a pair first, which here is the second of the sequence."""
    dive, folder, written = write_sequence(tmp_path / "dive.mcap", "dive"), tmp_path / "euroc", tmp_path / "kitti"
    export_sequence(open_sequence(dive), "euroc", folder)
    root = folder / "mav0"
    for old, new in (("cam0", "left"), ("cam1", "cam0"), ("left", "cam1")):
        (root / old).rename(root / new)
    opened = open_sequence(folder)
    export_sequence(opened, "kitti", written)
    (tmp_path / "times.txt").write_text("\n".join(str(image.stamp_ns) for image in opened.images("cam1")))
    words = ["eval", "slam", "--truth", str(folder), "--estimate", str(written / "poses" / "00.txt"), "--json"]
    words += ["--times", str(tmp_path / "times.txt"), "--poses-of", "camera", "--align", "se3"]
    for more in ([], ["--format", "kitti"]):
        done = CliRunner().invoke(main, [*words, *more])
        assert scored((done.exit_code, done.stdout, done.stderr))[0] < 1e-3


@pytest.mark.parametrize("folder", [False, True])
def test_how_the_file_of_the_truth_is_read_is_refused_where_it_is_a_sequence(tmp_path, folder):
    truth, mine = write_sequence(tmp_path / "dive.mcap", "dive"), tmp_path / "mine.tum"
    write_tum(mine, open_sequence(truth).truth())
    if folder:
        truth = export_sequence(open_sequence(truth), "euroc", tmp_path / "euroc")[0]
    words = ["eval", "slam", "--truth", str(truth), "--estimate", str(mine)]
    for option, value in (("unit", "mm"), ("time-unit", "s"), ("quaternion", "wxyz"), ("duplicates", "last")):
        done = CliRunner().invoke(main, [*words, f"--truth-{option}", value])
        assert done.exit_code == 2
        assert f"--truth-{option}: it says how a file is read, and the ground truth is a sequence" in done.stderr
    (tmp_path / "times.txt").write_text("0\n1\n")
    assert CliRunner().invoke(main, [*words, "--times", str(tmp_path / "times.txt")]).exit_code == 0


def test_a_file_that_is_no_trajectory_is_called_what_it_is(run):
    assert "estimate: it is JSON; expected a trajectory: TUM" in refused(run(b'{"results": []}'))
    assert "estimate: it is HTML or XML; expected a trajectory" in refused(run(b"<!doctype html>\n"))


def test_a_folder_in_euroc_layout_is_a_ground_truth_and_as_an_estimate_named_by_its_file(tmp_path):
    dive, folder, mine = write_sequence(tmp_path / "dive.mcap", "dive"), tmp_path / "euroc", tmp_path / "mine.tum"
    assert CliRunner().invoke(main, ["export", str(dive), "--format", "euroc", "--out", str(folder)]).exit_code == 0
    write_tum(mine, open_sequence(folder).truth())

    def call(truth, estimate):
        words = ["eval", "slam", "--truth", str(truth), "--estimate", str(estimate), "--align", "none", "--json"]
        return CliRunner().invoke(main, words)

    done = call(folder, mine)
    assert done.exit_code == 0, done.stderr
    file = folder / "mav0" / "state_groundtruth_estimate0" / "data.csv"
    assert call(mine, folder).stderr.strip().endswith(f"is a folder; {EXPECTED}; its poses are in {file}")
    file.unlink()
    assert call(folder, mine).stderr.strip().endswith(f"{folder} has no ground truth: {file} is absent")
    sensor = folder / "mav0" / "cam0" / "sensor.yaml"
    sensor.write_text(sensor.read_text().replace("T_BS", "T_SB"))
    words = ["eval", "slam", "--truth", str(folder), "--estimate", str(mine), "--poses-of", "cam0"]
    told = CliRunner().invoke(main, words).stderr
    assert f"expected a sequence with that frame (.mcap or a folder in EuRoC layout), got {folder}; " in told
    assert f"({sensor}: missing key 'T_BS')" in told
