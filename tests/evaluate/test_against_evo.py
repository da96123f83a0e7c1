"""Our numbers are evo's: an independent implementation, on random trajectories, to 1e-9."""

from __future__ import annotations

import warnings
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from oysterbench.core.streams import stream
from oysterbench.core.trajectory import Trajectory
from oysterbench.evaluate.slam.inputs import read_pair
from oysterbench.evaluate.slam.pairs import (
    distances,
    pairs_along,
    pairs_apart,
    pairs_over_frames,
    pairs_over_time,
    turned,
)
from oysterbench.evaluate.slam.pose_errors import absolute_errors, relative_errors
from oysterbench.evaluate.slam.scoring import SlamResult, SlamSettings, score
from tests.helpers import trajectory_files

with warnings.catch_warnings():
    warnings.simplefilter("ignore")  # evo's plotting dependencies warn when they are imported
    from evo.core import filters, metrics, sync
    from evo.core.trajectory import PoseTrajectory3D
    from evo.tools import file_interface

TOLERANCE: Any = {"rtol": 1e-9, "atol": 1e-9}
ALIGNMENTS = ("none", "origin", "se3", "sim3", "scale")
RELATIONS = {
    metrics.PoseRelation.translation_part: lambda errors: errors.translation_m,
    metrics.PoseRelation.rotation_part: lambda errors: errors.rotation_part,
    metrics.PoseRelation.full_transformation: lambda errors: errors.full,
    metrics.PoseRelation.rotation_angle_rad: lambda errors: errors.rotation_rad,
    metrics.PoseRelation.rotation_angle_deg: lambda errors: np.rad2deg(errors.rotation_rad),
}
seeds = st.integers(0, 2**32 - 1)
many = settings(max_examples=80, deadline=None, derandomize=True)
some = settings(max_examples=30, deadline=None, derandomize=True)


def random_pair(seed: int, stamp_jitter_s: float = 0.0) -> tuple[Trajectory, Trajectory]:
    """A random walk and an estimate of it: turned, moved, scaled and noisy. Stamps are exact in seconds as float64."""
    rng = stream(seed, b"", "evo")
    n = int(rng.integers(12, 60))
    step_ns = int(rng.choice([50_000_000, 100_000_000, 250_000_000]))
    stamps = np.arange(n, dtype=np.int64) * step_ns + 1_000 * 10**9
    positions = np.cumsum(rng.normal(0.0, 0.2, (n, 3)), axis=0) * [1.0, 1.0, rng.uniform(0.1, 1.0)]
    positions *= 10.0 ** rng.uniform(-1, 2)
    rotations = Rotation.from_rotvec(np.cumsum(rng.normal(0.0, rng.choice([0.01, 0.1, 1.0]), (n, 3)), axis=0))
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


EvoPair = tuple[PoseTrajectory3D, PoseTrajectory3D]


def evo_aligned(truth: Trajectory, estimate: Trajectory, align: str, first: int | None = None) -> EvoPair:
    reference, estimated = sync.associate_trajectories(as_evo(truth), as_evo(estimate), max_diff=0.01)
    if align == "origin":
        estimated.align_origin(reference)
    elif align != "none":
        estimated.align(
            reference,
            correct_scale=align == "sim3",
            correct_only_scale=align == "scale",
            n=-1 if first is None else first,
        )
    return reference, estimated


def evo_statistics(metric, pair: EvoPair) -> dict[str, float]:
    metric.process_data(pair)
    return metric.get_all_statistics()


def assert_absolute_errors_equal(result: SlamResult, pair: EvoPair) -> None:
    errors = absolute_errors(result.truth, result.estimate)
    for relation, ours in RELATIONS.items():
        ape = metrics.APE(relation)
        ape.process_data(pair)
        np.testing.assert_allclose(ours(errors), ape.error, **TOLERANCE, err_msg=relation.value)
    translation = evo_statistics(metrics.APE(metrics.PoseRelation.translation_part), pair)
    angle = evo_statistics(metrics.APE(metrics.PoseRelation.rotation_angle_deg), pair)
    for key in ("rmse", "mean", "median", "max"):
        np.testing.assert_allclose(result.metrics[f"ate_{key}_m"], translation[key], **TOLERANCE)
    for key in ("rmse", "median", "max"):
        np.testing.assert_allclose(result.metrics[f"ate_rotation_{key}_deg"], angle[key], **TOLERANCE)
    for key, relation in (
        ("ate_rotation_part_rmse", metrics.PoseRelation.rotation_part),
        ("ate_full_rmse", metrics.PoseRelation.full_transformation),
    ):
        np.testing.assert_allclose(
            result.metrics[key], evo_statistics(metrics.APE(relation), pair)["rmse"], **TOLERANCE
        )


@given(seed=seeds, align=st.sampled_from(ALIGNMENTS), associate=st.sampled_from(["interpolate", "nearest"]))
@many
def test_absolute_errors_of_all_relations_equal_evo(seed, align, associate):
    truth, estimate = random_pair(seed)
    result = score(truth, estimate, SlamSettings(align=align, associate=associate))
    assert_absolute_errors_equal(result, evo_aligned(truth, estimate, align))
    np.testing.assert_allclose(result.metrics["path_length_m"], as_evo(truth).path_length, **TOLERANCE)


@pytest.mark.parametrize("form", ["tum", "euroc", "kitti"])
def test_files_of_public_formats_are_read_as_evo_reads_them(tmp_path, form):
    truth, estimate = random_pair(7)
    paths = []
    for name, one in (("truth", truth), ("estimate", estimate)):
        text = getattr(trajectory_files, form)(one).decode()
        if form == "tum":  # as TUM's own recordings begin
            text = f"# ground truth trajectory\n# file: 'freiburg2_desk.bag'\n# timestamp tx ty tz qx qy qz qw\n{text}"
        paths.append(tmp_path / f"{name}.txt")
        paths[-1].write_text(text)
    read = {
        "tum": file_interface.read_tum_trajectory_file,
        "euroc": file_interface.read_euroc_csv_trajectory,
        "kitti": file_interface.read_kitti_poses_file,
    }[form]
    pair = (read(str(paths[0])), read(str(paths[1])))
    pair[1].align(pair[0], correct_scale=True)
    ours = score(*read_pair(*paths, any_scale=True), SlamSettings(align="sim3", associate="nearest"))
    assert_absolute_errors_equal(ours, pair)


@given(seed=seeds, align=st.sampled_from(["se3", "sim3", "scale"]), first=st.integers(5, 12))
@some
def test_alignment_of_the_first_poses_equals_evo(seed, align, first):
    truth, estimate = random_pair(seed)
    result = score(truth, estimate, SlamSettings(align=align, align_first=first))
    assert_absolute_errors_equal(result, evo_aligned(truth, estimate, align, first))


@given(seed=seeds, align=st.sampled_from(ALIGNMENTS))
@some
def test_nearest_association_with_jittered_stamps_equals_evo(seed, align):
    truth, estimate = random_pair(seed, stamp_jitter_s=0.012)
    pair = evo_aligned(truth, estimate, align)
    result = score(truth, estimate, SlamSettings(align=align, associate="nearest"))
    assert result.metrics["matched"] == pair[0].num_poses
    assert_absolute_errors_equal(result, pair)


def our_pairs(truth: Trajectory, delta: float, unit: metrics.Unit, all_pairs: bool) -> np.ndarray:
    if unit is metrics.Unit.frames:
        return pairs_over_frames(len(truth), int(delta), not all_pairs)
    if unit is metrics.Unit.meters:
        return pairs_along(distances(truth.positions), delta, not all_pairs)
    radians = float(np.deg2rad(delta)) if unit is metrics.Unit.degrees else delta
    if all_pairs:
        return pairs_apart(truth.quaternions, radians)
    return pairs_along(turned(truth.quaternions), radians, consecutive=True)


@given(
    seed=seeds,
    align=st.sampled_from(ALIGNMENTS),
    unit=st.sampled_from([metrics.Unit.frames, metrics.Unit.meters, metrics.Unit.degrees, metrics.Unit.radians]),
    size=st.floats(0.05, 0.6),
    all_pairs=st.booleans(),
)
@settings(max_examples=100, deadline=None, derandomize=True)
def test_relative_errors_of_all_relations_and_pair_modes_equal_evo(seed, align, unit, size, all_pairs):
    """Pairs are chosen from the truth, which evo does when it is asked to (`pairs_from_reference`)."""
    truth, estimate = random_pair(seed)
    delta = {
        metrics.Unit.frames: max(1, round(size * 20)),
        metrics.Unit.meters: size * truth.path_length,
        metrics.Unit.degrees: np.rad2deg(size),
        metrics.Unit.radians: size,
    }[unit]
    result = score(truth, estimate, SlamSettings(align=align))
    pair = evo_aligned(truth, estimate, align)
    pairs = our_pairs(truth, delta, unit, all_pairs)
    for relation, ours in RELATIONS.items():
        rpe = metrics.RPE(relation, delta, unit, all_pairs=all_pairs, pairs_from_reference=True)
        if not len(pairs):
            with pytest.raises(filters.FilterException):
                rpe.process_data(pair)
            return
        rpe.process_data(pair)
        assert pairs[:, 1].tolist() == list(rpe.delta_ids)
        errors = relative_errors(result.truth, result.estimate, pairs, absolute_errors(result.truth, result.estimate))
        np.testing.assert_allclose(ours(errors), rpe.error, **TOLERANCE, err_msg=relation.value)


@given(seed=seeds, align=st.sampled_from(ALIGNMENTS), pairs=st.sampled_from(["all", "consecutive"]))
@some
def test_relative_errors_of_a_result_equal_evos(seed, align, pairs):
    truth, estimate = random_pair(seed)
    metres = 0.2 * truth.path_length
    asked = SlamSettings(
        align=align,
        rpe_pairs=pairs,
        rpe_angle="direct" if pairs == "all" else "turned",
        rpe_frames=3,
        rpe_delta_m=metres,
        rpe_delta_deg=25.0,
    )
    values = score(truth, estimate, asked).metrics
    pair = evo_aligned(truth, estimate, align)
    per_second = round(1e9 / int(truth.stamps_ns[1] - truth.stamps_ns[0]))
    for name, delta, unit in (
        ("3frames", 3, metrics.Unit.frames),
        (f"{metres:g}m", metres, metrics.Unit.meters),
        ("25deg", 25.0, metrics.Unit.degrees),
        ("1s", per_second, metrics.Unit.frames),
    ):
        for relation, key in (
            (metrics.PoseRelation.translation_part, f"rpe_{name}_translation_rmse_m"),
            (metrics.PoseRelation.rotation_angle_deg, f"rpe_{name}_rotation_rmse_deg"),
        ):
            rpe = metrics.RPE(relation, delta, unit, all_pairs=pairs == "all", pairs_from_reference=True)
            if values[f"rpe_{name}_pairs"] == 0:
                with pytest.raises(filters.FilterException):
                    rpe.process_data(pair)
                continue
            np.testing.assert_allclose(values[key], evo_statistics(rpe, pair)["rmse"], **TOLERANCE)
            assert values[f"rpe_{name}_pairs"] == len(rpe.error)


@given(seeds)
@some
def test_interpolation_at_the_truth_stamps_equals_evos(seed):
    """evo resamples the longer trajectory at the stamps of the shorter one: here the estimate, at the truth's."""
    dense, _ = random_pair(seed)
    truth = dense.select(slice(2, -2, 3))
    if len(truth) < 5:
        return
    shifted = Trajectory(dense.stamps_ns - 4_000_000, dense.positions, dense.quaternions)
    result = score(truth, shifted, SlamSettings(align="none"))
    pair = sync.associate_trajectories(
        as_evo(truth), as_evo(shifted), max_diff=0.01, sync_method=sync.SyncMethod.interpolation
    )
    assert_absolute_errors_equal(result, pair)


def test_a_stop_gives_pairs_over_metres_their_first_pose_as_in_evo():
    """Poses that stand in one place lie equally far along the path; evo takes the first of them."""
    steps = np.repeat([1.0, 0.0, 0.0, 1.0, 1.0, 0.0, 1.0], 2)
    axis = np.concatenate([[0.0], np.cumsum(steps)])
    matrices = np.tile(np.eye(4), (len(axis), 1, 1))
    matrices[:, 0, 3] = axis
    for delta in (1.0, 2.0, 2.9):
        for all_pairs in (True, False):
            theirs = filters.filter_pairs_by_path(matrices, delta, 0.1 * delta, all_pairs)
            np.testing.assert_array_equal(pairs_along(axis, delta, not all_pairs), np.array(theirs).reshape(-1, 2))


def test_pairs_over_time_are_frames_where_stamps_are_even():
    truth, _ = random_pair(1)
    frames = round(1e9 / int(truth.stamps_ns[1] - truth.stamps_ns[0]))
    np.testing.assert_array_equal(pairs_over_time(truth.stamps_ns, 1.0), pairs_over_frames(len(truth), frames))
    np.testing.assert_array_equal(
        pairs_over_time(truth.stamps_ns, 1.0, consecutive=True), pairs_over_frames(len(truth), frames, consecutive=True)
    )
