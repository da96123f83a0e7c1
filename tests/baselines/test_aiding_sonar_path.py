"""An imaging sonar in filter and graph: derivatives, and a dive in the dark that it holds together."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from typing import Any

import gtsam
import numpy as np
import pytest
from gtsam.symbol_shorthand import V, X
from scipy.spatial.transform import Rotation

from oysterbench.core.geometry import Array, transform
from oysterbench.core.measurements import RangeMeasurement, SonarImage
from oysterbench.core.streams import stream
from oysterbench.sequence.types import AltimeterCalibration
from oysterbench_baselines.common.aiding.dvl import Dvl
from oysterbench_baselines.common.aiding.sonar import Sonar
from oysterbench_baselines.common.aiding.sonar.factor import (
    SONAR_KEY,
    Motion,
    Sighting,
    Step,
    step_error,
    step_factor,
)
from oysterbench_baselines.common.aiding.sonar.fan import View
from oysterbench_baselines.common.aiding.sonar.sensor import heading_of, predict
from oysterbench_baselines.common.filter import CORE, InertialNoise, InvariantFilter, rotation_exp
from oysterbench_baselines.common.inertial import Segment
from oysterbench_baselines.gtsam_full import GtsamFull, GtsamFullSettings
from oysterbench_baselines.gtsam_full.method import aided_estimator
from tests.baselines.test_aiding_sonar import CALIBRATION, fan, oysters
from tests.baselines.test_gtsam_full import camera, first_moments
from tests.helpers import sensor_dive as dive

MOUNT = transform(Rotation.from_euler("zyx", [1.0, 25.0, -2.0], degrees=True).as_matrix(), [0.31, -0.02, -0.11])
STEP = 1e-6


def segment(duration_s: float, seed: int) -> Segment:
    rng, n = stream(seed, b"", "segment"), round(duration_s / 0.005)
    gyro = rng.normal(0, 0.2, size=(n, 3))
    return Segment(np.full(n, 0.005), gyro, np.array([0.1, -0.2, 9.8]) + rng.normal(0, 0.3, size=(n, 3)))


def a_filter() -> InvariantFilter:
    filter = InvariantFilter(Rotation.from_euler("zyx", [0.7, 0.1, -0.05]).as_matrix(), InertialNoise(0, 0, 0, 0), 9.81)
    filter.velocity, filter.position = np.array([0.3, 0.1, -0.05]), np.array([4.0, -2.0, -3.0])
    filter.gyro_bias, filter.accel_bias = np.array([0.01, -0.02, 0.005]), np.array([0.1, -0.05, 0.02])
    filter.covariance = np.eye(CORE)
    return filter


def moved(filter: InvariantFilter, error: Array) -> InvariantFilter:
    """The state that is off by an error (15,) of the filter's kind."""
    other, turn = a_filter(), rotation_exp(error[:3])
    other.rotation = turn @ filter.rotation
    other.velocity, other.position = turn @ filter.velocity + error[3:6], turn @ filter.position + error[6:9]
    other.gyro_bias, other.accel_bias = filter.gyro_bias + error[9:12], filter.accel_bias + error[12:15]
    return other


def test_the_predicted_way_is_that_of_the_inertial_measurements():
    filter, way = a_filter(), segment(0.5, 1)
    before = filter.pose @ MOUNT
    velocity = filter.velocity.copy()
    filter.propagate_all(way)
    after = filter.pose @ MOUNT
    predicted, _ = predict(filter, Motion.over([way], filter.gyro_bias, filter.accel_bias), MOUNT)
    np.testing.assert_allclose(predicted[:2], (after - before)[:2, 3], atol=2e-4)
    assert predicted[2] == pytest.approx(heading_of(after[:3, :3]) - heading_of(before[:3, :3]), abs=1e-6)
    assert np.linalg.norm(0.5 * velocity[:2]) > 0.1


def test_the_predicted_way_has_the_derivatives_that_it_claims():
    """In the level axes that turn with the vehicle, in which the picture is registered."""
    filter, way = a_filter(), [segment(0.3, 2)]

    def predicted(error: Array) -> Array:
        at = moved(filter, error)
        motion = Motion.over(way, filter.gyro_bias, at.accel_bias)
        found, _ = predict(at, motion, MOUNT)
        return Rotation.from_euler("z", -error[2]).as_matrix()[:2, :2] @ found[:2]

    _, slope = predict(filter, Motion.over(way, filter.gyro_bias, filter.accel_bias), MOUNT)
    numeric = np.column_stack([(predicted(STEP * row) - predicted(-STEP * row)) / (2 * STEP) for row in np.eye(CORE)])
    np.testing.assert_allclose(slope, numeric, atol=0.012)  # the lever arm's tilt, 1 cm a radian, is left out
    np.testing.assert_allclose(slope[:, 3:], numeric[:, 3:], atol=1e-7)


def a_step() -> tuple[Step, list[Any]]:
    """From the truth of two key frames, each with a ping a moment before; and the values of its variables."""
    ends, variables = list[Sighting](), list[Any]()
    for seed, place, yaw in ((3, [0.4, 0.2, -2.0], 0.5), (4, [0.9, 0.6, -2.1], 0.9)):
        pose = transform(Rotation.from_euler("zyx", [yaw, 0.1, -0.08]).as_matrix(), place)
        velocity, since = np.array([0.3, 0.2, -0.1]), Motion.over([segment(0.2, seed)], np.zeros(3), np.zeros(3))
        then = pose[:3, :3] @ since.rotation.T
        sonar = pose[:3, 3] - since.time * velocity + then @ since.lag + then @ MOUNT[:3, 3]
        in_chart = np.append(sonar[:2], heading_of(then @ MOUNT[:3, :3]))
        covariance = np.diag([4e-3, 3e-3, 1e-3]) ** 2
        ends.append(Sighting.at(in_chart, covariance, 1, 0.0, since, MOUNT))
        variables += [gtsam.Pose3(pose), velocity]
    return Step.of(ends[0], ends[1], 1e-5, 1e-3), [*variables, np.zeros(2)]


def test_a_step_is_right_at_the_truth_and_sees_scale_and_mount():
    step, at = a_step()
    np.testing.assert_allclose(step_error(step, *at)[0], 0, atol=1e-9)
    way = np.hypot(*step.measured)
    found, _ = step_error(step, *at[:4], np.array([0.01, 0.0]))
    assert np.linalg.norm(np.linalg.solve(step.root, found)) == pytest.approx(0.01 * way)


def test_a_step_has_the_derivatives_that_it_claims():
    step, at = a_step()
    at[4] = np.array([0.02, -0.03])
    _, slopes = step_error(step, *at)
    for n, slope in enumerate(slopes):
        for column in range(slope.shape[1]):
            change = STEP * np.eye(slope.shape[1])[column]
            ends = []
            for sign in (1, -1):
                other = list(at)
                other[n] = at[n].retract(sign * change) if isinstance(at[n], gtsam.Pose3) else at[n] + sign * change
                ends.append(step_error(step, *other)[0])
            np.testing.assert_allclose(slope[:, column], (ends[0] - ends[1]) / (2 * STEP), rtol=1e-5, atol=1e-5)


def test_a_step_is_a_factor_of_two_key_frames_and_the_calibration():
    step, at = a_step()
    keys, values = [X(1), V(1), X(2), V(2), SONAR_KEY], gtsam.Values()
    for key, value in zip(keys, at, strict=True):
        values.insert(key, value)
    factor = step_factor(step, 1, 2, huber=3.0)
    assert list(factor.keys()) == keys
    assert factor.error(values) == pytest.approx(0.0, abs=1e-12)


class SonarDive(dive.SensorDive):
    """With fans of a sonar over oysters, and an altimeter."""

    rate_hz = 4.0

    def __init__(self, seed: int, vehicle: Any, path: Any) -> None:
        super().__init__(seed, vehicle, path)
        self.cameras = {"cam": camera()}
        self.sonars = {"sonar": dataclasses.replace(CALIBRATION, T_base_sensor=MOUNT)}
        down = transform(Rotation.from_euler("y", 90, degrees=True).as_matrix(), [0.0, 0.0, 0.0])
        self.altimeters = {"altimeter": AltimeterCalibration(0.4, 0.1, 50.0, down)}
        points, amplitudes = oysters(seed, 9000)
        self.reef = (points - [3.0, 0.0]) * [2.6, 2.2], amplitudes
        self.spoilt: slice = slice(0, 0)  # pings that show another place

    def sonar(self, name: str, start_ns: int | None = None, end_ns: int | None = None) -> Iterator[SonarImage]:
        times, stamps = self._clock(self.rate_hz)
        motion = self.path.at(times)
        spoilt = set(range(len(stamps))[self.spoilt])
        for k, stamp in enumerate(stamps.tolist()):
            pose = transform(motion.rotation[k], motion.position[k]) @ MOUNT
            heading = heading_of(pose[:3, :3])
            level = Rotation.from_euler("z", -heading).as_matrix() @ pose[:3, :3]
            # Oysters are 8 cm high, as the sensor takes the bottom to be.
            view = View(float(pose[2, 3]) + dive.BOTTOM_M - 0.08, level)
            place = np.array([pose[0, 3] + (50.0 if k in spoilt else 0.0), pose[1, 3], heading])
            yield SonarImage(stamp, name, fan(k, self.reef, place, view))

    def ranges(self, name: str, start_ns: int | None = None, end_ns: int | None = None) -> Iterator[RangeMeasurement]:
        times, stamps = self._clock(5.0)
        for stamp, z in zip(stamps.tolist(), self.path.at(times).position[:, 2], strict=True):
            yield RangeMeasurement(stamp, name, float(z + dive.BOTTOM_M))


def run(sequence: SonarDive, **settings: Any) -> tuple[float, dict[str, Any]]:
    """RMSE (m) of the position in odom, and what the method says."""
    method = GtsamFull(settings=dataclasses.replace(GtsamFullSettings(), pictures=False, **settings))
    estimate = method.run(sequence.for_method())
    truth = sequence.truth_from_start().at(estimate.trajectory.stamps_ns)
    off = np.sum((truth.positions - estimate.trajectory.positions) ** 2, axis=1)
    return float(np.sqrt(off.mean())), dict(estimate.info)


@pytest.mark.slow
@pytest.mark.parametrize("resting", [True, False])
def test_a_dive_without_pictures_and_log_is_held_by_the_sonar(resting):
    """From rest, and in motion from the first moment; with four pings of another place in it."""
    sequence = SonarDive(1, dive.rig("pressure", "magnetometer"), dive.survey_path(16.0, resting=resting))
    sequence.spoilt = slice(40, 44)
    error, info = run(sequence)
    assert error < 0.01 * sequence.truth().path_length
    assert 4 <= info["refused_sonar"] < 10
    assert "sonar" in info["sensors"]


def test_the_sonar_can_be_left_out():
    sequence = SonarDive(1, dive.rig("dvl", "pressure", "magnetometer"), dive.survey_path(8.0))
    _, info = run(sequence, sonar=False)
    assert "refused_sonar" not in info
    assert "sonar" not in info["sensors"]


def test_a_log_goes_before_the_sonar():
    """As long as it gives velocities; the chart is kept meanwhile."""
    sequence = SonarDive(1, dive.rig("dvl", "pressure", "magnetometer"), dive.survey_path(6.0))
    estimator = aided_estimator(sequence, camera(), GtsamFullSettings(), first_moments(sequence))
    sonar, log = estimator.aiding.sensors["sonar"], estimator.aiding.sensors["dvl"]
    assert isinstance(sonar, Sonar)
    assert isinstance(log, Dvl)
    assert sonar._counts(dive.START_NS)
    log.velocity_ns = dive.START_NS
    assert not sonar._counts(dive.START_NS + 5 * 10**8)
    assert sonar._counts(dive.START_NS + 2 * 10**9)
