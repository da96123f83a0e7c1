"""Covariances: NEES and 3-sigma shares of estimates that err as they say, less, and more."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from oysterbench.core.geometry import IDENTITY
from oysterbench.core.streams import stream
from oysterbench.core.trajectory import Trajectory
from oysterbench.evaluate.slam.consistency import nees
from oysterbench.evaluate.slam.scoring import SlamSettings, score
from oysterbench.evaluate.slam.settings import Align
from tests.helpers.dives import survey

PARTS = {"position": 3, "rotation": 3, "pose": 6}


def with_covariances(
    promise: float = 1.0, turn: Rotation | None = None, scale: float = 1.0, exact_first: bool = False
) -> tuple[Trajectory, Trajectory]:
    """A truth and an estimate whose errors have a covariance; it says promise^2 times that. Estimate's own world.

    Errors are independent; exact_first: but for the first, which is none.
    """
    truth = survey(duration_s=60)
    n = len(truth)
    rng = stream(11, b"", "consistency")
    root = np.tril(rng.normal(0, 1, (n, 6, 6)) * 0.2 + np.eye(6)) * np.array([0.05] * 3 + [0.01] * 3)[:, None]
    if exact_first:
        root[0] *= 1e-6
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


@pytest.mark.parametrize("align", ["origin", "posyaw", "se3", "sim3"])
def test_covariances_turn_and_scale_with_the_alignment(align):
    turn = Rotation.from_euler("z" if align == "posyaw" else "xyz", [1.0] if align == "posyaw" else [1.0, 0.5, 2.0])
    metrics = score(
        *with_covariances(turn=turn, scale=2.5 if align == "sim3" else 1.0, exact_first=True), SlamSettings(align=align)
    ).metrics
    assert metrics["scale"] == pytest.approx(2.5 if align == "sim3" else 1.0, rel=0.01)
    for part, freedom in PARTS.items():
        assert metrics[f"nees_{part}"] == pytest.approx(freedom, rel=0.05)


def drifting(rng: np.random.Generator, promise: float = 1.0, start: float = 0.0) -> tuple[Trajectory, Trajectory]:
    """A truth and odometry of it, whose errors walk from an exact start: by 3 mm and 2 mrad (yaw 4) a root second.

    Each step errs in the world's axes, and what the attitude errs turns the way that is left. It says promise^2 times
    the covariance that follows. Its world lies and points somewhere. start: 1 sigma, m and rad, by which its first
    pose, and with it all of the path, is off that world's, in position and yaw, and says so.
    """
    truth = survey(duration_s=60, rate_hz=10)
    n, steps = len(truth), np.diff(truth.positions, axis=0)
    root = np.array([0.003] * 3 + [0.002, 0.002, 0.004]) * np.sqrt(0.1)
    errors, covariances = np.zeros((n, 6)), np.zeros((n, 6, 6))
    covariances[0] = np.diag([1e-9**2] * 6)
    off = np.array([start] * 3 + [0.0, 0.0, start])
    errors[0] = off * rng.normal(size=6)
    covariances[0] += np.diag(off**2)
    for k, step in enumerate(steps, start=1):
        change = np.eye(6)
        change[:3, 3:] = [[0, step[2], -step[1]], [-step[2], 0, step[0]], [step[1], -step[0], 0]]
        errors[k] = change @ errors[k - 1] + root * rng.normal(size=6)
        covariances[k] = change @ covariances[k - 1] @ change.T + np.diag(root**2)
    yaw = Rotation.from_euler("z", rng.uniform(-3, 3))
    both = np.kron(np.eye(2), yaw.as_matrix())
    attitudes = Rotation.from_rotvec(errors[:, 3:]) * Rotation.from_quat(truth.quaternions)
    estimate = Trajectory(
        truth.stamps_ns,
        yaw.apply(truth.positions + errors[:, :3]) + rng.uniform(-5, 5, 3),
        (yaw * attitudes).as_quat(),
        promise**2 * both @ covariances @ both.T,
    )
    return truth, estimate


RUNS = 40


def last_of(align: Align, promise: float = 1.0, start: float = 0.0) -> np.ndarray:
    """NEES (RUNS,) of the last pose of independent estimates."""
    rng = stream(12, b"", "drift")
    values = []
    for _ in range(RUNS):
        truth, estimate = drifting(rng, promise, start)
        values.append(nees(truth, estimate, align, IDENTITY)["pose"].values[-1])
    return np.array(values)


def band(freedom: int) -> tuple[float, float]:
    low, high = chi2.ppf(np.array([0.0005, 0.9995]), freedom * RUNS) / RUNS
    return float(low), float(high)


@pytest.mark.parametrize("align", ["posyaw", "origin"])
def test_odometry_that_drifts_as_it_says_has_six_at_its_end(align):
    """By the first pose. Chi-square over independent runs: within one run errors at different stamps are not."""
    low, high = band(6)
    assert low < last_of(align).mean() < high


@pytest.mark.parametrize("promise", [0.7, 1.4])
def test_odometry_that_drifts_more_or_less_than_it_says_is_told(promise):
    low, high = band(6)
    mean = last_of("posyaw", promise).mean()
    assert mean > high if promise < 1 else mean < low
    assert mean == pytest.approx(6 / promise**2, rel=0.25)


def test_what_the_first_pose_errs_moves_all_others_and_is_counted_where_it_says_so():
    """An estimate in a world that it knows to 5 cm and 0.05 rad: taking its first pose for exact puts that into all the
    others, as much as was taken out; it is added, as if it were independent, so that it is too modest, never too sure.
    """
    start = last_of("posyaw", start=0.05)
    assert start.mean() < band(6)[1]
    assert start.mean() > 0.3
    independent = with_covariances()
    for part, freedom in PARTS.items():
        value = nees(*independent, "origin", IDENTITY)[part]
        # All 3000 samples share the error of the first pose, which is as large as theirs.
        assert 0.4 * freedom < value.mean < 2.2 * freedom
        assert len(value.values) == len(independent[0]) - 1


def test_an_alignment_over_the_whole_path_would_blame_the_first_poses_for_what_the_last_ones_err():
    truth, estimate = drifting(stream(13, b"", "drift"))
    ours = score(truth, estimate, SlamSettings(align="posyaw"))
    values = nees(truth, estimate, "posyaw", IDENTITY)["pose"]
    assert ours.metrics["nees_pose"] == pytest.approx(values.mean, rel=1e-12)
    fitted = replace(
        estimate,
        positions=ours.alignment.apply(estimate.positions),
        quaternions=ours.alignment.rotate(estimate.quaternions),
    )
    early = nees(truth, fitted, "none", IDENTITY)["pose"].values[:20]
    assert early.mean() > 100
    assert values.values[:20].mean() < 20


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


@pytest.mark.parametrize("align", ["posyaw", "origin", "se3", "sim3"])
def test_the_exact_pose_from_which_odometry_starts_costs_no_consistency(align):
    truth, estimate = with_covariances(exact_first=True)
    covariances = estimate.covariances.copy()
    covariances[0] = 0.0
    settings = SlamSettings(align=align)
    exact = score(truth, replace(estimate, covariances=covariances), settings)
    for part in PARTS:
        assert exact.metrics[f"nees_{part}"] == pytest.approx(
            score(truth, estimate, settings).metrics[f"nees_{part}"], rel=1e-3
        )
    assert not any("NEES" in note for note in exact.notes)
    as_sample = score(truth, replace(estimate, covariances=covariances), SlamSettings(align="none"))
    assert as_sample.reasons["nees_pose"] == "the covariance of matched pose 1 is not positive definite"
    covariances[0, 0, 0] = -1e-4
    assert "pose 1 has a negative" in score(truth, replace(estimate, covariances=covariances)).reasons["nees_pose"]


@pytest.mark.parametrize("step", [2, 10])
@pytest.mark.parametrize("align", ["posyaw", "origin"])
def test_an_exact_first_pose_costs_no_consistency_where_the_truth_is_faster(align, step):
    """Several stamps of the truth are then nearest to that pose, and matched with its covariance."""
    truth = survey(duration_s=60)
    n = len(truth.stamps_ns[::step])
    sigma = 1e-3
    walk = np.cumsum(stream(12, b"", "walk").normal(0, sigma, (n, 6)), axis=0)
    walk -= walk[0]
    covariances = sigma**2 * np.arange(n)[:, None, None] * np.eye(6)
    given = truth.select(slice(None, None, step))
    turned = Rotation.from_rotvec(walk[:, 3:]) * Rotation.from_quat(given.quaternions)
    estimate = Trajectory(given.stamps_ns, given.positions + walk[:, :3], turned.as_quat(), covariances)
    result = score(truth, estimate, SlamSettings(align=align))
    assert not any("NEES" in note for note in result.notes)
    assert len(result.nees["pose"].values) == result.metrics["matched"] - step // 2 - 1
    assert np.isfinite(result.metrics["nees_pose"])
    for exact in (2, n // 2, n):
        covariances[:exact] = 0
        claimed = score(truth, replace(estimate, covariances=covariances), SlamSettings(align=align))
        why = f"the covariance of matched pose {step // 2 + 2} is not positive definite"
        assert claimed.reasons["nees_pose"] == why


def test_matches_of_an_exact_first_pose_alone_are_no_samples():
    truth, estimate = drifting(stream(14, b"", "drift"))
    covariances = estimate.covariances.copy()
    covariances[0] = 0
    first, claimed = (
        Trajectory(one.stamps_ns[:3], one.positions[:3], one.quaternions[:3], covariances[:3])
        for one in (truth, estimate)
    )
    with pytest.raises(ValueError, match="no pose was matched but the first one"):
        nees(first, claimed, "origin", IDENTITY, by_first=3)


@pytest.mark.parametrize("align", ["posyaw", "origin"])
def test_an_estimate_that_calls_itself_exact_for_long_is_not_excused_for_it(align):
    truth, estimate = drifting(stream(14, b"", "drift"))
    covariances = estimate.covariances.copy()
    covariances[: int(0.8 * len(truth))] = 0
    result = score(truth, replace(estimate, covariances=covariances), SlamSettings(align=align))
    assert result.reasons["nees_pose"] == "the covariance of matched pose 2 is not positive definite"


@pytest.mark.parametrize("value", [np.nan, np.inf])
@pytest.mark.parametrize("pose", [0, 41])
def test_a_covariance_that_is_not_finite_is_a_reason_and_a_note(pose, value):
    truth, estimate = with_covariances()
    covariances = estimate.covariances.copy()
    covariances[pose] = value
    result = score(truth, replace(estimate, covariances=covariances))
    why = f"the covariance of matched pose {pose + 1} is not finite"
    assert np.isnan([result.metrics["nees_position"], result.metrics["within_3sigma_position"]]).all()
    assert result.reasons["within_3sigma_position"] == why
    assert f"NEES is not computed: {why}" in result.notes


def test_an_estimate_without_covariances_has_no_such_metrics():
    truth, estimate = with_covariances()
    assert not any("nees" in key for key in score(truth, replace(estimate, covariances=None)).metrics)
