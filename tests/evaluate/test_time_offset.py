"""The time offset of an estimate: given, or found from the motion and told with how sure it is."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from oysterbench.core.errors import TrajectoryError
from oysterbench.core.streams import stream
from oysterbench.core.trajectory import Trajectory
from oysterbench.evaluate.slam.scoring import SlamSettings, score
from oysterbench.evaluate.slam.time_offset import estimate_offset, shift
from tests.helpers.dives import dive, moved, noisy, transect


@given(seed=st.integers(0, 2**32 - 1), offset_s=st.floats(-3, 3))
@settings(max_examples=25, deadline=None)
def test_an_offset_is_found_to_a_fraction_of_a_frame_whatever_the_frames(seed, offset_s):
    """The estimate is in another world and of another body frame, at another rate, with noise."""
    truth = dive(seed)
    rng = stream(seed, b"", "noise")
    estimate = moved(noisy(truth, 0.005, case=seed).select(slice(3, None, 3)), Rotation.random(rng=rng), (5, 6, 7))
    mount = Rotation.random(rng=rng)
    jitter = Rotation.from_rotvec(rng.normal(0, 0.001, (len(estimate), 3)))
    attitudes = (Rotation.from_quat(estimate.quaternions) * jitter * mount).as_quat()
    found = estimate_offset(truth, shift(replace(estimate, quaternions=attitudes), -offset_s))
    assert found.offset_s == pytest.approx(offset_s, abs=0.01)
    assert abs(found.offset_s - offset_s) < 5 * found.sigma_s + 0.002
    assert found.correlation > 0.9


def test_a_clock_that_starts_at_zero_is_brought_to_the_truths():
    truth = dive(1)
    begun = int(truth.stamps_ns[0])
    estimate = replace(noisy(truth, 0.001), stamps_ns=truth.stamps_ns - begun)
    result = score(truth, estimate, SlamSettings(time_offset_s="estimate"))
    assert result.metrics["time_offset_s"] == pytest.approx(begun * 1e-9, abs=0.01)
    assert result.metrics["coverage"] > 0.99
    assert any("were added to the estimate's timestamps, found from the" in note for note in result.notes)


def test_the_score_of_a_late_estimate_is_mended_by_its_offset_given_or_found():
    truth = dive(2)
    late = shift(truth, 0.4)
    as_it_is = score(truth, late).metrics["ate_rmse_m"]
    for asked in (-0.4, "estimate"):
        metrics = score(truth, late, SlamSettings(time_offset_s=asked)).metrics
        assert metrics["time_offset_s"] == pytest.approx(-0.4, abs=0.002)
        assert metrics["ate_rmse_m"] < 0.02 * as_it_is
    assert "time_offset_sigma_s" not in score(truth, late).metrics


def test_the_offset_is_less_sure_with_more_noise():
    truth = dive(3)
    rng = stream(3, b"", "shake")
    sigmas = []
    for size in (0.0005, 0.005):
        shake = Rotation.from_rotvec(rng.normal(0, size, (len(truth), 3)))
        attitudes = (Rotation.from_quat(truth.quaternions) * shake).as_quat()
        sigmas.append(estimate_offset(truth, replace(noisy(truth, 10 * size), quaternions=attitudes)).sigma_s)
    assert sigmas[0] < 0.5 * sigmas[1]


def test_a_steady_motion_has_no_offset_to_be_found():
    with pytest.raises(TrajectoryError, match="cannot be found: by angular speed nothing varies") as caught:
        estimate_offset(transect(), transect())
    assert "\n" not in str(caught.value)
    assert "give it in seconds" in str(caught.value)


def test_a_motion_that_repeats_has_two_offsets_and_is_refused():
    t = np.arange(0, 60, 0.05)
    angle = 0.3 * np.sin(2 * np.pi * t / 5)
    stamps = np.round(t * 1e9).astype(np.int64)
    swinging = Trajectory(
        stamps,
        np.column_stack([np.sin(2 * np.pi * t / 5), 0 * t, 0 * t]),
        Rotation.from_euler("z", angle[:, None]).as_quat(),
    )
    with pytest.raises(TrajectoryError, match="two offsets fit equally well"):
        estimate_offset(swinging, swinging)


def test_two_different_dives_have_no_offset():
    with pytest.raises(TrajectoryError, match=r"best correlation is|two offsets"):
        estimate_offset(dive(4), dive(5))


def test_an_offset_is_no_time():
    with pytest.raises(TrajectoryError, match="'time_offset_s': expected seconds or 'estimate', got 'guess'"):
        SlamSettings(time_offset_s="guess")
    with pytest.raises(TrajectoryError, match="'time_offset_s'"):
        SlamSettings(time_offset_s=float("nan"))
