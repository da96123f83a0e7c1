"""Ranges against the ground that landmarks make: right at the truth, with the derivatives they claim, and modest."""

from __future__ import annotations

import gtsam
import numpy as np
import pytest
from gtsam.symbol_shorthand import L, X
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from oysterbench.core.geometry import Array, transform
from oysterbench.core.measurements import RangeMeasurement
from oysterbench.core.streams import Streams, stream
from oysterbench.recipe import SiteRecipe
from oysterbench.sensors import acoustics, altimeter
from oysterbench.sensors.altimeter import AltimeterRecipe
from oysterbench.sequence.types import AltimeterCalibration
from oysterbench_baselines.gtsam_full.ranges import (
    ALTIMETER,
    BEAM,
    ECHO_KEY,
    Echo,
    Ground,
    RangeSettings,
    altimeter_echo,
    echo_error,
    echo_factor,
    find_ground,
)
from tests.helpers import sensor_dive as dive

OF = RangeSettings()
STILL = (np.zeros(3), np.zeros(3))
DOWN = np.array([0.05, -0.1, -1.0]) / np.linalg.norm([0.05, -0.1, -1.0])


def bottom(rough: float = 0.0, slope: float = 0.0, count: int = 400) -> tuple[np.ndarray, Array]:
    """Ids and points of landmarks on a bottom 5 m down, within 1 m: a hundred in a square metre."""
    rng = stream(21, b"", "bottom")
    points = rng.uniform([-1, -1, 0], [1, 1, 0], size=(count, 3))
    points[:, 2] = -5.0 + slope * points[:, 0] + rough * rng.normal(size=count)
    return np.arange(100, 100 + count), points


def pose(height: float = 1.2) -> Array:
    return transform(Rotation.from_euler("zyx", [0.4, 0.08, -0.05]).as_matrix(), [0.1, -0.2, -5.0 + height])


def meet(echo: Echo, at: Array, ids: np.ndarray, points: Array) -> Ground | None:
    return find_ground(echo, at, cKDTree(points), ids, points, OF)


def true_range(echo: Echo, at: Array, slope: float = 0.0) -> float:
    """Along the echo's axis, to the plane; of a wide beam, the shortest within it is the perpendicular."""
    origin = at[:3, :3] @ echo.origin + at[:3, 3]
    normal = np.array([-slope, 0, 1]) / np.hypot(slope, 1)
    height = normal @ (origin - [0, 0, -5.0])
    return float(height if echo.half_beam else height / -(normal @ at[:3, :3] @ echo.axis))


@pytest.mark.parametrize(("kind", "half_beam"), [(BEAM, 0.0), (ALTIMETER, 0.3)])
@pytest.mark.parametrize("slope", [0.0, 0.2])
def test_at_the_truth_nothing_is_left(kind, half_beam, slope):
    ids, points = bottom(slope=slope)
    echo = Echo(np.array([-0.1, 0.1, -0.1]), DOWN, 1.0, 0.02, half_beam, kind)
    echo = Echo(echo.origin, echo.axis, true_range(echo, pose(), slope), 0.02, half_beam, kind)
    ground = meet(echo, pose(), ids, points)
    assert ground is not None
    error, _ = echo_error(echo, ground, gtsam.Pose3(pose()), points[ground.ids - 100], np.zeros(2))
    assert abs(error) < 1e-9
    assert ground.sigma == pytest.approx(0.02)
    assert ground.weights.sum() == pytest.approx(1.0)


@pytest.mark.parametrize(("kind", "half_beam"), [(BEAM, 0.0), (ALTIMETER, 0.3)])
def test_derivatives_are_those_of_the_error(kind, half_beam):
    ids, points = bottom(rough=0.01, slope=0.1)
    echo = Echo(np.array([-0.1, 0.1, -0.1]), DOWN, 1.05, 0.02, half_beam, kind)
    ground = meet(echo, pose(), ids, points)
    assert ground is not None
    landmarks, offsets, at = points[ground.ids - 100], np.array([0.01, -0.02]), gtsam.Pose3(pose())

    def error(of_pose: Array, of_landmarks: Array, of_offsets: Array) -> float:
        return echo_error(echo, ground, at.retract(of_pose), landmarks + of_landmarks, offsets + of_offsets)[0]

    still = np.zeros(6), np.zeros_like(landmarks), np.zeros(2)
    _, slopes = echo_error(echo, ground, at, landmarks, offsets)
    for part, slope in enumerate(slopes):
        for index in np.ndindex(slope.shape):
            ends = []
            for sign in (1e-6, -1e-6):
                moved = [change.copy() for change in still]
                moved[part][index] = sign
                ends.append(error(*moved))
            assert (ends[0] - ends[1]) / 2e-6 == pytest.approx(slope[index], abs=1e-7), (part, index)


def test_the_factor_gives_the_solver_the_same_derivatives():
    ids, points = bottom(rough=0.03)
    echo = Echo(np.zeros(3), DOWN, 1.18, 0.02, 0.0, BEAM)
    ground = meet(echo, pose(), ids, points)
    assert ground is not None
    values = gtsam.Values()
    values.insert(X(3), gtsam.Pose3(pose()))
    values.insert(ECHO_KEY, np.zeros(2))
    for i in ground.ids:
        values.insert(L(int(i)), points[i - 100])
    factor = echo_factor(echo, ground, 3)
    residual, slopes = echo_error(echo, ground, gtsam.Pose3(pose()), points[ground.ids - 100], np.zeros(2))
    matrix, right = factor.linearize(values).jacobian()
    # Weighted by Cauchy's loss.
    whitened = residual / ground.sigma
    weight = 1 / np.sqrt(1 + whitened**2)
    np.testing.assert_allclose(right, [-whitened * weight], rtol=1e-9)
    expected = np.concatenate([slopes[0], slopes[1].ravel(), slopes[2]]) * weight / ground.sigma
    np.testing.assert_allclose(matrix[0], expected, rtol=1e-9)


def test_a_rough_bottom_makes_a_range_uncertain():
    level, rough = (meet(Echo(np.zeros(3), DOWN, 1.2, 0.02, 0.0, BEAM), pose(), *bottom(r)) for r in (0.0, 0.06))
    assert level is not None
    assert rough is not None
    assert rough.sigma > 2 * level.sigma
    # And where stones are as high as they are wide there is no ground to speak of.
    assert meet(Echo(np.zeros(3), DOWN, 1.2, 0.02, 0.0, BEAM), pose(), *bottom(0.3)) is None


def test_no_ground_is_made_of_landmarks_that_make_none():
    echo = Echo(np.zeros(3), DOWN, 1.2, 0.02, 0.0, BEAM)
    ids, points = bottom()
    assert meet(echo, pose(), ids, points) is not None
    met = pose()[:3, :3] @ DOWN * 1.2 + pose()[:3, 3]
    few = points[np.argsort(np.linalg.norm(points - met, axis=1))[: OF.fewest - 1]]
    assert meet(echo, pose(), ids[: len(few)], few) is None
    assert meet(echo, pose(), ids, met + (points - points.mean(axis=0)) * [0.1, 1e-4, 0]) is None  # a line
    assert meet(echo, pose(), ids, points[:, [2, 1, 0]] + [5.1, 0, -5]) is None  # a wall
    aside = points[points[:, 0] > met[0] + 0.1]
    assert meet(echo, pose(), ids[: len(aside)], aside) is None


def test_the_altimeters_own_reading_over_a_level_bottom_is_what_is_predicted():
    """But for what the first strong echo is nearer by than the perpendicular, which is what offsets are for."""
    recipe = AltimeterRecipe(name="altimeter", rate_hz=2.0, position_m=(-0.1, 0.1, -0.1), noise_m=0.0, noise_share=0.0)
    path = dive.survey_path(12.0, resting=False)
    times = np.arange(0, 10, 0.5)
    ranges = altimeter.measure(path, dive.LevelBottom(), recipe, SiteRecipe(), times, Streams(0))
    mount = AltimeterCalibration(np.radians(recipe.beam_deg), 0.3, 100.0, acoustics.mount_pose(recipe))
    motion = path.at(times)
    rng = stream(22, b"", "bottom")
    off = []
    for k, length in enumerate(ranges):
        at = transform(motion.rotation[k], motion.position[k])
        points = rng.uniform([-1, -1, 0], [1, 1, 0], size=(400, 3)) + motion.position[k] * [1, 1, 0]
        points[:, 2] = -dive.BOTTOM_M
        echo = altimeter_echo(RangeMeasurement(k, "altimeter", float(length)), mount, np.eye(4), STILL, OF)
        assert echo is not None
        ground = meet(echo, at, np.arange(400), points)
        assert ground is not None
        off.append(echo_error(echo, ground, gtsam.Pose3(at), points[ground.ids], np.zeros(2))[0])
    assert np.abs(np.mean(off)) < 2 * OF.offset_sigma
    assert np.ptp(off) < 0.02
    assert altimeter_echo(RangeMeasurement(0, "altimeter", np.inf), mount, np.eye(4), STILL, OF) is None


@pytest.mark.parametrize("holes", [0, 2])
def test_ranges_tell_the_scale_that_bearings_leave_open_and_holes_in_the_reef_do_not_mislead(holes):
    """Six views of a bottom, nothing metric but the echoes: begun 12 % too large. In holes: two of twelve."""
    ids, points = bottom(rough=0.01, count=300)
    rng = stream(23, b"", "scale")
    camera = transform(Rotation.from_euler("x", np.pi).as_matrix(), [0, 0, 0])  # looks down
    poses = [transform(np.eye(3), [0.15 * k - 0.4, 0.02 * k, -3.8]) for k in range(6)]
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    noise = gtsam.noiseModel.Isotropic.Sigma(2, 0.002)
    wrong = 1.12
    for k, at in enumerate(poses):
        values.insert(X(k), gtsam.Pose3(transform(np.eye(3), poses[0][:3, 3] + wrong * (at - poses[0])[:3, 3])))
        for i, point in zip(ids, points, strict=True):
            local = np.linalg.inv(at @ camera) @ np.append(point, 1.0)
            ray = local[:2] / local[2] + 0.0005 * rng.normal(size=2)
            graph.push_back(
                gtsam.GenericProjectionFactorCal3_S2(
                    ray, noise, X(k), L(int(i)), gtsam.Cal3_S2(), False, False, gtsam.Pose3(camera)
                )
            )
    guessed = poses[0][:3, 3] + wrong * (points - poses[0][:3, 3])
    for i, point in zip(ids, guessed, strict=True):
        values.insert(L(int(i)), point)
    graph.push_back(gtsam.PriorFactorPose3(X(0), gtsam.Pose3(poses[0]), gtsam.noiseModel.Isotropic.Sigma(6, 1e-4)))
    graph.push_back(gtsam.PriorFactorVector(ECHO_KEY, np.zeros(2), gtsam.noiseModel.Isotropic.Sigma(2, 0.01)))
    values.insert(ECHO_KEY, np.zeros(2))
    # Without echoes the scale has no factor; a weak one keeps the equations regular.
    weak = gtsam.noiseModel.Isotropic.Sigma(6, 0.5)
    graph.push_back(gtsam.PriorFactorPose3(X(5), values.atPose3(X(5)), weak))
    made = 0
    for k in range(len(poses)):
        for side in (-1, 1):
            axis = np.array([0.0, side * np.sin(0.39), -np.cos(0.39)])
            length = 1.2 / np.cos(0.39) + 0.01 * rng.normal() + (0.4 if made < holes else 0.0)
            made += 1
            echo = Echo(np.zeros(3), axis, length, 0.02, 0.0, BEAM)
            ground = meet(echo, values.atPose3(X(k)).matrix(), ids, guessed)
            if ground is not None:
                graph.push_back(echo_factor(echo, ground, k))
    result = gtsam.LevenbergMarquardtOptimizer(graph, values).optimize()
    scale = np.linalg.norm(result.atPose3(X(5)).translation() - poses[0][:3, 3]) / np.linalg.norm(
        poses[5][:3, 3] - poses[0][:3, 3]
    )
    assert scale == pytest.approx(1.0, abs=0.02)
