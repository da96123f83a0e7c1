"""Covariances: NEES and 3-sigma shares of estimates that err as they say, less, and more."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from dives import survey
from scipy.spatial.transform import Rotation

from oysterbench.evaluate.slam import SlamSettings, score
from oysterbench.streams import stream
from oysterbench.trajectory import Trajectory

PARTS = {"position": 3, "rotation": 3, "pose": 6}


def with_covariances(
    promise: float = 1.0, turn: Rotation | None = None, scale: float = 1.0
) -> tuple[Trajectory, Trajectory]:
    """A truth and an estimate whose errors have a covariance; it says promise^2 times that. Estimate's own world."""
    truth = survey(duration_s=60)
    n = len(truth)
    rng = stream(11, b"", "consistency")
    root = np.tril(rng.normal(0, 1, (n, 6, 6)) * 0.2 + np.eye(6)) * np.array([0.05] * 3 + [0.01] * 3)[:, None]
    errors = np.einsum("nij,nj->ni", root, rng.normal(0, 1, (n, 6)))
    covariances = promise**2 * root @ np.swapaxes(root, 1, 2)
    positions = truth.positions + errors[:, :3]
    attitudes = Rotation.from_rotvec(errors[:, 3:]) * Rotation.from_quat(truth.quaternions)
    turn = turn or Rotation.identity()
    change = np.zeros((6, 6))
    change[:3, :3] = turn.as_matrix() / scale
    change[3:, 3:] = turn.as_matrix()
    estimate = Trajectory(
        truth.stamps_ns, turn.apply(positions) / scale, (turn * attitudes).as_quat(), change @ covariances @ change.T
    )
    return truth, estimate


@pytest.mark.parametrize("part", PARTS)
def test_errors_that_are_as_promised_have_their_degrees_of_freedom(part):
    metrics = score(*with_covariances(), SlamSettings(align="none")).metrics
    assert metrics[f"nees_{part}_low"] < metrics[f"nees_{part}"] < metrics[f"nees_{part}_high"]
    assert metrics[f"nees_{part}_low"] < PARTS[part] < metrics[f"nees_{part}_high"]
    assert metrics[f"nees_{part}_high"] - metrics[f"nees_{part}_low"] < 0.05 * PARTS[part] * 2
    assert metrics[f"within_3sigma_{part}"] == pytest.approx(0.9973, abs=0.003)


@pytest.mark.parametrize("part", PARTS)
def test_an_overconfident_estimate_is_told_by_both(part):
    metrics = score(*with_covariances(promise=0.5), SlamSettings(align="none")).metrics
    assert metrics[f"nees_{part}"] == pytest.approx(4 * PARTS[part], rel=0.05)
    assert metrics[f"nees_{part}"] > metrics[f"nees_{part}_high"]
    assert metrics[f"within_3sigma_{part}"] < 0.8


@pytest.mark.parametrize("align", ["se3", "sim3"])
def test_covariances_turn_and_scale_with_the_alignment(align):
    turn = Rotation.from_euler("xyz", [1.0, 0.5, 2.0])
    metrics = score(
        *with_covariances(turn=turn, scale=2.5 if align == "sim3" else 1.0), SlamSettings(align=align)
    ).metrics
    assert metrics["scale"] == pytest.approx(2.5 if align == "sim3" else 1.0, rel=0.01)
    for part, freedom in PARTS.items():
        assert metrics[f"nees_{part}"] == pytest.approx(freedom, rel=0.05)


def test_nees_equals_its_definition_by_inverse_matrices():
    truth, estimate = with_covariances()
    result = score(truth, estimate, SlamSettings(align="none"))
    turned = Rotation.from_quat(estimate.quaternions) * Rotation.from_quat(truth.quaternions).inv()
    errors = np.column_stack([estimate.positions - truth.positions, turned.as_rotvec()])
    expected = np.mean([e @ np.linalg.inv(c) @ e for e, c in zip(errors, estimate.covariances, strict=True)])
    assert result.metrics["nees_pose"] == pytest.approx(expected, rel=1e-9)


def test_a_covariance_that_is_none_is_a_reason_and_no_number():
    truth, estimate = with_covariances()
    covariances = estimate.covariances.copy()
    covariances[41] = 0.0
    result = score(truth, replace(estimate, covariances=covariances))
    for key in ("nees_position", "nees_pose_high", "within_3sigma_rotation"):
        assert np.isnan(result.metrics[key])
        assert result.reasons[key] == "the covariance of matched pose 42 is not positive definite"
    assert result.metrics["ate_rmse_m"] > 0


def test_an_estimate_without_covariances_has_no_such_metrics():
    truth, estimate = with_covariances()
    assert not any("nees" in key for key in score(truth, replace(estimate, covariances=None)).metrics)
