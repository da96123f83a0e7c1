"""Segments: KITTI's and rpg's definitions, on cases made by hand and on random ones, and where rpg's tool errs."""

from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from oysterbench.core.geometry import invert
from oysterbench.core.streams import stream
from oysterbench.core.trajectory import Trajectory
from oysterbench.evaluate.slam.pairs import distances, segments
from oysterbench.evaluate.slam.pose_errors import absolute_errors, relative_errors
from oysterbench.evaluate.slam.scoring import SlamSettings, score
from tests.helpers.dives import moved, noisy, survey, transect

seeds = st.integers(0, 2**32 - 1)


def kitti_errors(truth: np.ndarray, estimate: np.ndarray, lengths: list[float], step: int) -> list[tuple[float, float]]:
    """Translation and rotation error by length of every segment, as the KITTI devkit defines them (Geiger 2012).

    Loops over (4, 4) matrices: from every step-th frame to the first that is farther than the length along the path,
    E = (P_i^-1 P_j)^-1 (Q_i^-1 Q_j), |t| / length and angle / length.
    """
    path = [0.0]
    for a, b in itertools.pairwise(truth):
        path.append(path[-1] + float(np.linalg.norm(b[:3, 3] - a[:3, 3])))
    errors = []
    for first in range(0, len(truth), step):
        for length in lengths:
            last = next((k for k in range(first, len(path)) if path[k] > path[first] + length), None)
            if last is None:
                continue
            true_motion = np.linalg.inv(truth[first]) @ truth[last]
            error = np.linalg.inv(np.linalg.inv(estimate[first]) @ estimate[last]) @ true_motion
            angle = np.arccos(np.clip((np.trace(error[:3, :3]) - 1) / 2, -1, 1))
            errors.append((float(np.linalg.norm(error[:3, 3])) / length, float(angle) / length))
    return errors


def test_a_scale_error_of_one_percent_drifts_one_percent_on_a_straight_path():
    """Every 10th of 301 frames, 0.1 m apart: segments of 5 m end at the first frame beyond, 5.1 m on."""
    truth = transect()
    far = replace(truth, positions=truth.positions * [1.01, 1, 1])
    metrics = score(truth, far, SlamSettings(align="none", subpath_m=(4.95, 10.05), subpath_step=10)).metrics
    assert metrics["subpath_4.95m_translation_percent"] == pytest.approx(1.0 * 5.0 / 4.95)
    assert metrics["subpath_segments"] == 26 + 20
    assert metrics["subpath_rotation_deg_per_m"] == pytest.approx(0, abs=1e-9)
    assert metrics["subpath_scale"] == pytest.approx(1.01)
    assert metrics["subpath_scale_error_percent"] == pytest.approx(1.0)
    assert metrics["drift_percent"] == pytest.approx(1.0)


def test_a_turn_of_one_degree_a_metre_is_told_as_such():
    truth = transect()
    angle = np.deg2rad(truth.positions[:, 0])
    turning = replace(truth, quaternions=Rotation.from_euler("z", angle[:, None]).as_quat())
    metrics = score(truth, turning, SlamSettings(align="none", subpath_m=(9.95,))).metrics
    assert metrics["subpath_rotation_deg_per_m"] == pytest.approx(10.0 / 9.95)
    assert metrics["subpath_yaw_deg_per_m"] == pytest.approx(10.0 / 9.95)
    assert metrics["subpath_tilt_deg_per_m"] == pytest.approx(0, abs=1e-6)
    assert metrics["drift_deg_per_m"] == pytest.approx(1.0)


@given(seed=seeds, step=st.sampled_from([1, 3, 10]))
@settings(max_examples=25, deadline=None)
def test_random_sub_paths_equal_the_kitti_devkits(seed, step):
    rng = stream(seed, b"", "kitti")
    n = int(rng.integers(30, 90))
    truth, estimate = (
        Trajectory(
            np.arange(n) * 100_000_000,
            np.cumsum(rng.normal(0, 0.3, (n, 3)), axis=0),
            Rotation.from_rotvec(np.cumsum(rng.normal(0, 0.2, (n, 3)), axis=0)).as_quat(),
        )
        for _ in range(2)
    )
    lengths = [float(round(share * truth.path_length, 3)) for share in (0.1, 0.25, 0.5)]
    metrics = score(truth, estimate, SlamSettings(align="none", subpath_m=tuple(lengths), subpath_step=step)).metrics
    theirs = np.array(kitti_errors(truth.matrices, estimate.matrices, lengths, step))
    assert metrics["subpath_segments"] == len(theirs)
    assert metrics["subpath_translation_percent"] == pytest.approx(100 * theirs[:, 0].mean(), rel=1e-9)
    assert metrics["subpath_rotation_deg_per_m"] == pytest.approx(np.rad2deg(theirs[:, 1].mean()), rel=1e-6)


def rpg_errors(truth: np.ndarray, estimate: np.ndarray, length: float, shifted: bool = False) -> np.ndarray:
    """Translation in percent, yaw and gravity error in rad of sub-trajectories of matched poses (Zhang 2018).

    The end is the pose nearest to length along the path, if within 0.2 of it. `shifted` pairs the list of found ends
    with the first starts, which is right only while every start has an end: the published tool's defect.
    """
    path = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(truth[:, :3, 3], axis=0), axis=1))])
    starts, ends = [], []
    for first in range(len(path)):
        off = np.abs(path[first:] - path[first] - length)
        if off.min() < 0.2 * length:
            starts.append(first)
            ends.append(first + int(np.argmin(off)))
    if shifted:
        starts = list(range(len(ends)))
    rows = []
    for i, j in zip(starts, ends, strict=True):
        error = invert(invert(truth[i]) @ truth[j]) @ (invert(estimate[i]) @ estimate[j])
        world = estimate[j][:3, :3]
        turn = Rotation.from_matrix(world @ error[:3, :3] @ world.T)
        z, w = np.abs(turn.as_quat()[2:])
        rows.append((100 * np.linalg.norm(error[:3, 3]) / length, 2 * np.arctan2(z, w), _tilt(turn)))
    return np.array(rows)


def _tilt(turn: Rotation) -> float:
    return float(np.arccos(np.clip(turn.as_matrix()[2, 2], -1, 1)))


@given(seed=seeds, share=st.sampled_from([0.1, 0.2, 0.5]))
@settings(max_examples=10, deadline=None)
def test_sub_trajectories_equal_rpgs_where_every_pose_is_matched(seed, share):
    rng = stream(seed, b"", "rpg")
    truth = survey(rate_hz=10)
    estimate = moved(noisy(truth, 0.05, case=seed), Rotation.from_euler("z", rng.uniform(0, 6)), (1, 2, 3))
    length = share * truth.path_length
    pairs = segments(distances(truth.positions), length, nearest=0.2 * length)
    errors = relative_errors(truth, estimate, pairs, absolute_errors(truth, estimate))
    theirs = rpg_errors(truth.matrices, estimate.matrices, length)
    np.testing.assert_allclose(100 * errors.translation_m / length, theirs[:, 0], rtol=1e-9)
    np.testing.assert_allclose(errors.tilt_rad, theirs[:, 2], atol=1e-6)


def test_yaw_and_gravity_errors_equal_rpgs_parts():
    truth = survey(rate_hz=10)
    rng = stream(2, b"", "parts")
    turns = Rotation.from_rotvec(np.cumsum(rng.normal(0, 0.02, (len(truth), 3)), axis=0))
    estimate = replace(truth, quaternions=(turns * Rotation.from_quat(truth.quaternions)).as_quat())
    pairs = segments(distances(truth.positions), 5.0, nearest=1.0)
    errors = relative_errors(truth, estimate, pairs, absolute_errors(truth, estimate))
    theirs = rpg_errors(truth.matrices, estimate.matrices, 5.0)
    np.testing.assert_allclose(errors.yaw_rad, theirs[:, 1], atol=1e-9)
    np.testing.assert_allclose(errors.tilt_rad, theirs[:, 2], atol=1e-6)


def test_a_gap_of_six_metres_leaves_a_drift_of_one_percent_at_one_percent():
    """30 m, 1 % too long, silent from 12 to 18 m: rpg's tool pairs shifted starts and ends and says more."""
    truth = transect()
    far = replace(truth, positions=truth.positions * [1.01, 1, 1])
    x = truth.positions[:, 0]
    broken = far.select((x <= 12.0) | (x >= 18.0))
    # A hair short of 3 m, so that the first stamp beyond is the one at 3 m.
    metrics = score(truth, broken, SlamSettings(align="none", subpath_m=(3 - 1e-9, 6 - 1e-9))).metrics
    assert metrics["subpath_3m_translation_percent"] == pytest.approx(1.0, rel=1e-8)
    assert metrics["subpath_6m_translation_percent"] == pytest.approx(1.0, rel=1e-8)
    kept = truth.select((x <= 12.0) | (x >= 18.0))
    assert rpg_errors(kept.matrices, broken.matrices, 3.0)[:, 0].mean() == pytest.approx(1.0, abs=0.01)
    assert rpg_errors(kept.matrices, broken.matrices, 3.0, shifted=True)[:, 0].mean() > 1.2
    assert 0 < metrics["subpath_coverage"] < 0.8


def test_no_sub_path_is_nan_with_the_reason_and_no_zero():
    truth = transect()
    result = score(truth, truth, SlamSettings(align="none", subpath_m=(100.0,)))
    for key in ("subpath_100m_translation_percent", "subpath_translation_percent", "subpath_rotation_deg_per_m"):
        assert np.isnan(result.metrics[key])
        assert result.reasons[key] == "the true path of 30 m has no segment of 100 m"
    assert result.metrics["subpath_segments"] == 0
    few = truth.select(slice(0, 20))
    result = score(truth, few, SlamSettings(align="none", subpath_m=(10.0,)))
    assert result.reasons["subpath_10m_translation_percent"] == "no segment of 10 m has an estimate at both ends"
