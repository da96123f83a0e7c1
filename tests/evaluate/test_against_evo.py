"""Our numbers are evo's: an independent implementation, on random trajectories, to 1e-9."""

from __future__ import annotations

import warnings

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from oysterbench.evaluate.slam import SlamSettings, pairs_over_time, relative_errors, score
from oysterbench.streams import stream
from oysterbench.trajectory import Trajectory

with warnings.catch_warnings():
    warnings.simplefilter("ignore")  # evo's plotting dependencies warn when they are imported
    from evo.core import metrics, sync
    from evo.core.trajectory import PoseTrajectory3D

CASES = range(60)
TOLERANCE = {"rtol": 1e-9, "atol": 1e-9}
ALIGNMENTS = ("none", "origin", "se3", "sim3")


def random_pair(case: int, stamp_jitter_s: float = 0.0) -> tuple[Trajectory, Trajectory]:
    """A random walk and an estimate of it: turned, moved, scaled and noisy. Stamps are exact in seconds as float64."""
    rng = stream(17, b"", "evo", case)
    n = int(rng.integers(30, 70))
    step_ns = int(rng.choice([50_000_000, 100_000_000, 250_000_000]))
    stamps = np.arange(n, dtype=np.int64) * step_ns + 1_000 * 10**9
    positions = np.cumsum(rng.normal(0.0, 0.2, (n, 3)), axis=0) * [1.0, 1.0, rng.uniform(0.1, 1.0)]
    rotations = Rotation.from_rotvec(np.cumsum(rng.normal(0.0, 0.1, (n, 3)), axis=0))
    turn = Rotation.random(rng=rng)
    noise = rng.uniform(0.001, 0.3)
    estimate_positions = rng.uniform(0.3, 3.0) * turn.apply(positions + rng.normal(0, noise, (n, 3)))
    estimate_rotations = turn * rotations * Rotation.from_rotvec(rng.normal(0, noise, (n, 3)))
    jitter = np.round(rng.uniform(-stamp_jitter_s, stamp_jitter_s, n) * 1e9).astype(np.int64)
    return (
        Trajectory(stamps, positions, rotations.as_quat()),
        Trajectory(stamps + jitter, estimate_positions + rng.normal(0, 5, 3), estimate_rotations.as_quat()),
    )


def as_evo(trajectory: Trajectory) -> PoseTrajectory3D:
    return PoseTrajectory3D(
        positions_xyz=trajectory.positions.copy(),
        orientations_quat_wxyz=trajectory.quaternions[:, [3, 0, 1, 2]],
        timestamps=trajectory.stamps_ns * 1e-9,
    )


def evo_aligned(truth: Trajectory, estimate: Trajectory, align: str) -> tuple[PoseTrajectory3D, PoseTrajectory3D]:
    reference, estimated = sync.associate_trajectories(as_evo(truth), as_evo(estimate), max_diff=0.01)
    if align == "origin":
        estimated.align_origin(reference)
    elif align != "none":
        estimated.align(reference, correct_scale=align == "sim3")
    return reference, estimated


def evo_statistics(metric, pair) -> dict[str, float]:
    metric.process_data(pair)
    return metric.get_all_statistics()


@pytest.mark.parametrize("associate", ["interpolate", "nearest"])
@pytest.mark.parametrize("align", ALIGNMENTS)
def test_absolute_errors_equal_evo(align, associate):
    for case in CASES:
        truth, estimate = random_pair(case)
        result = score(truth, estimate, SlamSettings(align=align, associate=associate))
        pair = evo_aligned(truth, estimate, align)
        translation = evo_statistics(metrics.APE(metrics.PoseRelation.translation_part), pair)
        angle = evo_statistics(metrics.APE(metrics.PoseRelation.rotation_angle_deg), pair)
        np.testing.assert_allclose(
            [result.metrics[f"ate_{key}_m"] for key in ("rmse", "mean", "median", "max")],
            [translation[key] for key in ("rmse", "mean", "median", "max")],
            **TOLERANCE,
        )
        np.testing.assert_allclose(
            [result.metrics[f"ate_rotation_{key}_deg"] for key in ("rmse", "median", "max")],
            [angle[key] for key in ("rmse", "median", "max")],
            **TOLERANCE,
        )
        np.testing.assert_allclose(result.metrics["path_length_m"], as_evo(truth).path_length, **TOLERANCE)


@pytest.mark.parametrize("align", ALIGNMENTS)
def test_nearest_association_with_jittered_stamps_equals_evo(align):
    for case in CASES:
        truth, estimate = random_pair(case, stamp_jitter_s=0.015)
        result = score(truth, estimate, SlamSettings(align=align, associate="nearest"))
        pair = evo_aligned(truth, estimate, align)
        statistics = evo_statistics(metrics.APE(metrics.PoseRelation.translation_part), pair)
        assert result.metrics["matched"] == pair[0].num_poses < len(truth)
        np.testing.assert_allclose(result.metrics["ate_rmse_m"], statistics["rmse"], **TOLERANCE)
        np.testing.assert_allclose(result.metrics["ate_max_m"], statistics["max"], **TOLERANCE)


@pytest.mark.parametrize("all_pairs", [True, False])
@pytest.mark.parametrize("delta", [1, 7])
@pytest.mark.parametrize("align", ALIGNMENTS)
def test_relative_errors_over_frames_equal_evo(align, delta, all_pairs):
    for case in CASES[::3]:
        truth, estimate = random_pair(case)
        result = score(truth, estimate, SlamSettings(align=align))
        starts = np.arange(0, len(truth) - delta, 1 if all_pairs else delta)
        ours_m, ours_rad = relative_errors(
            result.truth.matrices, result.estimate.matrices, np.column_stack([starts, starts + delta])
        )
        pair = evo_aligned(truth, estimate, align)
        for relation, ours in (
            (metrics.PoseRelation.translation_part, ours_m),
            (metrics.PoseRelation.rotation_angle_deg, np.rad2deg(ours_rad)),
        ):
            rpe = metrics.RPE(relation, delta, metrics.Unit.frames, all_pairs=all_pairs)
            rpe.process_data(pair)
            np.testing.assert_allclose(ours, rpe.error, **TOLERANCE)


def test_relative_errors_over_one_second_equal_evos_over_that_many_frames():
    for case in CASES[::3]:
        truth, estimate = random_pair(case)
        frames = round(1e9 / int(truth.stamps_ns[1] - truth.stamps_ns[0]))
        result = score(truth, estimate, SlamSettings(align="se3"))
        pair = evo_aligned(truth, estimate, "se3")
        for relation, key in (
            (metrics.PoseRelation.translation_part, "rpe_1s_translation_rmse_m"),
            (metrics.PoseRelation.rotation_angle_deg, "rpe_1s_rotation_rmse_deg"),
        ):
            rpe = metrics.RPE(relation, frames, metrics.Unit.frames, all_pairs=True)
            np.testing.assert_allclose(result.metrics[key], evo_statistics(rpe, pair)["rmse"], **TOLERANCE)
        assert len(pairs_over_time(truth.stamps_ns, 1.0)) == result.metrics["rpe_1s_pairs"] == len(truth) - frames


def test_interpolation_at_the_truth_stamps_equals_evos():
    """evo resamples the longer trajectory at the stamps of the shorter one: here the estimate, at the truth's."""
    for case in CASES[::3]:
        dense, _ = random_pair(case)
        truth = dense.select(slice(2, -2, 3))
        shifted = Trajectory(dense.stamps_ns - 4_000_000, dense.positions, dense.quaternions)
        result = score(truth, shifted, SlamSettings(align="none"))
        pair = sync.associate_trajectories(
            as_evo(truth), as_evo(shifted), max_diff=0.01, sync_method=sync.SyncMethod.interpolation
        )
        for relation, key in (
            (metrics.PoseRelation.translation_part, "ate_rmse_m"),
            (metrics.PoseRelation.rotation_angle_deg, "ate_rotation_rmse_deg"),
        ):
            np.testing.assert_allclose(
                result.metrics[key], evo_statistics(metrics.APE(relation), pair)["rmse"], **TOLERANCE
            )
