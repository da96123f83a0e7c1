"""Association, alignment, coverage, relative errors, and the cases in which other tools answer silently."""

from __future__ import annotations

import json
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from oysterbench.core.errors import TrajectoryError
from oysterbench.core.streams import stream
from oysterbench.core.trajectory import Trajectory
from oysterbench.evaluate.metrics import find_metric
from oysterbench.evaluate.slam.metrics import SLAM
from oysterbench.evaluate.slam.pairs import distances, pairs_along, pairs_over_time
from oysterbench.evaluate.slam.scoring import SlamSettings, score
from tests.helpers.dives import EPOCH_NS, dive, moved, noisy, refusal, survey

# --- what a score is -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("align", ["none", "origin", "posyaw", "se3", "sim3"])
def test_the_truth_scores_zero_against_itself(align):
    result = score(survey(), survey(), SlamSettings(align=align))
    metrics = result.metrics
    for key in metrics:
        if key.endswith("_m") and key != "path_length_m":
            assert metrics[key] == pytest.approx(0, abs=1e-12), key
        if key.endswith("_deg") and key not in result.reasons:
            assert metrics[key] == pytest.approx(0, abs=1e-5), key
    assert metrics["coverage"] == 1
    assert metrics["scale"] == pytest.approx(1)


def test_posyaw_undoes_a_turn_about_gravity_and_leaves_a_tilt():
    truth = survey()
    turned = moved(truth, Rotation.from_euler("z", 70, degrees=True), (5, -2, 1))
    assert score(truth, turned).metrics["ate_rmse_m"] < 1e-12
    tilted = moved(truth, Rotation.from_euler("x", 10, degrees=True), (0, 0, 0))
    assert score(truth, tilted).metrics["ate_rotation_rmse_deg"] == pytest.approx(10, abs=0.5)
    assert score(truth, tilted, SlamSettings(align="se3")).metrics["ate_rmse_m"] < 1e-12


def test_errors_are_in_metres_and_percent_of_the_true_path():
    truth = survey()
    shifted = moved(truth, Rotation.identity(), (0.3, 0.4, 0))
    metrics = score(truth, shifted, SlamSettings(align="none")).metrics
    for key in ("ate_rmse_m", "ate_mean_m", "ate_median_m", "ate_max_m"):
        assert metrics[key] == pytest.approx(0.5), key
    assert metrics["path_length_m"] == pytest.approx(truth.path_length)
    assert metrics["ate_percent"] == pytest.approx(50 / truth.path_length)


def test_a_steady_drift_is_the_relative_error_per_second():
    truth = survey()
    seconds = (truth.stamps_ns - truth.stamps_ns[0])[:, None] * 1e-9
    drifting = replace(truth, positions=truth.positions + seconds * [0.03, 0.04, 0])
    metrics = score(truth, drifting, SlamSettings(align="none")).metrics
    assert metrics["rpe_1s_translation_rmse_m"] == pytest.approx(0.05)
    assert metrics["rpe_1s_rotation_rmse_deg"] == pytest.approx(0, abs=1e-6)
    assert metrics["rpe_1s_pairs"] == len(truth) - 50


def test_result_holds_the_aligned_poses_and_their_errors():
    truth, estimate = survey(), noisy(survey(rate_hz=10))
    result = score(truth, estimate)
    distance = np.linalg.norm(result.estimate.positions - result.truth.positions, axis=1)
    np.testing.assert_allclose(result.error_m, distance)
    np.testing.assert_array_equal(result.stamps_ns, result.estimate.stamps_ns)
    assert len(result.rotation_error_deg) == result.metrics["matched"] == len(truth)


def test_scale_is_found_by_sim3_alone():
    truth = survey()
    half = replace(truth, positions=truth.positions * 0.5)
    assert score(truth, half, SlamSettings(align="sim3")).metrics["scale"] == pytest.approx(2)
    assert score(truth, half, SlamSettings(align="sim3")).metrics["ate_rmse_m"] < 1e-12
    assert score(truth, half, SlamSettings(align="se3")).metrics["ate_rmse_m"] > 1


EVERYTHING: tuple[dict[str, Any], ...] = (
    {},
    {"rpe_delta_s": 0.5, "rpe_frames": 7, "rpe_delta_m": 2.5, "rpe_delta_deg": 30.0, "rpe_pairs": "consecutive"},
    {"subpath_m": (1.0, 2.5, 1000.0), "subpath_step": 10, "align": "sim3", "associate": "nearest"},
    {"time_offset_s": "estimate", "align": "none"},
    {"align": "scale", "align_first": 100, "velocity_step_s": 1.0},
)


@pytest.mark.parametrize("changes", EVERYTHING)
def test_every_metric_is_defined_and_has_a_value_or_a_reason(changes):
    truth = dive(1)
    covariances = np.tile(np.diag([1e-4] * 3 + [1e-6] * 3), (len(truth), 1, 1))
    result = score(truth, replace(noisy(truth), covariances=covariances), SlamSettings(**changes))
    assert "nees_pose" in result.metrics
    for key, value in result.metrics.items():
        metric = find_metric(key)
        assert metric is not None, f"{key} is missing from evaluate/metrics.py"
        if metric.unit and not metric.unit.startswith("%"):
            assert key.endswith(f"_{metric.unit.replace('/', '_per_')}"), f"{key} does not carry its unit {metric.unit}"
        if metric.unit == "%":
            assert key.endswith("_percent"), key
        assert np.isfinite(value) != bool(result.reasons.get(key)), key
    assert set(result.reasons) <= set(result.metrics)


def test_a_metric_over_another_size_is_defined_with_that_size():
    assert find_metric("rpe_0.5s_rotation_rmse_deg").definition.count("0.5 s") == 1
    assert find_metric("rpe_1frames_pairs").definition.endswith("over 1 pose.")
    assert "10 deg apart" in find_metric("rpe_10deg_translation_rmse_m").definition
    assert find_metric("recall_3percent").heading == "Recall 3 %"
    assert find_metric("subpath_100m_translation_percent").heading == "100 m"
    for key in ("nonsense", "rpe_1s_nonsense", "rpe_1furlong_pairs", "subpath_10m_nonsense"):
        assert find_metric(key) is None


def test_every_definition_is_a_sentence():
    for key, metric in SLAM.items():
        assert metric.definition[0].isupper(), key
        assert metric.definition.endswith("."), key
        assert metric.heading, key


def test_an_estimate_in_another_frame_or_scale_is_suspected():
    truth = survey()
    tilted = moved(truth, Rotation.from_euler("x", 90, degrees=True), (0, 0, 0))
    assert any("with alignment se3 instead of posyaw" in note for note in score(truth, tilted).notes)
    half = replace(truth, positions=truth.positions * 0.5)
    assert any("sim3 and scale 2 instead of posyaw" in note for note in score(truth, half).notes)
    assert any("instead of se3" in note for note in score(truth, half, SlamSettings(align="se3")).notes)
    shifted = moved(truth, Rotation.identity(), (100, 0, 0))
    assert any("posyaw instead of none" in note for note in score(truth, shifted, SlamSettings(align="none")).notes)


@pytest.mark.parametrize("align", ["posyaw", "se3", "sim3"])
@pytest.mark.parametrize("how", [[1, -1, 1], [1, 1, -1]])
def test_an_estimate_that_is_mirrored_is_suspected(align, how):
    truth = survey()
    wave = 0.8 * np.sin(np.linspace(0, 40, len(truth)))[:, None] * [0, 0, 1]
    truth = replace(truth, positions=truth.positions + wave)  # a flat path is its own mirror image
    mirrored = replace(truth, positions=truth.positions * how)
    notes = score(truth, mirrored, SlamSettings(align=align)).notes
    assert any("mirrored, the ATE would be" in note and "left-handed" in note for note in notes), notes


def test_an_estimate_that_is_merely_bad_raises_no_suspicion_of_how_it_was_written():
    truth = survey()
    seconds = (truth.stamps_ns - truth.stamps_ns[0])[:, None] * 1e-9
    assert score(truth, noisy(truth)).notes == ()
    (note,) = score(truth, replace(truth, positions=truth.positions + seconds**2 * [0.1, 0.02, 0.01])).notes
    assert "its yaw is a guess" in note


# --- errors over time and distance ------------------------------------------------------------------------------------


def test_yaw_and_gravity_errors_are_parts_of_the_rotation_error():
    truth = survey()
    turned = Rotation.from_euler("z", 20, degrees=True) * Rotation.from_euler("x", 7, degrees=True)
    estimate = replace(truth, quaternions=(turned * Rotation.from_quat(truth.quaternions)).as_quat())
    metrics = score(truth, estimate, SlamSettings(align="none")).metrics
    assert metrics["ate_yaw_rmse_deg"] == pytest.approx(20)
    assert metrics["ate_tilt_rmse_deg"] == pytest.approx(7)
    half = np.cos(np.deg2rad(20) / 2) * np.cos(np.deg2rad(7) / 2)
    assert metrics["ate_rotation_rmse_deg"] == pytest.approx(np.rad2deg(2 * np.arccos(half)))


def test_a_velocity_error_is_that_of_a_steady_drift():
    truth = survey()
    seconds = (truth.stamps_ns - truth.stamps_ns[0])[:, None] * 1e-9
    drifting = replace(truth, positions=truth.positions + seconds * [0.03, 0.04, 0])
    for step_s in (0.1, 0.2, 1.0):
        metrics = score(truth, drifting, SlamSettings(align="none", velocity_step_s=step_s)).metrics
        assert metrics["velocity_rmse_m_per_s"] == pytest.approx(0.05)


def test_relative_pairs_over_metres_go_along_the_whole_true_path_across_a_gap():
    """The estimate is silent on a bend: the way round it counts, not the chord that its answers leave."""
    truth = survey(duration_s=18.85, rate_hz=10)
    seconds = (truth.stamps_ns - EPOCH_NS) * 1e-9
    result = score(truth, truth.select((seconds < 4) | (seconds > 12)), SlamSettings(rpe_delta_m=9.0))
    along = distances(truth.positions)
    pairs = pairs_along(along[result.covered], 9.0)
    assert result.metrics["rpe_9m_pairs"] == len(pairs)
    chords = distances(result.truth.positions)
    assert len(pairs_along(chords, 9.0)) > len(pairs)


def test_relative_pairs_are_the_asked_time_apart_or_left_out():
    stamps = np.array([0.0, 0.5, 1.0, 1.5, 2.02, 5.0])
    pairs = pairs_over_time(np.round(stamps * 1e9).astype(np.int64), 1.0)
    np.testing.assert_array_equal(pairs, [[0, 2], [1, 3], [2, 4]])


def test_relative_error_without_pairs_is_nan_with_a_reason():
    truth = survey(duration_s=0.8)
    result = score(truth, noisy(truth, 0.001))
    assert np.isnan(result.metrics["rpe_1s_translation_rmse_m"])
    assert "1 s apart" in result.reasons["rpe_1s_translation_rmse_m"]
    assert result.metrics["rpe_1s_pairs"] == 0


# --- answers that are refused --------------------------------------------------------------------------------------


@pytest.mark.parametrize("noise_m", [0.0, 0.001])
@pytest.mark.parametrize("align", ["se3", "sim3"])
def test_a_straight_transect_is_refused_where_its_rotation_is_a_guess(align, noise_m):
    truth = survey()
    line = replace(truth, positions=np.linspace([0, 0, -3], [10, 2, -3], len(truth)))
    message = refusal(line, noisy(line, noise_m), align=align)
    assert "one line" in message
    assert "posyaw" in message


def test_a_straight_transect_is_scored_by_posyaw():
    truth = survey()
    line = replace(truth, positions=np.linspace([0, 0, -3], [10, 2, -3], len(truth)))
    turned = moved(noisy(line, 0.001), Rotation.from_euler("z", 40, degrees=True), (1, 2, 3))
    metrics = score(line, turned).metrics
    assert metrics["ate_rmse_m"] < 0.002
    assert metrics["ate_rotation_rmse_deg"] < 0.1


def test_a_descent_is_refused_by_posyaw():
    truth = survey()
    descent = replace(truth, positions=np.linspace([0, 0, 0], [0, 0, -8], len(truth)))
    message = refusal(noisy(descent, 0.005), noisy(descent, 0.005, case=1))
    assert "is nearly vertical" in message
    assert "yaw is a guess" in message
    assert "choose another alignment (origin or none)" in message


@pytest.mark.parametrize("align", ["posyaw", "se3", "sim3"])
@pytest.mark.parametrize("noise_m", [0.0, 1e-8])
def test_a_stuck_estimate_is_refused_instead_of_scaled(align, noise_m):
    truth = survey()
    stuck = noisy(replace(truth, positions=np.zeros_like(truth.positions)), noise_m)
    assert "the estimate does not move" in refusal(truth, stuck, align=align)


@pytest.mark.parametrize("align", ["posyaw", "se3"])
def test_a_truth_that_stands_still_is_refused_by_fits_and_scored_by_origin(align):
    truth = survey()
    still = replace(truth, positions=np.zeros_like(truth.positions))
    assert "the reference does not move" in refusal(still, truth, align=align)
    result = score(still, truth, SlamSettings(align="origin"))
    assert np.isnan(result.metrics["ate_percent"])
    assert "does not move" in result.reasons["ate_percent"]


def test_a_tenth_of_the_sequence_is_scored_and_said_to_be_a_tenth():
    truth = survey()
    result = score(truth, noisy(truth.select(slice(0, 100))))
    assert result.metrics["coverage"] == pytest.approx(0.1, abs=0.001)
    assert any("10%" in note for note in result.notes)


@given(
    seed=st.integers(0, 2**32 - 1),
    exponents=st.tuples(*[st.integers(-12, 8)] * 4),
    align=st.sampled_from(["none", "origin", "posyaw", "se3", "sim3"]),
    associate=st.sampled_from(["interpolate", "nearest"]),
)
@settings(max_examples=150, deadline=None)
def test_any_two_trajectories_are_scored_with_numbers_or_refused(seed, exponents, align, associate):
    rng = stream(seed, b"", "any")
    pair = []
    for size, offset in (exponents[:2], exponents[2:]):
        n = int(rng.integers(2, 40))
        stamps = np.cumsum(rng.integers(1, 200_000_000, n))
        positions = np.cumsum(rng.normal(0, 10.0**size, (n, 3)), axis=0) * rng.integers(0, 2, 3) + 10.0**offset
        pair.append(Trajectory(stamps, positions, Rotation.random(n, rng=rng).as_quat()))
    try:
        result = score(*pair, SlamSettings(align=align, associate=associate))
    except TrajectoryError:
        return
    for key, value in result.metrics.items():
        assert np.isfinite(value) or result.reasons[key], key


def test_settings_that_mean_nothing_are_refused_by_name():
    with pytest.raises(TrajectoryError, match="'align': expected one of none, origin"):
        SlamSettings(align="yaw")
    with pytest.raises(TrajectoryError, match="'max_gap_s': expected more than 0"):
        SlamSettings(max_gap_s=0)
    with pytest.raises(TrajectoryError, match="'rpe_delta_s'"):
        SlamSettings(rpe_delta_s=float("nan"))
    with pytest.raises(TrajectoryError, match="'align_first': expected a whole number from 5, got 2"):
        SlamSettings(align_first=2)
    with pytest.raises(TrajectoryError, match=r"'subpath_m': expected lengths of more than 0 m, got .*-1"):
        SlamSettings(subpath_m=(3.0, -1.0))
    for lengths in (5.0, "5"):
        with pytest.raises(TrajectoryError, match=r"'subpath_m': expected a list of lengths of more than 0 m, got .*5"):
            SlamSettings(subpath_m=lengths)
    with pytest.raises(TrajectoryError, match="'rpe_angle': expected 'turned' with consecutive pairs"):
        SlamSettings(rpe_pairs="consecutive", rpe_angle="direct")


def test_all_pairs_over_an_angle_are_refused_where_there_are_too_many():
    truth = survey(duration_s=20.0, rate_hz=1200)
    assert "expected at most 20000 poses" in refusal(truth, truth, rpe_angle="direct")


def test_settings_are_plain_values_for_json():
    asked = SlamSettings(subpath_m=(1.0, 2.0), time_offset_s="estimate")
    assert SlamSettings(**json.loads(json.dumps(asked.as_dict()))) == asked
