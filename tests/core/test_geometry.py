"""Rotations, transforms, interpolation and alignment, against formulas and optimisers that are not ours."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import minimize_scalar
from scipy.spatial.transform import Rotation

from oysterbench.core.geometry import (
    Similarity,
    align_origin,
    align_umeyama,
    align_yaw,
    interpolate_poses,
    invert,
    left_product,
    poses_to_matrices,
    rotation_angle,
    spread,
)
from oysterbench.core.streams import stream

seeds = st.integers(0, 2**32 - 1)


def random_points(seed: int, n: int = 50) -> tuple[np.ndarray, np.ndarray]:
    """A reference, and an estimate of it that is turned, moved and noisy."""
    rng = stream(seed, b"", "points")
    reference = rng.normal(0, 3, (n, 3))
    turn = Rotation.random(rng=rng)
    return reference, turn.apply(reference + rng.normal(0, 0.2, (n, 3))) + rng.normal(0, 9, 3)


def random_quaternions(seed: int, n: int = 20) -> np.ndarray:
    return Rotation.random(n, rng=stream(seed, b"", "quaternions")).as_quat()


@given(seeds)
@settings(max_examples=30, deadline=None)
def test_a_transform_times_its_inverse_is_the_identity(seed):
    positions, _ = random_points(seed, 20)
    matrices = poses_to_matrices(positions, random_quaternions(seed))
    np.testing.assert_allclose(invert(matrices) @ matrices, np.broadcast_to(np.eye(4), (20, 4, 4)), atol=1e-12)
    np.testing.assert_allclose(invert(matrices), np.linalg.inv(matrices), atol=1e-12)


@given(seeds)
@settings(max_examples=30, deadline=None)
def test_rotation_angle_and_product_equal_scipys(seed):
    a, b = random_quaternions(seed), random_quaternions(seed + 1)
    expected = (Rotation.from_quat(a).inv() * Rotation.from_quat(b)).magnitude()
    np.testing.assert_allclose(rotation_angle(a, b), expected, atol=1e-12)
    np.testing.assert_allclose(rotation_angle(a, -b), expected, atol=1e-12)
    product = (Rotation.from_quat(a[0]) * Rotation.from_quat(b)).as_matrix()
    np.testing.assert_allclose(Rotation.from_quat(b @ left_product(a[0]).T).as_matrix(), product, atol=1e-12)


@pytest.mark.parametrize("angle", [0.0, 1e-9, 1e-4, np.pi - 1e-9, np.pi])
def test_rotation_angle_is_exact_where_an_arc_cosine_is_not(angle):
    a = random_quaternions(1)
    b = (Rotation.from_quat(a) * Rotation.from_rotvec([0, angle, 0])).as_quat()
    np.testing.assert_allclose(rotation_angle(a, b), angle, rtol=0, atol=1e-14)


def test_interpolation_is_exact_at_the_poses_and_halfway_between():
    stamps = np.array([0, 10, 30], dtype=np.int64) * 10**8 + 1_700_000_000 * 10**9
    positions = np.array([[0, 0, 0], [1, 2, 3], [5, 0, 1]], dtype=float)
    quaternions = Rotation.from_euler("z", [[0], [90], [-100]], degrees=True).as_quat()
    at, attitudes = interpolate_poses(stamps, positions, quaternions, stamps)
    np.testing.assert_array_equal(at, positions)
    np.testing.assert_allclose(rotation_angle(attitudes, quaternions), 0, atol=1e-14)
    at, attitudes = interpolate_poses(stamps, positions, quaternions, stamps[:1] + 5 * 10**8)
    np.testing.assert_allclose(at, [[0.5, 1, 1.5]])
    np.testing.assert_allclose(Rotation.from_quat(attitudes).as_euler("zyx", degrees=True), [[45, 0, 0]], atol=1e-12)


def test_interpolation_takes_the_short_way_whatever_the_sign_of_a_quaternion():
    stamps = np.array([0, 10], dtype=np.int64)
    quaternions = Rotation.from_euler("z", [[10], [30]], degrees=True).as_quat() * [[1], [-1]]
    _, attitudes = interpolate_poses(stamps, np.zeros((2, 3)), quaternions, np.array([5]))
    np.testing.assert_allclose(Rotation.from_quat(attitudes).magnitude(), np.deg2rad(20), atol=1e-12)


def test_interpolation_outside_the_time_span_is_refused():
    with pytest.raises(ValueError, match="outside"):
        interpolate_poses(np.array([0, 10]), np.zeros((2, 3)), random_quaternions(1, 2), np.array([11]))


def test_interpolation_at_no_stamp_gives_no_pose():
    at, attitudes = interpolate_poses(np.array([0, 10]), np.zeros((2, 3)), random_quaternions(1, 2), np.array([], int))
    assert at.shape == (0, 3)
    assert attitudes.shape == (0, 4)


@given(seeds)
@settings(max_examples=30, deadline=None)
def test_umeyama_equals_scipys_solution_of_wahbas_problem(seed):
    reference, estimate = random_points(seed)
    ours = align_umeyama(reference, estimate)
    theirs, _ = Rotation.align_vectors(reference - reference.mean(axis=0), estimate - estimate.mean(axis=0))
    np.testing.assert_allclose(ours.rotation, theirs.as_matrix(), atol=1e-9)
    np.testing.assert_allclose(ours.apply(estimate).mean(axis=0), reference.mean(axis=0), atol=1e-9)


@given(seeds, st.floats(0.05, 20))
@settings(max_examples=30, deadline=None)
def test_umeyama_finds_the_scale_that_leaves_the_least_error(seed, scale):
    reference, estimate = random_points(seed)
    ours = align_umeyama(reference, estimate / scale, with_scale=True)

    def error(s: float) -> float:
        changed = Similarity(
            ours.rotation, reference.mean(axis=0) - s * ours.rotation @ estimate.mean(axis=0) / scale, s
        )
        return float(np.sum((changed.apply(estimate / scale) - reference) ** 2))

    best = minimize_scalar(error, bounds=(0.5 * ours.scale, 2 * ours.scale), method="bounded", options={"xatol": 1e-9})
    assert ours.scale == pytest.approx(best.x, rel=1e-5)


def test_umeyama_gives_a_rotation_and_no_reflection():
    reference, estimate = random_points(2)
    mirrored = align_umeyama(reference, estimate * [1, 1, -1])
    assert np.linalg.det(mirrored.rotation) == pytest.approx(1)


@given(seeds)
@settings(max_examples=30, deadline=None)
def test_yaw_equals_the_formula_of_rpg_and_the_optimum_of_a_search(seed):
    """theta = pi/2 - atan2(C00 + C11, C01 - C10), C = sum est gt^T (rpg_trajectory_evaluation, alignTrajectory)."""
    reference, estimate = random_points(seed)
    ours = align_yaw(reference, estimate)
    p, q = reference - reference.mean(axis=0), estimate - estimate.mean(axis=0)
    c = q.T @ p
    theta = np.pi / 2 - np.arctan2(c[0, 0] + c[1, 1], c[0, 1] - c[1, 0])
    np.testing.assert_allclose(ours.rotation, Rotation.from_euler("z", theta).as_matrix(), atol=1e-12)

    def error(angle: float) -> float:
        return float(np.sum((q @ Rotation.from_euler("z", angle).as_matrix().T - p) ** 2))

    grid = np.linspace(-np.pi, np.pi, 73)
    start = grid[np.argmin([error(angle) for angle in grid])]
    best = minimize_scalar(error, bounds=(start - 0.1, start + 0.1), method="bounded", options={"xatol": 1e-10})
    assert error(np.arctan2(ours.rotation[1, 0], ours.rotation[0, 0])) <= best.fun * (1 + 1e-12)


@given(seeds)
@settings(max_examples=20, deadline=None)
def test_origin_takes_the_first_pose_onto_the_first(seed):
    reference, estimate = poses_to_matrices([[1, 2, 3], [-4, 5, 0]], random_quaternions(seed, 2))
    change = align_origin(reference, estimate)
    np.testing.assert_allclose(change.apply(estimate[:3, 3][None])[0], reference[:3, 3], atol=1e-12)
    np.testing.assert_allclose(change.rotation @ estimate[:3, :3], reference[:3, :3], atol=1e-12)


def test_spread_is_the_distance_from_the_mean():
    assert spread(np.array([[1.0, 5, 0], [3, 5, 0]])) == 1


def test_alignments_refuse_what_the_points_do_not_determine():
    reference, estimate = random_points(4)
    line = np.linspace([0, 0, 0], [9, 1, 0], 50)
    with pytest.raises(ValueError, match="one line"):
        align_umeyama(line, estimate)
    with pytest.raises(ValueError, match="one line"):
        align_umeyama(reference, line)
    with pytest.raises(ValueError, match="at least 3"):
        align_umeyama(reference[:2], estimate[:2])
    with pytest.raises(ValueError, match="matched points"):
        align_yaw(reference, estimate[:-1])
    with pytest.raises(ValueError, match="does not move"):
        align_yaw(reference * 1e-6, estimate)
    with pytest.raises(ValueError, match="estimate does not move horizontally: it spreads"):
        align_yaw(reference, estimate * [0, 0, 1])
    with pytest.raises(ValueError, match="straight up or down"):
        align_yaw(reference * [1e-3, 1e-3, 1e4], estimate)


def test_yaw_without_a_common_direction_is_refused():
    ring = np.array([[1.0, 0, 0], [0, 1, 0], [-1, 0, 0], [0, -1, 0]])
    with pytest.raises(ValueError, match="no horizontal direction in common"):
        align_yaw(ring, ring * [1, -1, 1])
