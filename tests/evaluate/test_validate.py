"""A trajectory that cannot be scored is refused in one line that names the pose."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from oysterbench.core.errors import TrajectoryError
from oysterbench.core.streams import stream
from oysterbench.core.trajectory import Trajectory
from oysterbench.evaluate.slam.scoring import SlamSettings, score
from oysterbench.evaluate.slam.validate import check_trajectory


def walk(n: int = 200) -> Trajectory:
    rng = stream(5, b"", "walk")
    attitudes = Rotation.from_rotvec(np.cumsum(rng.normal(0, 0.05, (n, 3)), axis=0))
    positions = np.cumsum(rng.normal(0, 0.1, (n, 3)), axis=0)
    return Trajectory(np.arange(n, dtype=np.int64) * 50_000_000 + 10**18, positions, attitudes.as_quat())


def refusal(trajectory: Trajectory) -> str:
    with pytest.raises(TrajectoryError) as caught:
        check_trajectory(trajectory, "estimate")
    message = str(caught.value)
    assert message.startswith("estimate: expected ")
    assert "\n" not in message
    return message


def changed(array: str, index, value) -> Trajectory:
    trajectory = walk()
    values = getattr(trajectory, array).copy()
    values[index] = value
    return replace(trajectory, **{array: values})


def test_a_good_trajectory_is_given_back():
    checked = check_trajectory(walk(), "estimate")
    np.testing.assert_array_equal(checked.positions, walk().positions)
    np.testing.assert_allclose(checked.quaternions, walk().quaternions, rtol=0, atol=1e-15)


def test_nan_is_named_by_pose_and_column():
    assert "y = nan at pose 8 of 200 (1000000000.350000000 s);" in refusal(changed("positions", (7, 1), np.nan))
    assert "qw = inf at pose 1 of 200" in refusal(changed("quaternions", (0, 3), np.inf))
    assert "pose 3 of 200 (1000000000.100000000 s) and 1 more" in refusal(changed("positions", [2, 3], np.nan))


def test_positions_that_diverged_are_named():
    assert "got 1e+200 m at pose 5 of 200" in refusal(changed("positions", (4, 0), -1e200))


def test_stamps_whose_differences_overflow_are_refused():
    assert "146 years" in refusal(changed("stamps_ns", 199, 2**63 - 1))


def test_repeated_stamps_are_named():
    duplicated = walk().select(np.repeat(np.arange(200), 2))
    assert "1000000000.000000000 s twice, at poses 1 and 2 and 199 more" in refusal(duplicated)


def test_unsorted_stamps_are_named():
    swapped = walk().select(np.r_[0:5, 6, 5, 7:200])
    assert "got 1000000000.250000000 s after 1000000000.300000000 s at pose 7" in refusal(swapped)


def test_a_quaternion_that_is_no_rotation_is_named():
    assert "norm 1.1 at pose 4 of 200" in refusal(changed("quaternions", 3, [0, 0, 0, 1.1]))
    assert "norm 0 at pose 4 of 200" in refusal(changed("quaternions", 3, 0))


def test_quaternions_rounded_in_text_are_normalised():
    rounded = replace(walk(), quaternions=np.round(walk().quaternions, 3))
    assert not np.allclose(np.linalg.norm(rounded.quaternions, axis=1), 1, rtol=0, atol=1e-5)
    checked = check_trajectory(rounded, "estimate")
    np.testing.assert_allclose(np.linalg.norm(checked.quaternions, axis=1), 1, rtol=0, atol=1e-15)


@pytest.mark.parametrize("n", [0, 1])
def test_fewer_than_two_poses_are_refused(n):
    assert f"got {n}" in refusal(walk().select(slice(0, n)))


def test_stamps_in_seconds_are_refused():
    with pytest.raises(TrajectoryError, match="int64 nanoseconds, got float64"):
        check_trajectory(replace(walk(), stamps_ns=walk().stamps_ns * 1e-9), "estimate")


def test_score_says_which_of_the_two_is_wrong():
    bad = changed("positions", (7, 1), np.nan)
    with pytest.raises(TrajectoryError, match=r"^truth: "):
        score(bad, walk())
    with pytest.raises(TrajectoryError, match=r"^estimate: "):
        score(walk(), bad)


def test_quaternions_in_another_order_are_suspected():
    mixed = replace(walk(), quaternions=walk().quaternions[:, [3, 0, 1, 2]])
    (note,) = score(walk(), mixed, SlamSettings(align="none")).notes
    assert "w x y z" in note


def test_quaternions_of_the_ground_truth_in_another_order_are_not_laid_to_the_estimate():
    mixed = replace(walk(), quaternions=walk().quaternions[:, [3, 0, 1, 2]])
    (both,) = score(mixed, walk(), SlamSettings(align="none")).notes
    assert "when those of the ground truth are read as w x y z or by" in both  # in one frame, either explains the other
    yaw = Rotation.from_euler("z", 70, degrees=True)
    estimate = replace(
        walk(),
        positions=yaw.apply(walk().positions),
        quaternions=(yaw * Rotation.from_quat(walk().quaternions)).as_quat(),
    )
    (note,) = score(mixed, estimate).notes
    assert "when those of the ground truth are read as w x y z: were" in note
    assert "estimate" not in note


@pytest.mark.parametrize("of", ["estimate", "ground truth"])
@pytest.mark.parametrize(("metres", "unit"), [(1e-3, "millimetres"), (1e-2, "centimetres")])
def test_a_path_in_another_unit_is_suspected(of, metres, unit):
    small, large = walk(), replace(walk(), positions=walk().positions / metres)
    notes = score(small, large).notes if of == "estimate" else score(large, small).notes
    assert any(note.endswith(f"is the {of} in {unit}? Metres are expected") for note in notes)


def test_poses_of_a_camera_are_suspected():
    optical = Rotation.from_euler("ZYX", [-90, 0, -90], degrees=True)
    camera = replace(walk(), quaternions=(Rotation.from_quat(walk().quaternions) * optical).as_quat())
    (note,) = score(walk(), camera, SlamSettings(align="none")).notes
    assert "a constant rotation of 120.0 deg" in note


def test_attitudes_that_are_merely_bad_raise_no_suspicion():
    rng = stream(6, b"", "bad")
    bad = replace(walk(), quaternions=Rotation.random(200, rng=rng).as_quat())
    assert score(walk(), bad, SlamSettings(align="none")).notes == ()


@pytest.mark.parametrize(("unit", "factor"), [("seconds", 10**9), ("milliseconds", 10**6), ("microseconds", 10**3)])
def test_timestamps_in_memory_that_are_not_nanoseconds_are_told_so(unit, factor):
    truth = walk()
    once_a_second = truth.select(slice(None, None, 20))
    with pytest.raises(
        TrajectoryError, match=f"within the truth as {unit}: .* in nanoseconds; multiply them by {factor}"
    ):
        score(truth, replace(once_a_second, stamps_ns=once_a_second.stamps_ns // factor))


def test_another_clock_is_not_taken_for_another_unit():
    """As microseconds, the estimate's first second is the truth's beginning, but it lasts 1000 times as long."""
    truth = replace(walk(), stamps_ns=walk().stamps_ns - 10**18 + 1000 * 10**9)
    estimate = replace(walk(), stamps_ns=walk().stamps_ns - 10**18 + 10**9)
    with pytest.raises(TrajectoryError, match=r"starts 999\.0+ s before it; .*--time-offset"):
        score(truth, estimate)


@pytest.mark.parametrize("factor", [10**9, 10**6, 10**3])
def test_timestamps_from_zero_in_another_unit_are_told_so(factor):
    truth = replace(walk(), stamps_ns=walk().stamps_ns - 10**18)
    once_a_second = truth.select(slice(None, None, 20))
    with pytest.raises(TrajectoryError, match=f"in nanoseconds; multiply them by {factor}"):
        score(truth, replace(once_a_second, stamps_ns=once_a_second.stamps_ns // factor))
