"""Alignments: what the geometry does not determine is refused, what it hardly does is said, with the figure."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from oysterbench.core.errors import TrajectoryError
from oysterbench.core.geometry import transform
from oysterbench.core.streams import stream
from oysterbench.core.trajectory import Trajectory
from oysterbench.core.trajectory.frames import poses_of_body, poses_of_frame, scaled
from oysterbench.evaluate.slam.alignment import fit_alignment
from oysterbench.evaluate.slam.scoring import SlamSettings, score
from tests.helpers.dives import dive, moved, noisy, survey, transect


def refusal(truth: Trajectory, estimate: Trajectory, **options) -> str:
    with pytest.raises(TrajectoryError) as caught:
        score(truth, estimate, SlamSettings(**options))
    assert "\n" not in str(caught.value)
    return str(caught.value)


def turned_about_x(trajectory: Trajectory, degrees: float) -> Trajectory:
    return moved(trajectory, Rotation.from_euler("x", degrees, degrees=True), (0, 0, 0))


# --- straight lines ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("align", ["se3", "sim3"])
def test_an_exact_line_is_refused_and_told_what_to_choose(align):
    message = refusal(transect(), noisy(transect(), 0.001), align=align)
    assert "the points lie on one line: nothing determines the rotation about it" in message
    assert message.endswith("choose another alignment (posyaw, origin or none)")


@pytest.mark.parametrize("align", ["se3", "sim3"])
def test_a_line_with_a_millimetre_of_noise_is_refused_where_noise_is_all_there_is_across_it(align):
    """evo turns such an estimate by 86 deg about the line and reports it as its rotation error."""
    truth, estimate = noisy(transect(), 0.001, case=1), noisy(transect(), 0.001, case=2)
    message = refusal(truth, estimate, align=align)
    assert "nearly a straight line" in message
    assert "the rotation about the line is a guess" in message


def test_a_line_that_winds_more_than_the_estimate_errs_is_flagged_with_the_uncertainty():
    """2 mm to either side, errors of 1 mm: sigma = 1 mm / sqrt(2 mm^2 + ...), here 1 / 2 rad."""
    truth = transect(width_m=0.002)
    result = score(truth, noisy(truth, 0.001), SlamSettings(align="se3"))
    sigma = result.metrics["alignment_sigma_deg"]
    assert sigma == pytest.approx(np.rad2deg(0.5), rel=0.1)
    (note,) = (note for note in result.notes if "nearly a straight line" in note)
    assert f"uncertain by {sigma:.0f} deg" in note
    assert result.metrics["alignment_condition"] > 1000


def test_a_line_that_winds_far_more_than_the_estimate_errs_is_aligned_without_a_word():
    truth = transect(width_m=0.5)
    result = score(truth, turned_about_x(noisy(truth, 0.001), 50), SlamSettings(align="se3"))
    assert result.notes == ()
    assert result.metrics["ate_rotation_rmse_deg"] < 0.1
    assert result.metrics["alignment_sigma_deg"] < 0.2
    assert result.metrics["alignment_condition"] == pytest.approx(np.sqrt(75 / 0.25), rel=0.2)


@pytest.mark.parametrize("noise_m", [0.0, 0.001])
@pytest.mark.parametrize("align", ["posyaw", "origin", "none", "scale"])
def test_a_straight_transect_is_scored_by_what_it_does_determine(align, noise_m):
    metrics = score(transect(), noisy(transect(), noise_m), SlamSettings(align=align)).metrics
    assert metrics["ate_rmse_m"] <= 5 * noise_m + 1e-12
    assert metrics["ate_rotation_rmse_deg"] < 0.1


@given(st.integers(0, 2**32 - 1), st.floats(0.01, 0.5))
@settings(max_examples=40, deadline=None)
def test_the_uncertainty_of_the_turn_is_no_less_than_its_error(seed, width_m):
    """The turn about the line that noise of 1 mm leaves, against sigma: of 301 independent errors, far inside it."""
    truth = transect(width_m=width_m)
    fit = fit_alignment(truth, noisy(truth, 0.001, case=seed), "se3")
    about_line = Rotation.from_matrix(fit.similarity.rotation).as_rotvec()[0]
    assert abs(about_line) < fit.sigma_rad
    assert fit.sigma_rad == pytest.approx(0.001 / width_m, rel=0.15)


# --- verticals -----------------------------------------------------------------------------------------------------


def descent(width_m: float) -> Trajectory:
    line = transect(width_m=width_m)
    return replace(line, positions=line.positions[:, [1, 2, 0]] * [1, 1, -0.3])


def test_an_exact_descent_does_not_determine_yaw():
    message = refusal(descent(0.0), noisy(descent(0.0), 0.001))
    assert "'posyaw'" in message
    assert "does not move horizontally" in message
    assert message.endswith("choose another alignment (origin or none)")


def test_a_descent_on_a_narrow_helix_is_flagged_with_the_uncertainty_of_its_yaw():
    truth = descent(0.002)
    result = score(truth, noisy(truth, 0.001))
    sigma = result.metrics["alignment_sigma_deg"]
    assert sigma == pytest.approx(np.rad2deg(0.5), rel=0.1)
    assert any(f"yaw is uncertain by {sigma:.0f} deg" in note for note in result.notes)


# --- scale ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("align", ["sim3", "scale"])
@pytest.mark.parametrize("noise_m", [0.0, 1e-8, 1e-4])
def test_a_stuck_estimate_is_refused_and_not_scaled_a_hundred_million_times(align, noise_m):
    truth = survey()
    stuck = noisy(replace(truth, positions=np.zeros_like(truth.positions)), noise_m)
    message = refusal(truth, stuck, align=align)
    assert "the estimate does not move" in message


@pytest.mark.parametrize("align", ["sim3", "scale"])
def test_an_estimate_that_jitters_in_one_place_is_scaled_with_a_flag(align):
    truth = survey()
    stuck = noisy(replace(truth, positions=np.zeros_like(truth.positions)), 0.05)
    notes = score(truth, stuck, SlamSettings(align=align)).notes
    assert any("of the true motion: it has hardly any motion in common with it" in note for note in notes)


def test_a_scale_of_a_thousand_is_found_and_said():
    truth = survey()
    small = replace(truth, positions=truth.positions / 500)
    result = score(truth, small, SlamSettings(align="sim3"))
    assert result.metrics["scale"] == pytest.approx(500)
    assert any("scales the estimate by 500: is it in another unit than m, or stuck?" in note for note in result.notes)


def test_scale_alone_turns_and_moves_nothing():
    truth = survey()
    turned = turned_about_x(replace(truth, positions=truth.positions / 2), 90)
    result = score(truth, turned, SlamSettings(align="scale"))
    assert result.alignment.scale == pytest.approx(2)
    np.testing.assert_array_equal(result.alignment.rotation, np.eye(3))
    np.testing.assert_array_equal(result.alignment.translation, np.zeros(3))


# --- all and first poses -------------------------------------------------------------------------------------------


@pytest.mark.parametrize("align", ["posyaw", "se3"])
def test_the_first_poses_alone_can_carry_the_alignment(align):
    truth = survey()
    t = np.linspace(0, 1, len(truth))[:, None]
    bending = moved(replace(truth, positions=truth.positions + 3 * t**2), Rotation.from_euler("z", 1.0), (1, 2, 3))
    whole = score(truth, bending, SlamSettings(align=align))
    first = score(truth, bending, SlamSettings(align=align, align_first=200))
    assert first.error_m[:200].max() < 0.2 < whole.error_m[:200].max()
    assert first.metrics["ate_rmse_m"] > whole.metrics["ate_rmse_m"]


def test_first_poses_on_a_line_are_refused_though_the_whole_path_is_none():
    truth = survey()
    positions = truth.positions.copy()
    positions[:100] = np.linspace([-10, 3, -3], positions[100], 100, endpoint=False)
    truth = replace(truth, positions=positions)
    assert "one line" in refusal(truth, truth, align="se3", align_first=100)
    assert score(truth, truth, SlamSettings(align="se3")).metrics["ate_rmse_m"] < 1e-9


@pytest.mark.parametrize("align", ["posyaw", "se3"])
def test_first_poses_at_rest_are_flagged_as_a_guess(align):
    """The estimate wavers by 1 cm while the vehicle moves by some: any yaw fits its first poses."""
    truth = survey()
    resting = truth.positions.copy()
    resting[:200] = resting[200] + 0.003 * (resting[:200] - resting[200])
    truth = replace(truth, positions=resting)
    result = score(truth, noisy(truth), SlamSettings(align=align, align_first=200))
    assert result.metrics["alignment_sigma_deg"] > 60
    assert any("is a guess, uncertain by" in note for note in result.notes)
    assert score(truth, noisy(truth), SlamSettings(align=align)).notes == ()


@pytest.mark.parametrize("align", ["none", "origin", "scale"])
def test_what_fits_no_rotation_has_no_condition_and_says_why(align):
    result = score(survey(), survey(), SlamSettings(align=align))
    for key in ("alignment_condition", "alignment_sigma_deg"):
        assert np.isnan(result.metrics[key])
        assert result.reasons[key] == f"alignment '{align}' fits no rotation to the path"


def test_singular_values_are_those_of_the_path():
    rng = stream(8, b"", "cloud")
    truth = survey()
    truth = replace(truth, positions=rng.normal(0, 1, truth.positions.shape) * [4, 2, 1])
    fit = score(truth, truth, SlamSettings(align="se3")).fit
    np.testing.assert_allclose(fit.singular_values, [16, 4, 1], rtol=0.1)
    assert fit.condition == pytest.approx(np.sqrt(20 / 5), rel=0.1)
    assert fit.sigma_rad == pytest.approx(0, abs=1e-9)


# --- poses of another frame ----------------------------------------------------------------------------------------


def of_camera(trajectory: Trajectory, T_body_camera: np.ndarray, turn: Rotation, scale: float) -> Trajectory:
    """The exact path of a camera in another world, a metre of which is `scale` long, as the reader hands it on."""
    seen = moved(poses_of_frame(trajectory, T_body_camera), turn, (3, -2, 1))
    return poses_of_body(scaled(replace(seen, T_body_estimate=None), scale), T_body_camera)


arms = st.tuples(*[st.floats(-2, 2)] * 3)
turns = st.tuples(*[st.floats(-3, 3)] * 3)


@settings(max_examples=40, deadline=None)
@given(arms, turns, turns, st.floats(0.01, 50), st.sampled_from(["interpolate", "nearest"]))
def test_the_exact_path_of_a_camera_is_exact_whatever_its_scale_and_lever_arm(arm, mounted, world, scale, associate):
    """A lever arm in metres on a path without scale made 0.36 m of it."""
    place = transform(Rotation.from_rotvec(mounted).as_matrix(), np.array(arm))
    sure = replace(survey(), covariances=np.tile(1e-4 * np.eye(6), (len(survey()), 1, 1)))
    result = score(
        survey(),
        of_camera(sure, place, Rotation.from_rotvec(world), scale),
        SlamSettings(align="sim3", associate=associate),
    )
    assert result.metrics["ate_rmse_m"] < 1e-8
    assert result.metrics["ate_rotation_rmse_deg"] < 1e-5
    assert result.metrics["rpe_1s_translation_rmse_m"] < 1e-8
    assert result.metrics["score"] == pytest.approx(1)
    assert result.metrics["scale"] == pytest.approx(1 / scale)
    assert result.metrics["nees_pose"] == pytest.approx(0, abs=1e-6)


@settings(max_examples=20, deadline=None)
@given(arms, st.sampled_from(["none", "origin", "posyaw", "se3", "sim3", "scale"]))
def test_the_exact_path_of_a_camera_in_metres_is_exact_by_every_alignment(arm, align):
    place = transform(Rotation.from_rotvec([0.3, -1.0, 2.0]).as_matrix(), np.array(arm))
    estimate = poses_of_body(poses_of_frame(survey(), place), place)
    metrics = score(survey(), estimate, SlamSettings(align=align)).metrics
    assert metrics["ate_rmse_m"] < 1e-9
    assert metrics["scale"] == pytest.approx(1)


@pytest.mark.parametrize("scale", [0.1, 0.5, 20.0])
def test_scale_alone_is_fitted_to_the_poses_that_were_estimated(scale):
    place = transform(np.eye(3), np.array([0.4, 0.1, -0.2]))
    camera = replace(poses_of_frame(survey(), place), T_body_estimate=None)
    estimate = poses_of_body(scaled(camera, scale), place)
    metrics = score(survey(), estimate, SlamSettings(align="scale")).metrics
    assert metrics["scale"] == pytest.approx(1 / scale)
    assert metrics["ate_rmse_m"] < 1e-9


def test_the_clock_of_a_camera_without_scale_is_found():
    place = transform(np.eye(3), np.array([0.8, 0.5, 0.0]))
    truth = dive(3)
    late = of_camera(truth, place, Rotation.identity(), 0.02)
    late = replace(late, stamps_ns=late.stamps_ns - 400_000_000)
    result = score(truth, late, SlamSettings(align="sim3", time_offset_s="estimate"))
    assert result.metrics["time_offset_s"] == pytest.approx(0.4, abs=1e-3)
    assert result.metrics["ate_rmse_m"] < 5e-3


def test_whoever_aligns_a_camera_without_scale_rigidly_is_told_what_sim3_would_leave():
    place = transform(np.eye(3), np.array([2.0, 0.0, 0.0]))
    estimate = of_camera(survey(), place, Rotation.identity(), 0.1)
    (note,) = (n for n in score(survey(), estimate).notes if "ATE would be" in n)
    assert float(note.split("ATE would be ")[1].split()[0]) < 1e-9
    assert "scale 10 " in note
