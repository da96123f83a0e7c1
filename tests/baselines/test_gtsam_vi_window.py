"""The window of gtsam_vi: what it keeps of variables that have left it, and which landmark a track shows."""

from __future__ import annotations

import gtsam
import numpy as np
import pytest
from gtsam.symbol_shorthand import X
from scipy.spatial.transform import Rotation

from oysterbench.core.geometry import Array
from oysterbench.sequence import ImuMeasurement
from oysterbench_baselines.common.inertial import SampleBuffer, Segment
from oysterbench_baselines.gtsam_vi import GtsamViSettings
from oysterbench_baselines.gtsam_vi.estimator import Estimator
from oysterbench_baselines.gtsam_vi.fixed_lag import FixedLagSmoother
from oysterbench_baselines.gtsam_vi.frontend import FeatureTracks, undistort
from oysterbench_baselines.gtsam_vi.graph import StartPrior
from oysterbench_baselines.gtsam_vi.keyframes import DataAssociation
from oysterbench_baselines.gtsam_vi.settings import LandmarkSettings, LoopSettings
from tests.helpers import synthetic_dive as dive


def chain(count: int, rng: np.random.Generator) -> tuple[list[gtsam.NonlinearFactor], gtsam.Values]:
    """Points on a line, each a noisy step from the last and looked at now and then: linear, so that all is exact."""
    step, look = gtsam.noiseModel.Isotropic.Sigma(3, 0.1), gtsam.noiseModel.Isotropic.Sigma(3, 0.5)
    factors: list[gtsam.NonlinearFactor] = [gtsam.PriorFactorPoint3(X(0), np.zeros(3), step)]
    values = gtsam.Values()
    for k in range(count):
        values.insert(X(k), rng.normal(size=3))
        if k:
            factors.append(gtsam.BetweenFactorPoint3(X(k - 1), X(k), rng.normal(size=3), step))
        if k % 3 == 0:
            factors.append(gtsam.PriorFactorPoint3(X(k), rng.normal(size=3), look))
    return factors, values


def test_what_is_left_knows_all_that_has_left():
    """Of a linear problem, the newest variables and their covariance are those of all measurements together."""
    factors, values = chain(30, np.random.default_rng(0))
    smoother = FixedLagSmoother(5, 3)
    whole = gtsam.NonlinearFactorGraph()
    for k in range(30):
        graph, first = gtsam.NonlinearFactorGraph(), gtsam.Values()
        for factor in factors:
            if max(factor.keys()) == X(k):
                graph.push_back(factor)
                whole.push_back(factor)
        first.insert(X(k), values.atPoint3(X(k)))
        smoother.update(graph, first, {X(k): float(k)}, [X(k - 1), X(k)] if k else [X(k)])
        assert smoother.estimate.size() <= 6
    best = gtsam.GaussNewtonOptimizer(whole, values).optimize()
    wanted = gtsam.Marginals(whole, best)
    found = gtsam.Marginals(compact(smoother.factors), smoother.linearised_at)
    both = wanted.jointMarginalCovariance([X(28), X(29)]).fullMatrix()
    assert np.allclose(smoother.joint([X(28), X(29)]), both, atol=1e-9)
    assert smoother.joint([X(29), X(28)]) is None  # it has them in the order of their elimination
    for k in range(24, 30):
        assert np.allclose(smoother.estimate.atPoint3(X(k)), best.atPoint3(X(k)), atol=1e-6)
        assert np.allclose(found.marginalCovariance(X(k)), wanted.marginalCovariance(X(k)), atol=1e-9)


def compact(factors: gtsam.NonlinearFactorGraph) -> gtsam.NonlinearFactorGraph:
    """Without holes."""
    graph = gtsam.NonlinearFactorGraph()
    for n in range(factors.size()):
        if factors.at(n) is not None:
            graph.push_back(factors.at(n))
    return graph


def turn_of_all(values: gtsam.Values) -> gtsam.VectorValues:
    """What a turn of everything about the vertical is in the tangents of the variables."""
    turn, up = gtsam.VectorValues(), np.array([0.0, 0.0, 1.0])
    for key in values.keys():  # noqa: SIM118 (no dictionary)
        kind = chr(gtsam.Symbol(key).chr())
        if kind == "x":
            pose = values.atPose3(key)
            back = pose.rotation().matrix().T
            turn.insert(key, np.concatenate([back @ up, back @ np.cross(up, pose.translation())]))
        else:
            turn.insert(key, np.zeros(6) if kind == "b" else np.cross(up, values.atPoint3(key)))
    return turn


def test_heading_is_never_learnt_from_what_cannot_tell_it():
    """Tracks and inertial unit know nothing of heading. Where the start knows next to nothing of it either (1 rad), no
    more is known on the way; with what is marginalised linearised here and the rest there, it soon is to 14 mrad."""
    measured = dive.make_dive(3, duration_s=14.0, most=60, pixel_noise=0.8)
    estimator = Estimator([measured.camera], measured.inertial, GtsamViSettings(loops=LoopSettings(enabled=False)))
    estimator.model.start_prior[0] = StartPrior(np.diag([1e-8] * 3 + [0.25, 0.25, 1.0]), np.eye(3) * 4.0)
    samples, known = SampleBuffer(), []
    for item in measured.stream():
        if isinstance(item, ImuMeasurement):
            samples.add(item)
            continue
        stamp, ids, pixels = item
        before = len(estimator.keyframes)
        estimator.propagate(samples.cut(stamp))
        estimator.step(stamp, FeatureTracks(ids, pixels, undistort(pixels, measured.camera)))
        if estimator.window is not None and len(estimator.keyframes) > before:
            known.append(information_on_turn(estimator.window._smoother))
    assert len(known) >= 20
    assert known[0] == pytest.approx(1.0, abs=0.2)
    assert max(known) < 1.05 * known[0]


def information_on_turn(smoother: FixedLagSmoother) -> float:
    """1/rad^2."""
    linear, turn = smoother.factors.linearize(smoother.linearised_at), turn_of_all(smoother.linearised_at)
    nothing = gtsam.VectorValues.Zero(turn)
    return float(linear.error(turn) + linear.error(turn.scale(-1.0)) - 2.0 * linear.error(nothing))


def still(seconds: float, rate: Array) -> Segment:
    count = round(seconds * 200)
    return Segment(np.full(count, 1 / 200), np.tile(rate, (count, 1)), np.tile([0.0, 0.0, 9.81], (count, 1)))


def test_a_track_seen_from_another_side_is_another_landmark():
    association = DataAssociation(GtsamViSettings(landmarks=LandmarkSettings(max_turn_deg=20.0)), np.eye(3))
    ids, nothing = np.array([4, 7]), np.zeros(3)
    first = association.landmarks(ids, np.array([[0.0, 0.0], [0.1, 0.0]]), still(0.1, nothing), nothing)
    # The ray of the first moves by 22 degrees, that of the second by 6: the vehicle passes the one, not the other.
    second = association.landmarks(ids, np.array([[0.4, 0.0], [0.2, 0.0]]), still(0.1, nothing), nothing)
    assert second[0] not in first
    assert second[1] == first[1]
    assert len({*first, *second}) == 3


@pytest.mark.parametrize("bias", [0.0, 0.2])
def test_a_camera_that_turns_on_the_spot_sees_the_same_side(bias):
    association = DataAssociation(GtsamViSettings(landmarks=LandmarkSettings(max_turn_deg=20.0)), np.eye(3))
    rate, found = np.array([0.0, 0.5, 0.0]), []
    for k in range(12):
        turned = Rotation.from_rotvec(-rate * 0.1 * k).apply([0.0, 0.0, 1.0])
        seen = np.array([turned[:2] / turned[2]])
        segment = still(0.1 if k else 0.0, rate + bias * np.array([0.0, 1.0, 0.0]))
        found += association.landmarks(np.array([3]), seen, segment, bias * np.array([0.0, 1.0, 0.0])).tolist()
    assert set(found) == {found[0]}


def test_renaming_does_not_count_as_losing():
    association = DataAssociation(GtsamViSettings(landmarks=LandmarkSettings(max_turn_deg=5.0)), np.eye(3))
    nothing = np.zeros(3)
    for x in (0.0, 0.2, 0.4):
        association.landmarks(np.array([1, 2]), np.full((2, 2), x), still(0.1, nothing), nothing)
    assert association.inflation() == 1.0
    association.landmarks(np.array([2, 3]), np.zeros((2, 2)), still(0.1, nothing), nothing)
    assert association.inflation() == 2.0


def test_what_hardly_anything_determines_does_not_end_the_smoothing():
    smoother, values = FixedLagSmoother(5, 3), gtsam.Values()
    graph, noise = gtsam.NonlinearFactorGraph(), gtsam.noiseModel.Isotropic.Sigma(3, 0.1)
    graph.push_back(gtsam.BetweenFactorPoint3(X(0), X(1), np.array([1.0, 0.0, 0.0]), noise))
    for k in range(2):
        values.insert(X(k), np.array([4.0, 0.0, 0.0]))
    smoother.update(graph, values, {X(0): 0.0, X(1): 1.0})
    apart = smoother.estimate.atPoint3(X(1)) - smoother.estimate.atPoint3(X(0))
    assert np.allclose(apart, [1.0, 0.0, 0.0], atol=1e-3)


def test_what_is_lost_among_squares_is_found_by_square_roots():
    """A step known to 1 um from a place known to 100 km: the squares of both do not fit into one number."""
    loose, tight = gtsam.noiseModel.Isotropic.Sigma(3, 1e5), gtsam.noiseModel.Isotropic.Sigma(3, 1e-6)
    place, step = np.array([3.0, -2.0, 1.0]), np.array([1.0, 0.0, 0.0])
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    graph.push_back(gtsam.PriorFactorPoint3(X(0), place, loose))
    graph.push_back(gtsam.BetweenFactorPoint3(X(0), X(1), step, tight))
    for k in range(2):
        values.insert(X(k), np.zeros(3))
    with pytest.raises(RuntimeError, match="Indeterminate"):
        graph.linearize(values).optimize()
    smoother = FixedLagSmoother(5, 3)
    smoother.update(graph, values, {X(0): 0.0, X(1): 1.0}, [X(1)])
    np.testing.assert_allclose(smoother.estimate.atPoint3(X(1)), place + step, atol=1e-3)
    np.testing.assert_allclose(smoother.joint([X(1)]), 1e10 * np.eye(3), rtol=1e-3)
