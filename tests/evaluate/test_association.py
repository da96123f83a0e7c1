"""Which poses of an estimate answer for which of the truth: gaps, rates, ends, and pairs that never meet."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from oysterbench.evaluate.slam.association import covered_stamps, nearest_pairs
from oysterbench.evaluate.slam.scoring import SlamSettings, score
from tests.helpers.dives import EPOCH_NS, noisy, refusal, survey


def test_a_gap_in_the_estimate_is_not_interpolated_and_lowers_coverage():
    truth, estimate = survey(), noisy(survey(rate_hz=10))
    seconds = (estimate.stamps_ns - EPOCH_NS) * 1e-9
    result = score(truth, estimate.select((seconds <= 5) | (seconds >= 10)))
    assert result.metrics["coverage"] == pytest.approx(0.75, abs=0.002)
    answered = (result.stamps_ns - EPOCH_NS) * 1e-9
    assert not ((answered > 5) & (answered < 10)).any()


def test_keyframes_farther_apart_than_the_gap_answer_their_own_stamps_only():
    seconds = np.array([0, 50, 60, 100]) * 10**9
    np.testing.assert_array_equal(
        np.flatnonzero(covered_stamps(np.arange(0, 110, 10) * 10**9, seconds, 20.0)), [0, 5, 6, 10]
    )


def test_poses_exactly_the_largest_gap_apart_are_not_too_rare_however_their_timestamps_were_rounded():
    truth = survey(rate_hz=20)
    poses = truth.select(slice(0, 397, 6))  # every 0.3 s
    for stamps_ns in (poses.stamps_ns, (poses.stamps_ns * 1e-9 * 1e9).astype(np.int64)):  # exact, and as doubles
        result = score(truth, replace(poses, stamps_ns=stamps_ns))
        assert result.metrics["coverage"] == pytest.approx(397 / 401)
        assert result.notes == ()
    late = poses.stamps_ns + np.arange(len(poses)) % 2 * 10_000
    assert score(truth, replace(poses, stamps_ns=late)).metrics["coverage"] < 0.6


def test_the_first_and_last_poses_answer_however_their_timestamps_were_rounded():
    truth = survey()
    stamps_ns = truth.stamps_ns.copy()
    stamps_ns[0] += 400  # as a float64 of seconds since 1970 has it
    stamps_ns[-1] -= 400_000  # as three decimals have it
    metrics = score(truth, replace(truth, stamps_ns=stamps_ns)).metrics
    assert metrics["coverage"] == 1.0
    assert metrics["score"] == pytest.approx(1.0, abs=1e-3)
    stamps_ns[-1] -= 5_000_000
    assert score(truth, replace(truth, stamps_ns=stamps_ns)).metrics["coverage"] < 1.0


def test_coverage_does_not_depend_on_the_association():
    truth, estimate = survey(rate_hz=200), noisy(survey(rate_hz=20))
    nearest = score(truth, estimate, SlamSettings(associate="nearest")).metrics
    interpolated = score(truth, estimate).metrics
    assert nearest["coverage"] == interpolated["coverage"] == 1
    assert nearest["matched"] == len(estimate)
    assert interpolated["matched"] == len(truth)


def test_poses_that_found_no_partner_near_enough_are_told_of():
    truth = survey(rate_hz=20)
    shifted = np.where(np.arange(len(truth)) % 2, 15_000_000, 0)
    estimate = replace(truth, stamps_ns=truth.stamps_ns + shifted)
    result = score(truth, estimate, SlamSettings(associate="nearest"))
    assert result.metrics["coverage"] == 1.0
    told = [note for note in result.notes if "that could be compared" in note]
    assert len(told) == 1
    assert told[0].startswith(f"errors are those of {result.metrics['matched']:.0f} poses, of {len(truth) - 1} that")
    for rate_hz in (5, 20, 100):  # rarer or more often than the truth: no pose is far from all of its stamps
        found = score(truth, survey(rate_hz=rate_hz), SlamSettings(associate="nearest"))
        assert not [note for note in found.notes if "that could be compared" in note]
    assert not [note for note in score(truth, estimate).notes if "that could be compared" in note]


def test_nearest_association_uses_no_pose_twice_and_prefers_the_closest():
    stamps = np.array([0, 10, 20, 30, 40]) * 1_000_000
    estimate = np.array([4, 12, 33]) * 1_000_000
    mine, theirs = nearest_pairs(stamps, estimate, 0.01)
    np.testing.assert_array_equal(mine, [0, 1, 3])
    np.testing.assert_array_equal(theirs, [0, 1, 2])


def test_a_truth_at_a_low_rate_is_answered_at_all_its_stamps_and_said_to_be_sparse():
    """2 Hz with stamps between the estimate's: nearest matching within 10 ms drops them; interpolation drops none."""
    truth, estimate = survey(rate_hz=2), survey(rate_hz=20, start_ns=EPOCH_NS - 13_000_000)
    estimate = replace(estimate, positions=survey(rate_hz=20).positions)
    result = score(truth, noisy(estimate, 0.001), SlamSettings(max_difference_s=0.02))
    assert result.metrics["matched"] == len(truth) - 1
    assert result.metrics["rpe_1s_pairs"] == len(truth) - 3
    (note,) = result.notes
    assert note.startswith(
        "the ground truth has 41 timestamps, 0.5 s apart, for the estimate's 401 poses, 0.05 s apart"
    )
    assert result.reasons["velocity_rmse_m_per_s"] == "no two matched poses are 0.2 s apart"
    assert "covers 0 of 41 ground-truth timestamps" in refusal(truth, estimate, associate="nearest")


def test_keyframes_alone_answer_as_many_stamps_as_they_are():
    """1 Hz on stamps of a 50 Hz truth: 21 of 1001, however good; they must not outrank what answers all."""
    truth = survey()
    keyframes = truth.select(slice(None, None, 50))
    metrics = score(truth, keyframes).metrics
    assert metrics["ate_rmse_m"] < 1e-12
    assert metrics["matched"] == 21
    assert metrics["coverage"] == pytest.approx(21 / 1001)
    assert metrics["score"] == pytest.approx(21 / 1001)
    assert (metrics["gaps"], metrics["longest_gap_s"]) == (20, pytest.approx(1.0))
    bad = replace(truth, positions=truth.positions + np.linspace(0, 3, len(truth))[:, None])
    assert score(truth, bad).metrics["score"] > 5 * metrics["score"]
    assert score(truth, keyframes, SlamSettings(max_gap_s=1.0)).metrics["coverage"] == 1


def test_gaps_and_the_first_fix_are_told_in_seconds():
    truth = survey(rate_hz=10)
    seconds = (truth.stamps_ns - EPOCH_NS) * 1e-9
    answered = (
        (seconds >= 2) & ~((seconds > 5) & (seconds < 9)) & ~((seconds > 12) & (seconds < 13)) & (seconds < 18.05)
    )
    metrics = score(truth, noisy(truth.select(answered))).metrics
    assert metrics["first_fix_s"] == pytest.approx(2.0)
    assert metrics["gaps"] == 3
    assert metrics["longest_gap_s"] == pytest.approx(4.0)
    whole = score(truth, noisy(truth)).metrics
    assert (whole["first_fix_s"], whole["gaps"], whole["longest_gap_s"]) == (0, 0, 0)


def test_no_common_time_is_refused_with_both_spans_and_the_offset():
    message = refusal(survey(), survey(start_ns=0))
    for part in ("1700000000.000000000 to 1700000020.000000000", "0.000000000 to 20.000000000", "before it"):
        assert part in message
    assert "1700000000.000000000 s before" in message


def test_no_common_time_is_laid_to_neither_of_the_two():
    message = refusal(survey(start_ns=0), survey())
    assert "both need the timestamps of the sensor data: correct the one that has others" in message


def test_two_poses_are_told_from_poses_that_are_too_rare():
    message = refusal(survey(), survey().select([0, 1000]))
    assert message.endswith("it has 2 poses and needs 5 at least: give one for each image")
    assert "more often" in refusal(survey(), survey(rate_hz=0.7, start_ns=EPOCH_NS + 5_000_000))


def test_common_time_without_a_match_is_refused_with_the_cause():
    sparse = survey(rate_hz=0.7, start_ns=EPOCH_NS + 5_000_000)
    assert "up to 0.3 s (--max-gap)" in refusal(survey(), sparse)
    message = refusal(survey(), sparse, associate="nearest", max_difference_s=0.001)
    assert "may be 0.001 s away (--max-difference)" in message


def test_a_handful_of_matched_poses_is_refused():
    assert "covers 4 of 1001 ground-truth timestamps" in refusal(survey(), survey().select(slice(0, 4)))


def test_a_truth_of_too_few_poses_is_named_and_no_estimate_blamed():
    message = refusal(survey().select([0, 300, 600, 900]), survey())
    assert message.startswith("the ground truth has 4 poses, expected at least 5")
    assert "4 poses" in refusal(survey().select([0, 300, 600, 900]), survey(), associate="nearest")
