"""Estimates that were written wrongly: what is certain is done and said, what is not is refused with the option."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from oysterbench.core.errors import TrajectoryError
from oysterbench.core.geometry import transform
from oysterbench.core.streams import stream
from oysterbench.core.trajectory import ReadOptions, Trajectory, read_trajectory, write_npz, write_tum
from oysterbench.core.trajectory.frames import ROTATION_BODY_OPTICAL, inverted
from oysterbench.evaluate.slam.diagnose import diagnose
from oysterbench.evaluate.slam.inputs import read_pair
from oysterbench.evaluate.slam.scoring import SlamSettings, score
from tests.helpers import trajectory_files as files
from tests.helpers.trajectory_files import dive

OPTICAL = Rotation.from_matrix(ROTATION_BODY_OPTICAL)


def noisy(trajectory: Trajectory) -> Trajectory:
    """With 2 cm and 1 deg of noise, in a world that is turned and moved."""
    rng = stream(6, b"", "noise")
    n = len(trajectory)
    noise = Rotation.from_rotvec(rng.normal(0, np.deg2rad(1.0), (n, 3)))
    world = Rotation.from_euler("z", 70, degrees=True)
    return replace(
        trajectory,
        positions=world.apply(trajectory.positions + rng.normal(0, 0.02, (n, 3))) + np.array([5.0, 3.0, -2.0]),
        quaternions=(world * Rotation.from_quat(trajectory.quaternions) * noise).as_quat(),
    )


TRUTH = dive(300)
ESTIMATE = noisy(TRUTH)


def level(n: int = 200) -> Trajectory:
    """A vehicle that keeps level and turns in yaw only."""
    yaw = 0.5 * np.sin(np.arange(n) * 0.05)
    attitudes = Rotation.from_rotvec(np.outer(yaw, [0.0, 0.0, 1.0]))
    steps = attitudes.apply([0.05, 0.0, 0.0])
    return Trajectory(TRUTH.stamps_ns[:n], np.cumsum(steps, axis=0), attitudes.as_quat())


def transect(n: int = 200) -> Trajectory:
    """A vehicle that goes straight ahead and does not turn, 30 deg from east."""
    attitude = Rotation.from_euler("z", 30, degrees=True)
    positions = attitude.apply([1.0, 0, 0]) * np.arange(n)[:, None] * 0.05
    return Trajectory(TRUTH.stamps_ns[:n], positions, np.tile(attitude.as_quat(), (n, 1)))


def pair(tmp_path, truth: Trajectory, estimate: Trajectory, **options):
    """Both through files; the estimate's options are given by name."""
    write_npz(tmp_path / "truth.npz", truth)
    write_npz(tmp_path / "estimate.npz", estimate)
    return read_pair(tmp_path / "truth.npz", tmp_path / "estimate.npz", None, ReadOptions(**options))


def refusal(tmp_path, truth: Trajectory, estimate: Trajectory) -> str:
    with pytest.raises(TrajectoryError) as caught:
        pair(tmp_path, truth, estimate)
    message = str(caught.value)
    assert "\n" not in message
    return message.removeprefix(str(tmp_path) + "/")


@pytest.mark.parametrize("truth", [TRUTH, level(), transect()], ids=["free", "level", "straight"])
def test_a_good_estimate_raises_no_suspicion(truth):
    assert diagnose(truth, noisy(truth)) == []
    assert diagnose(truth, noisy(truth).select(slice(3, -30, 4))) == []


def test_an_estimate_without_attitudes_raises_no_suspicion():
    assert diagnose(TRUTH, replace(ESTIMATE, quaternions=np.tile([0.0, 0, 0, 1], (300, 1)))) == []


def test_attitudes_that_are_merely_bad_raise_no_suspicion():
    for k in range(20):
        rng = stream(6, b"", "bad", k)
        assert diagnose(TRUTH, replace(ESTIMATE, quaternions=Rotation.random(300, rng=rng).as_quat())) == []


@pytest.mark.parametrize("truth", [TRUTH, level()], ids=["free", "level"])
def test_quaternions_as_w_x_y_z_are_recognised_read_so_and_said(tmp_path, truth):
    estimate = noisy(truth)
    mixed = replace(estimate, quaternions=estimate.quaternions[:, [3, 0, 1, 2]])
    _, read = pair(tmp_path, truth, mixed)
    np.testing.assert_allclose(read.quaternions, estimate.quaternions, rtol=0, atol=1e-15)
    (note,) = read.notes
    assert "as w x y z; read accordingly (--quaternion wxyz, or --quaternion xyzw to keep them)" in note
    assert note in score(truth, read).notes
    _, kept = pair(tmp_path, truth, mixed, quaternion="xyzw")
    np.testing.assert_array_equal(kept.quaternions, mixed.quaternions)
    assert kept.notes == ()


def test_quaternions_as_w_x_y_z_are_recognised_in_a_text_file(tmp_path):
    write_tum(tmp_path / "truth.tum", TRUTH)
    (tmp_path / "estimate.tum").write_bytes(
        files.tum(replace(ESTIMATE, quaternions=ESTIMATE.quaternions[:, [3, 0, 1, 2]]))
    )
    _, read = read_pair(tmp_path / "truth.tum", tmp_path / "estimate.tum")
    np.testing.assert_array_equal(read.stamps_ns, ESTIMATE.stamps_ns)
    np.testing.assert_array_equal(read.quaternions, ESTIMATE.quaternions)


@pytest.mark.parametrize("truth", [TRUTH, level()], ids=["free", "level"])
def test_quaternions_as_x_y_z_w_in_a_file_that_looks_like_eurocs_are_recognised(tmp_path, truth):
    """Lines with commas and no header, whole nanoseconds: EuRoC's, which have w first."""
    estimate = noisy(truth)
    write_tum(tmp_path / "truth.tum", truth)
    rows = np.column_stack([estimate.positions, estimate.quaternions]).tolist()
    lines = [",".join([str(t), *map(repr, row)]) for t, row in zip(estimate.stamps_ns, rows, strict=True)]
    (tmp_path / "estimate.csv").write_text("\n".join(lines))
    _, read = read_pair(tmp_path / "truth.tum", tmp_path / "estimate.csv")
    np.testing.assert_array_equal(read.quaternions, estimate.quaternions)
    (note,) = read.notes
    assert "as x y z w; read accordingly (--quaternion xyzw, or --quaternion wxyz to keep them)" in note


def test_quaternions_as_w_x_y_z_that_never_turn_are_refused(tmp_path):
    truth = transect()
    upright = noisy(truth)
    mixed = replace(upright, quaternions=upright.quaternions[:, [3, 0, 1, 2]])
    assert "turn too little to tell why; decide by --quaternion wxyz or xyzw" in refusal(tmp_path, truth, mixed)
    _, read = pair(tmp_path, truth, mixed, quaternion="wxyz")
    np.testing.assert_array_equal(read.quaternions, upright.quaternions)


@pytest.mark.parametrize("truth", [TRUTH, level(), transect()], ids=["free", "level", "straight"])
def test_poses_of_an_optical_frame_are_refused_with_the_option(tmp_path, truth):
    estimate = noisy(truth)
    camera = replace(estimate, quaternions=(Rotation.from_quat(estimate.quaternions) * OPTICAL).as_quat())
    message = refusal(tmp_path, truth, camera)
    assert message.startswith("estimate.npz: ")
    assert "optical frame" in message
    assert "--frame optical" in message
    _, read = pair(tmp_path, truth, camera, frame="optical")
    error = (Rotation.from_quat(read.quaternions).inv() * Rotation.from_quat(estimate.quaternions)).magnitude()
    assert error.max() < 1e-12
    assert read.notes == ()
    assert pair(tmp_path, truth, camera, frame="body")[1].notes == ()


def test_poses_of_any_frame_that_is_turned_are_refused_with_the_turn(tmp_path):
    turn = Rotation.from_euler("xyz", [10, 50, -80], degrees=True)
    sensor = replace(ESTIMATE, quaternions=(Rotation.from_quat(ESTIMATE.quaternions) * turn).as_quat())
    (finding,) = diagnose(TRUTH, sensor)
    found = Rotation.from_matrix(finding.changes["T_body_estimate"][:3, :3])
    assert (found.inv() * turn).magnitude() < np.deg2rad(1.0)
    assert "a constant 9" in refusal(tmp_path, TRUTH, sensor)
    place = transform(turn.as_matrix(), [0.3, 0.0, 0.1])
    sensor = replace(
        sensor, positions=ESTIMATE.positions + Rotation.from_quat(ESTIMATE.quaternions).apply([0.3, 0, 0.1])
    )
    _, read = pair(tmp_path, TRUTH, sensor, T_body_estimate=place)
    np.testing.assert_allclose(read.positions, ESTIMATE.positions, rtol=0, atol=1e-12)


@pytest.mark.parametrize("camera", [False, True], ids=["body", "camera"])
@pytest.mark.parametrize("truth", [TRUTH, level()], ids=["free", "level"])
def test_poses_that_take_the_world_into_the_body_are_refused_with_the_option(tmp_path, truth, camera):
    upright = noisy(truth)
    seen = replace(upright, quaternions=(Rotation.from_quat(upright.quaternions) * OPTICAL).as_quat())
    estimate = inverted(seen if camera else upright)
    message = refusal(tmp_path, truth, estimate)
    assert message.startswith("estimate.npz: its positions have the shape of the true path when")
    assert message.endswith("? Decide by --direction world-to-body, or --direction body-to-world to keep them")
    frame = {"frame": "optical"} if camera else {}
    _, read = pair(tmp_path, truth, estimate, direction="world-to-body", **frame)
    np.testing.assert_allclose(read.matrices, upright.matrices, rtol=0, atol=1e-9)
    assert not any("inverted" in note for note in read.notes)


def test_covariances_of_inverted_poses_are_left_out_and_it_is_said(tmp_path):
    write_npz(tmp_path / "estimate.npz", dive(12, covariances=True))
    read = read_trajectory(tmp_path / "estimate.npz", direction="world-to-body")
    assert read.covariances is None
    assert "covariances are left out" in read.notes[-1]


def test_millimetres_are_refused_with_the_option(tmp_path):
    millimetres = replace(ESTIMATE, positions=1010 * ESTIMATE.positions)
    message = refusal(tmp_path, TRUTH, millimetres)
    assert message.startswith("estimate.npz: the estimate's path is 10")
    assert "is it in millimetres? Decide by --unit mm, or --unit m to keep it" in message
    _, read = pair(tmp_path, TRUTH, millimetres, unit="mm")
    np.testing.assert_allclose(read.positions, 1.01 * ESTIMATE.positions, rtol=1e-12)
    np.testing.assert_array_equal(pair(tmp_path, TRUTH, millimetres, unit="m")[1].positions, millimetres.positions)


def test_millimetres_in_the_truth_are_refused_with_its_own_option(tmp_path):
    message = refusal(tmp_path, replace(TRUTH, positions=1000 * TRUTH.positions), ESTIMATE)
    assert message.startswith("truth.npz: the truth's path is")
    assert "--truth-unit mm" in message


def test_a_scale_that_is_fitted_is_not_taken_for_millimetres(tmp_path):
    write_npz(tmp_path / "truth.npz", TRUTH)
    write_npz(tmp_path / "estimate.npz", replace(ESTIMATE, positions=1000 * ESTIMATE.positions))
    _, read = read_pair(tmp_path / "truth.npz", tmp_path / "estimate.npz", any_scale=True)
    assert score(TRUTH, read, SlamSettings(align="sim3")).metrics["scale"] == pytest.approx(1e-3, rel=0.05)


def test_no_common_time_is_refused_with_the_offset_that_matches_the_motion(tmp_path):
    late = replace(ESTIMATE, stamps_ns=ESTIMATE.stamps_ns + 3_600_000_000_000)
    message = refusal(tmp_path, TRUTH, late)
    assert "do not overlap in time: the truth spans 1700000000.123456789 to" in message
    assert "decide by --time-offset -3" in message
    offset = float(message.rsplit(" ", 1)[1])
    assert offset == pytest.approx(-3600.0, abs=0.05)
    _, read = read_pair(tmp_path / "truth.npz", tmp_path / "estimate.npz", time_offset_s=offset)
    assert read.notes == ()


def test_small_nanoseconds_in_a_seconds_file_are_refused_with_the_option(tmp_path):
    truth = replace(TRUTH, stamps_ns=TRUTH.stamps_ns - TRUTH.stamps_ns[0] + 10**9).select(slice(0, 100))
    write_tum(tmp_path / "truth.tum", truth)
    lines = files.tum(truth).decode().splitlines()
    rows = (line.split() for line in lines)
    (tmp_path / "estimate.tum").write_text("".join(f"{row[0].replace('.', '')} {' '.join(row[1:])}\n" for row in rows))
    with pytest.raises(TrajectoryError, match=r"meet the truth's .* when taken as ns; decide by --time-unit ns"):
        read_pair(tmp_path / "truth.tum", tmp_path / "estimate.tum")
    _, read = read_pair(tmp_path / "truth.tum", tmp_path / "estimate.tum", None, ReadOptions(time_unit="ns"))
    np.testing.assert_array_equal(read.stamps_ns, truth.stamps_ns)


def test_swapped_arguments_are_suspected(tmp_path):
    keyframes = ESTIMATE.select(slice(60, 240, 10))
    _, read = pair(tmp_path, keyframes, TRUTH)
    (note,) = read.notes
    assert (
        "the truth has 18 poses over 8.5 s, all within the 15.0 s of the estimate's 300: have the two been swapped?"
        in note
    )
    known = replace(TRUTH, covariances=np.tile(np.eye(6), (300, 1, 1)))
    _, read = pair(tmp_path, known, ESTIMATE)
    assert "the ground truth carries covariances and the estimate does not: have the two been swapped?" in read.notes[0]


def test_truth_at_a_low_rate_and_keyframes_are_not_suspected():
    assert diagnose(TRUTH.select(slice(0, None, 20)), ESTIMATE) == []
    assert diagnose(TRUTH, ESTIMATE.select(slice(20, 280, 13))) == []


def test_kitti_poses_take_the_stamps_of_the_truth(tmp_path):
    write_npz(tmp_path / "truth.npz", TRUTH)
    (tmp_path / "poses.txt").write_bytes(files.kitti(ESTIMATE))
    truth, read = read_pair(tmp_path / "truth.npz", tmp_path / "poses.txt")
    np.testing.assert_array_equal(read.stamps_ns, truth.stamps_ns)
    assert "take the given times one to one" in read.notes[0]
    (tmp_path / "poses.txt").write_bytes(files.kitti(ESTIMATE.select(slice(0, 9))))
    with pytest.raises(TrajectoryError, match=r"expected a time for each of 9 poses, got 300 times; .*--times FILE"):
        read_pair(tmp_path / "truth.npz", tmp_path / "poses.txt")


def test_two_kitti_files_without_times_meet_by_index_and_it_is_said(tmp_path):
    (tmp_path / "truth.txt").write_bytes(files.kitti(TRUTH))
    (tmp_path / "poses.txt").write_bytes(files.kitti(TRUTH))
    truth, read = read_pair(tmp_path / "truth.txt", tmp_path / "poses.txt")
    np.testing.assert_array_equal(truth.stamps_ns, np.arange(300) * 100_000_000)
    np.testing.assert_array_equal(read.stamps_ns, truth.stamps_ns)
    assert any("meet by index, taken as 0.1 s apart" in note for note in truth.notes)
    (tmp_path / "poses.txt").write_bytes(files.kitti(TRUTH.select(slice(0, 9))))
    with pytest.raises(
        TrajectoryError, match=r"poses\.txt: expected as many poses as the truth has, 300, .* got 9; .*"
    ):
        read_pair(tmp_path / "truth.txt", tmp_path / "poses.txt")
    write_npz(tmp_path / "poses.npz", TRUTH)
    with pytest.raises(TrajectoryError, match=r"truth\.txt: KITTI poses have no timestamps; .*--times FILE"):
        read_pair(tmp_path / "truth.txt", tmp_path / "poses.npz")


def test_a_pose_that_cannot_be_is_refused_before_anything_is_compared():
    positions = TRUTH.positions.copy()
    positions[3, 1] = np.nan
    with pytest.raises(TrajectoryError, match="estimate: expected finite numbers, got y = nan at pose 4 of 300"):
        diagnose(TRUTH, replace(TRUTH, positions=positions))
