"""What is adjusted after a loss: no false rest, a heading far off, and a system that squares cannot solve."""

from __future__ import annotations

from dataclasses import replace

import gtsam
import numpy as np
import pytest
from gtsam.symbol_shorthand import B, L, V, X
from scipy.spatial.transform import Rotation

from oysterbench_baselines.common.inertial import Segment
from oysterbench_baselines.gtsam_vi.bundle import motion_factors
from oysterbench_baselines.gtsam_vi.elimination import Cholesky, Orthogonal
from oysterbench_baselines.gtsam_vi.frontend import Observations
from oysterbench_baselines.gtsam_vi.keyframes import is_stationary
from oysterbench_baselines.gtsam_vi.settings import SmoothingSettings
from oysterbench_baselines.gtsam_vi.states import insert_state, make_state
from oysterbench_baselines.gtsam_vi.steps import apply_steps
from tests.baselines.test_gtsam_vi import estimate, position_error
from tests.helpers import synthetic_dive as dive


@pytest.fixture(scope="module")
def estimator():
    return estimate(dive.make_dive(0, duration_s=10.0, most=50))


@pytest.mark.parametrize(("rate", "rests"), [(0.0, True), (0.01, True), (0.1, False)])
def test_an_image_that_stands_still_is_no_rest_while_the_gyroscope_turns(estimator, rate, rests):
    """Silt on the port, for one; a rate within the turn-on bias may be rest."""
    rays = np.random.default_rng(0).uniform(-0.4, 0.4, (40, 2))
    seen = Observations(np.arange(40), rays)
    gyro = np.tile([0.0, rate, 0.0], (40, 1))
    segment = Segment(np.full(40, 0.005), gyro, np.tile([0.0, 0.0, 9.81], (40, 1)))
    assert estimator.model.gyro_turn_on < 0.01
    assert is_stationary(seen, seen, segment, np.zeros(3), estimator.model) == rests
    assert is_stationary(seen, seen, segment, gyro[0], estimator.model)  # a bias, not a turn


def path_of(count: int) -> tuple[gtsam.Values, np.ndarray]:
    """States of `count` keyframes on an arc, a landmark under each, and a calibration."""
    rng, values = np.random.default_rng(1), gtsam.Values()
    for k in range(count):
        rotation = Rotation.from_euler("xyz", [0.1, -0.2, 0.02 * k]).as_matrix()
        position = np.array([np.cos(0.02 * k), np.sin(0.02 * k), 0.1 * np.sin(k)])
        insert_state(values, k, make_state(rotation, position, rng.normal(size=3), np.zeros(3), np.zeros(3)))
        values.insert(L(k), position + np.array([0.1, 0.2, -1.0]))
    values.insert(gtsam.symbol("t", 0), np.array([0.01]))
    return values, np.arange(count)


def steps_of(values: gtsam.Values, scale: float) -> dict[int, np.ndarray]:
    rng = np.random.default_rng(2)
    sizes = {"x": 6, "v": 3, "b": 6, "l": 3, "t": 1}
    return {key: scale * rng.normal(size=sizes[chr(key >> 56)]) for key in values.keys()}  # noqa: SIM118


def test_small_steps_are_what_they_are_to_gtsam():
    values, at = path_of(30)
    steps = steps_of(values, 1e-6)
    vector = gtsam.VectorValues()
    for key, step in steps.items():
        vector.insert(key, step)
    moved = apply_steps(values, steps, at.tolist(), at, at)
    assert np.abs(values.retract(vector).localCoordinates(moved).vector()).max() < 1e-9


def test_a_large_step_of_the_heading_turns_the_path_and_does_not_stretch_it():
    values, at = path_of(60)
    steps = steps_of(values, 0.0)
    for k in at.tolist():  # as a linear step does: the later, the farther to the left
        pose, angle = values.atPose3(X(k)), 0.02 * k
        up = pose.rotation().matrix().T @ [0.0, 0.0, angle]
        across = np.zeros(3)
        for j in range(k):
            leg = values.atPose3(X(j + 1)).translation() - values.atPose3(X(j)).translation()
            across += np.cross([0.0, 0.0, 0.02 * j], leg)
        steps[X(k)] = np.r_[up, pose.rotation().matrix().T @ across]
        steps[V(k)] = np.cross([0.0, 0.0, angle], values.atVector(V(k)))
        steps[L(k)] = across + np.cross([0.0, 0.0, angle], values.atPoint3(L(k)) - pose.translation())
    moved = apply_steps(values, steps, at.tolist(), at, at)
    for k in at.tolist():
        before, after = values.atPose3(X(k)), moved.atPose3(X(k))
        turned = before.rotation().matrix().T @ after.rotation().matrix()
        assert np.isclose(Rotation.from_matrix(turned).magnitude(), 0.02 * k)
        assert np.allclose(before.transformTo(values.atPoint3(L(k))), after.transformTo(moved.atPoint3(L(k))))
        body = before.rotation().unrotate(values.atVector(V(k)))
        assert np.allclose(body, after.rotation().unrotate(moved.atVector(V(k))))
        if k:
            leg = values.atPose3(X(k - 1)).range(before)
            assert np.isclose(moved.atPose3(X(k - 1)).range(after), leg, rtol=1e-9)
    assert values.atConstantBias(B(3)).equals(moved.atConstantBias(B(3)), 1e-12)


def test_what_is_certain_across_and_uncertain_along_a_slanted_line_is_solved_without_squares():
    """Millimetres against tens of metres: a place after a minute in which nothing was seen."""
    rows = np.array([[1e3, 0.0, 0.0], [0.0, 1e4, -1e4], [0.0, 2e-2, 3e-2], [0.0, 3e-2, 2e-2]])
    right = np.array([1.0, 2.0, 0.03, 0.05])
    linear, ordering, unit = gtsam.GaussianFactorGraph(), gtsam.Ordering(), gtsam.noiseModel.Unit.Create
    linear.push_back(gtsam.JacobianFactor(X(0), rows, X(1), -np.eye(4, 3), right, unit(4)))
    linear.push_back(gtsam.JacobianFactor(X(1), np.eye(3), np.ones(3), unit(3)))
    for key in (X(0), X(1)):
        ordering.push_back(key)
    with pytest.raises(RuntimeError, match="ndeterminate"):
        Cholesky.all(linear, ordering)
    found = Orthogonal.all(linear, ordering).optimize()
    whole = np.block([[rows, -np.eye(4, 3)], [np.zeros((3, 3)), np.eye(3)]])
    wanted = np.linalg.lstsq(whole, np.r_[right, np.ones(3)], rcond=None)[0]
    assert np.allclose(np.r_[found.at(X(0)), found.at(X(1))], wanted)
    alone = gtsam.Ordering()
    alone.push_back(X(0))
    left = Orthogonal.some(linear, alone)
    assert np.allclose(left.optimize().at(X(1)), wanted[3:])


def test_nothing_is_made_up_where_nothing_determines_a_variable():
    linear, ordering = gtsam.GaussianFactorGraph(), gtsam.Ordering()
    rows = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 0.0]])
    linear.push_back(gtsam.JacobianFactor(X(0), rows, np.zeros(3), gtsam.noiseModel.Unit.Create(3)))
    ordering.push_back(X(0))
    with pytest.raises(RuntimeError, match="nothing determines"):
        Orthogonal.all(linear, ordering)


@pytest.mark.parametrize("size", [7, 1000])
def test_a_lost_stretch_is_bridged_however_far_off_the_heading_is_behind_it(estimator, size):
    usual = estimator.smoothed()
    lost = [replace(keyframe) for keyframe in estimator.keyframes]
    first, end = 12, 20
    turn, shift = Rotation.from_euler("z", 50, degrees=True), np.array([0.8, -0.5, 0.1])
    for keyframe in lost[first:end]:
        keyframe.distrust_sight()
        keyframe.lost = True
    for keyframe in lost[first:]:
        nav, bias = keyframe.estimate.nav, keyframe.estimate.bias
        rotation = turn.as_matrix() @ nav.attitude().matrix()
        position, velocity = turn.apply(nav.position()) + shift, turn.apply(nav.velocity())
        keyframe.state = make_state(rotation, position, velocity, bias.gyroscope(), bias.accelerometer())
    whole, settings = estimator.keyframes, estimator.model.settings
    try:
        estimator.keyframes = lost
        estimator.model.settings = replace(settings, smoothing=SmoothingSettings(piece_keyframes=size))
        bridged = estimator.smoothed()
    finally:
        estimator.keyframes, estimator.model.settings = whole, settings
    assert "smoothing_failed" not in estimator.info
    off = np.linalg.norm(bridged.positions - usual.positions, axis=1)
    sigma = np.sqrt(np.einsum("nii->n", bridged.covariances[:, :3, :3]))
    assert off.max() < 0.1
    assert (off < 4 * sigma + 1e-3).all()
    turned = Rotation.from_quat(bridged.quaternions) * Rotation.from_quat(usual.quaternions).inv()
    assert np.degrees(turned.magnitude()).max() < 1.0


def test_a_path_that_ends_lost_is_smoothed_to_its_end():
    measured = dive.make_dive(4, duration_s=12.0, blind=(8.0, 12.0))
    for k, sample in enumerate(measured.samples):  # more than any estimator lives through
        if 8.0 < (sample.stamp_ns - dive.START_NS) * 1e-9 < 8.2:
            measured.samples[k] = replace(sample, accel=sample.accel + np.array([30.0, 0.0, 0.0]))
    estimator = estimate(measured)
    assert estimator.window is None
    smoothed, online = estimator.smoothed(), estimator.online()
    assert "smoothing_failed" not in estimator.info
    assert np.array_equal(smoothed.stamps_ns, online.stamps_ns)
    seen = smoothed.stamps_ns < dive.START_NS + 7_500_000_000
    assert position_error(measured.truth, smoothed.select(seen)) < 0.02
    assert len(smoothed.covariances) == len(smoothed)
    sigma = np.sqrt(np.einsum("nii->n", smoothed.covariances[:, :3, :3]))
    assert sigma[-1] > 10 * sigma[seen].max()


def transect(times: np.ndarray) -> np.ndarray:
    """A survey on a straight line at 0.4 m/s that hardly turns, as a heavy vehicle flies it."""
    sway, angle = 2 * np.pi * times, np.radians(0.3)
    return dive.poses_of(
        0.4 * times + 0.06 * np.sin(0.21 * sway) - 5.0,
        0.1 * np.sin(0.17 * sway + 1.0),
        0.06 * np.sin(0.27 * sway + 0.5) - 3.0,
        *(angle * np.sin(0.15 * sway + phase) for phase in (0.0, 0.7, 0.2)),
    )


def test_a_blind_stretch_after_which_nothing_fits_is_bridged_from_both_sides():
    """The estimator starts anew, as its velocity is off by too much; what it had by inertia alone is not doubtful."""
    measured = dive.make_dive(0, duration_s=30.0, most=60, pose=transect, blind=(8.0, 20.0))
    estimator = estimate(measured)
    assert estimator.info["restarts"] >= 1
    assert not any(keyframe.astray for keyframe in estimator.keyframes)
    smoothed = estimator.smoothed()
    assert position_error(measured.truth, smoothed) < 0.1 < position_error(measured.truth, estimator.online())


def test_what_is_distrusted_shows_no_rest(estimator):
    keyframe = replace(estimator.keyframes[5], stationary=True)
    keyframe.distrust_sight()
    assert (keyframe.stationary, keyframe.blind) == (False, True)
    blind = [*estimator.keyframes[:5], replace(estimator.keyframes[5], stationary=True, blind=True)]
    seeing = [*estimator.keyframes[:5], replace(estimator.keyframes[5], stationary=True)]
    states = [one.estimate for one in seeing]
    counts = [len(motion_factors(estimator.model, path, states, range(6))) for path in (blind, seeing)]
    rests = [estimator.model.drag(seeing[5])]  # what a blind keyframe has in its place
    assert counts[0] == counts[1] - 1 + len(rests)


def test_what_is_distrusted_is_not_blind_where_another_sensor_measured_its_velocity(estimator):
    """Or the drag of a vehicle of which nothing is known would pull at the velocity that a DVL gave."""
    keyframe = replace(estimator.keyframes[5], measured=True)
    keyframe.distrust_sight()
    assert not keyframe.blind
    assert not len(keyframe.observations.ids)
