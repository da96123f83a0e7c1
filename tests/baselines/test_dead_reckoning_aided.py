"""What dead reckoning promises with a DVL, a pressure sensor and a compass, each made by oysterbench's own sensors."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from oysterbench.core.geometry import Array
from oysterbench.core.trajectory import Trajectory
from oysterbench.evaluate.slam.scoring import SlamSettings, score
from oysterbench_baselines.common.aiding import Aiding, AidingSettings, aiding_sensors
from oysterbench_baselines.common.filter import CORE, InertialNoise, InvariantFilter, rotation_exp
from oysterbench_baselines.common.inertial import Segment
from oysterbench_baselines.dead_reckoning import DeadReckoning
from tests.helpers import sensor_dive as dive

ALL = ("dvl", "pressure", "magnetometer")


def make(seed: int, sensors: tuple[str, ...], seconds: float, resting: bool = True, **dvl_keys) -> dive.SensorDive:
    return dive.SensorDive(seed, dive.rig(*sensors, **dvl_keys), dive.survey_path(seconds, resting, phase=float(seed)))


def reckon(sequence: dive.SensorDive) -> Trajectory:
    return DeadReckoning().run(sequence.for_method()).trajectory


def errors(sequence: dive.SensorDive, trajectory: Trajectory) -> Array:
    """(N, 6) true minus estimated position (m) and rotation (rad), in odom."""
    truth = sequence.truth_from_start()
    turn = Rotation.from_quat(truth.quaternions) * Rotation.from_quat(trajectory.quaternions).inv()
    return np.column_stack([truth.positions - trajectory.positions, turn.as_rotvec()])


def drift(sequence: dive.SensorDive, trajectory: Trajectory) -> float:
    """Error of position at the end, as a share of the path."""
    return float(np.linalg.norm(errors(sequence, trajectory)[-1, :3]) / sequence.truth().path_length)


@pytest.mark.slow
@pytest.mark.parametrize(("resting", "seed"), [(True, 0), (False, 1)])
def test_with_a_dvl_the_path_drifts_by_less_than_a_hundredth_in_two_minutes(resting, seed):
    sequence = make(seed, ("dvl", "pressure"), 120.0, resting)
    trajectory = reckon(sequence)
    assert sequence.truth().path_length > 50
    assert drift(sequence, trajectory) < 0.01
    assert np.abs(errors(sequence, trajectory)[:, 2]).max() < 0.05  # depth does not drift at all


@pytest.mark.slow
def test_errors_are_as_large_as_the_covariances_say():
    """NEES over dives that differ in noise, biases, misalignment and sway, of a unit that warms as the filter assumes.

    In a gauge of its own: where the vehicle starts and points. At one instant the sum over independent dives is
    chi-square with 6 degrees each.
    """
    runs = 10
    instants: dict[int, list[float]] = {500: [], 1000: [], 1999: []}
    for seed in range(runs):
        sequence = make(seed, ALL, 20.0, resting=seed % 2 == 0, unit=dive.WARMING)
        trajectory = reckon(sequence)
        error = errors(sequence, trajectory)
        for k, values in instants.items():
            values.append(error[k] @ np.linalg.solve(trajectory.covariances[k], error[k]))
    for k, values in instants.items():
        low, high = chi2.ppf([0.0005, 0.9995], 6 * runs) / runs
        assert low < np.mean(values) < high, k


@pytest.mark.slow
@pytest.mark.parametrize("sensors", [ALL, ("dvl",)])
def test_a_start_in_motion_is_no_surer_than_it_errs_from_the_first_second_on(sensors):
    """Of 16 dives. The floor is lower than chi-square's: sigmas of 5 mm of depth and 0.5 deg of misalignment stand for
    a sea and a mount that are worse than these."""
    runs, instants = 16, (50, 100, 200, 300)
    values = []
    for seed in range(runs):
        sequence = make(seed, sensors, 3.5, resting=False)
        trajectory = reckon(sequence)
        error = errors(sequence, trajectory)
        values.append([error[k] @ np.linalg.solve(trajectory.covariances[k], error[k]) for k in instants])
    high = chi2.ppf(0.999, 6 * runs) / runs
    assert np.all(np.mean(values, axis=0) < high)
    assert np.all(np.mean(values, axis=0) > 2)


def test_one_velocity_says_nothing_of_the_misalignment():
    """Nor do many of a vehicle that neither turns nor speeds up, so long as its attitude is as uncertain."""
    sequence = make(0, ("dvl",), 3.0, resting=False)
    filter, aiding = (
        InvariantFilter(np.eye(3), InertialNoise(1e-4, 1e-3, 1e-5, 1e-4), 9.80665),
        Aiding(aiding_sensors(sequence, AidingSettings())),
    )
    filter.covariance[:6, :6] = np.diag([0.05**2] * 3 + [1.0] * 3)
    samples = list(sequence.dvl())[:8]
    prior = np.radians(AidingSettings().dvl.misalignment_sigma_deg)
    level = Segment(np.full(100, 0.01), np.zeros((100, 3)), np.tile([0.0, 0.0, 9.80665], (100, 1)))
    aiding.propagate(level)  # so that what the log saw is as old as it may be
    for sample in samples:
        aiding.update(filter, dataclasses.replace(sample, beam_velocities=samples[0].beam_velocities))
        at = aiding.sensors["dvl"].rows
        left = np.sqrt(np.diag(filter.covariance)[at.start + 1 : at.start + 4])
        np.testing.assert_allclose(left, prior, rtol=1e-4)
    assert np.linalg.norm(filter.velocity) > 0.3  # they were heard


def test_the_evaluator_finds_the_covariances_and_that_they_agree():
    sequence = make(3, ALL, 30.0)
    result = score(sequence.truth_from_start(), reckon(sequence), SlamSettings(align="none"))
    assert result.metrics["coverage"] == 1.0
    assert 0.3 < result.metrics["nees_position"] < 12
    assert result.metrics["within_3sigma_pose"] > 0.9


@pytest.mark.slow
def test_a_compass_holds_the_heading_that_a_moving_start_leaves_open():
    """Without it, the gyroscope's bias about the vertical is hardly seen; iron is unknown to it."""
    turned = []
    for sensors in (("dvl", "pressure"), ALL):
        sequence = make(0, sensors, 60.0, resting=False)
        turned.append(abs(errors(sequence, reckon(sequence))[-1, 5]))
    assert turned[1] < 0.4 * turned[0]
    assert turned[1] < np.radians(1.5)


def test_depth_alone_keeps_the_height_of_an_inertial_path():
    sequence = make(0, ("pressure",), 20.0)
    assert np.abs(errors(sequence, reckon(sequence))[:, 2]).max() < 0.05
    bare = make(0, (), 20.0)
    assert np.abs(errors(bare, reckon(bare))[:, 2]).max() > 0.1


def test_false_velocities_are_refused():
    sequence = make(1, ("dvl", "pressure"), 40.0)
    generator = np.random.default_rng(0)

    def lie(sample):
        if generator.random() > 0.05:
            return sample
        return dataclasses.replace(sample, beam_velocities=sample.beam_velocities + generator.normal(size=4))

    sequence.change("dvl", lie)
    result = DeadReckoning().run(sequence.for_method())
    assert result.info["refused"]["dvl"] > 5
    assert drift(sequence, result.trajectory) < 0.01


def test_without_bottom_lock_for_ten_seconds_the_covariance_grows_and_the_lock_brings_it_back():
    sequence = make(2, ("dvl", "pressure"), 40.0)

    def deafen(sample):
        if not 20.0 < (sample.stamp_ns - dive.START_NS) * 1e-9 < 30.0:
            return sample
        none = np.full(4, np.nan)
        return dataclasses.replace(
            sample,
            velocity=np.full(3, np.nan),
            covariance=np.full((3, 3), np.nan),
            beam_velocities=none,
            beam_ranges=none,
            beam_valid=np.zeros(4, dtype=bool),
        )

    sequence.change("dvl", deafen)
    trajectory = reckon(sequence)
    error = errors(sequence, trajectory)
    sigma = np.sqrt(trajectory.covariances[:, 0, 0] + trajectory.covariances[:, 1, 1])
    assert sigma[2990] > 2 * sigma[1990]
    assert np.all(np.linalg.norm(error[:, :2], axis=1) < 5 * sigma + 1e-3)
    assert np.linalg.norm(error[-1, :3]) < 0.5


def test_two_beams_of_four_still_hold_the_path_down():
    """A DVL that reports no velocity, since two beams are lost, is not without use."""

    def lame(sample):
        valid = np.array([True, False, True, False]) if sample.stamp_ns % 250_000_000 else np.array([False, True] * 2)
        return dataclasses.replace(
            sample,
            velocity=np.full(3, np.nan),
            covariance=np.full((3, 3), np.nan),
            beam_velocities=np.where(valid, sample.beam_velocities, np.nan),
            beam_valid=valid,
        )

    sequence = make(4, ("dvl", "pressure"), 40.0)
    sequence.change("dvl", lame)
    assert drift(sequence, reckon(sequence)) < 0.02


@pytest.mark.slow
def test_each_beam_that_is_left_helps():
    """Eight seconds without a velocity, none, one, two or three beams: each makes the path surer, and none too sure."""
    sigmas, values = [], []
    for beams in range(4):
        valid = np.arange(4) < beams

        def lame(sample, valid=valid):
            if (sample.stamp_ns - dive.START_NS) * 1e-9 < 5.0:
                return sample
            return dataclasses.replace(
                sample,
                velocity=np.full(3, np.nan),
                covariance=np.full((3, 3), np.nan),
                beam_velocities=np.where(valid, sample.beam_velocities, np.nan),
                beam_valid=valid,
            )

        for seed in range(2):
            sequence = make(seed, ("dvl", "pressure"), 13.0, resting=False)
            sequence.change("dvl", lame)
            trajectory = reckon(sequence)
            error, covariance = errors(sequence, trajectory)[-1], trajectory.covariances[-1]
            values.append(error @ np.linalg.solve(covariance, error))
        sigmas.append(float(np.sqrt(np.trace(covariance[:2, :2]))))
    assert sigmas[0] > 1.5 * sigmas[1]
    assert sigmas[1] > 1.2 * sigmas[2]
    assert sigmas[2] > sigmas[3]
    assert np.mean(values) < chi2.ppf(0.999, 6 * len(values)) / len(values)


@pytest.mark.slow
def test_waves_are_told_from_the_readings_and_do_not_pull_the_depth():
    """A swell of 8 cm and 5 s at the sensor, as a shallow reef has it, in the readings alone: no state knows of it."""
    sequence = make(3, ("dvl", "pressure"), 40.0)
    calm = make(3, ("dvl", "pressure"), 40.0)

    def swell(sample):
        elapsed = (sample.stamp_ns - dive.START_NS) * 1e-9
        return dataclasses.replace(sample, pressure=sample.pressure + 1e4 * 0.08 * np.sin(2 * np.pi * elapsed / 5.0))

    sequence.change("pressure", swell)
    result = DeadReckoning().run(sequence.for_method())
    trajectory, in_calm = result.trajectory, reckon(calm)
    off = errors(sequence, trajectory)
    # When it has seen some waves; the height of the start is a reading, too.
    assert np.ptp(off[2500:, 2]) < 0.03
    assert result.info["refused"]["pressure"] < 5
    sigma = np.sqrt(trajectory.covariances[:, 2, 2])
    assert np.all(np.abs(off[:, 2]) < 4 * sigma + 1e-3)
    # And a calm sea is told as well: depth is then held more tightly.
    assert np.sqrt(in_calm.covariances[-1, 2, 2]) < 0.5 * sigma[-1]


@pytest.mark.parametrize("kind", ALL)
def test_each_sensors_derivative_is_that_of_its_prediction(kind):
    """The row that a sample adds, against the change of its residual when the filter's error is moved."""
    sequence = make(0, ALL, 10.0)
    base = started(sequence)
    (sample,) = [s for s in sequence._samples[kind] if s.stamp_ns == dive.START_NS + 2 * 10**9]
    seen = []

    def capture(filter, residual, slope, variances):
        seen.append((residual, slope))
        return True

    def ask(change: Array):
        filter, aiding = moved(base[0], change), base[1]
        aiding.sensors["magnetometer"]._last_ns = None
        aiding.sensors["dvl"]._clock.late = lambda stamp_ns: (0.01, 0.005)
        aiding.sensors[kind].correct = capture
        aiding.update(filter, sample)
        return seen.pop()

    n = len(base[0].covariance)
    residual, slope = ask(np.zeros(n))
    if kind == "dvl":  # its derivative is taken where the sample leads to: here, where the filter is
        sample = dataclasses.replace(sample, beam_velocities=sample.beam_velocities - residual)
        residual, slope = ask(np.zeros(n))
        np.testing.assert_allclose(residual, 0, atol=1e-12)
    step = 1e-6
    for axis in range(n):
        # Of a field in tesla a step is as small as the field.
        size = step * 1e-5 if kind == "magnetometer" and axis in range(n - 15, n - 9) else step
        ends = [ask(sign * size * np.eye(n)[axis])[0] for sign in (1, -1)]
        wanted = -(ends[0] - ends[1]) / (2 * size)
        # By the latency it is a difference over 50 ms, as the unit is shaken by more than the vehicle speeds up.
        share = 2e-2 if axis == CORE + 4 else 1e-6
        np.testing.assert_allclose(slope[:, axis], wanted, atol=share * max(1, np.abs(slope).max()), err_msg=str(axis))


def started(sequence: dive.SensorDive) -> tuple[InvariantFilter, Aiding]:
    """A filter in some state with the rows of all sensors, and what feeds it."""
    filter = InvariantFilter(rotation_exp(np.array([0.1, -0.2, 0.5])), InertialNoise(1e-4, 1e-3, 1e-5, 1e-4), 9.80665)
    filter.covariance = np.eye(CORE) * 1e-4
    filter.velocity, filter.position = np.array([0.4, -0.2, 0.1]), np.array([1.0, 2.0, -0.3])
    filter.rate = np.array([0.1, -0.05, 0.2])
    aiding = Aiding(aiding_sensors(sequence, AidingSettings()))
    steps = np.ones((60, 1))
    aiding.propagate(Segment(np.full(60, 0.01), steps * [0.1, -0.05, 0.2], steps * [0.3, -0.2, 9.9]))
    for kind in ALL:
        aiding.update(filter, sequence._samples[kind][0])
    filter.extra[:5] = [0.01, 0.02, -0.01, 0.03, 0.2]
    return filter, aiding


def moved(base: InvariantFilter, change: Array) -> InvariantFilter:
    """A copy whose error against `base` is `change`: the group's, to first order."""
    filter = InvariantFilter(base.rotation, InertialNoise(1e-4, 1e-3, 1e-5, 1e-4), 9.80665)
    turn = rotation_exp(change[:3])
    filter.rotation = turn @ base.rotation
    filter.velocity, filter.position = turn @ base.velocity + change[3:6], turn @ base.position + change[6:9]
    filter.gyro_bias, filter.accel_bias = base.gyro_bias + change[9:12], base.accel_bias + change[12:15]
    filter.rate = base.rate - change[9:12]
    filter.extra, filter.covariance = base.extra + change[CORE:], base.covariance.copy()
    return filter


def test_the_transition_is_that_of_the_propagation():
    """The covariance that comes out, against the spread of moved filters that are propagated each for itself."""
    generator = np.random.default_rng(0)
    base = InvariantFilter(rotation_exp(np.array([0.3, 0.1, -1.0])), InertialNoise(0, 0, 0, 0), 9.80665)
    base.velocity, base.position = np.array([0.5, 0.2, -0.1]), np.array([3.0, -2.0, 1.0])
    change = generator.normal(size=CORE) * 1e-5
    other = moved(base, change)
    base.covariance = np.outer(change, change)
    for _ in range(100):
        gyro, accel = generator.normal(size=3) * 0.2, np.array([0.2, -0.1, 9.8]) + generator.normal(size=3) * 0.3
        base.propagate(0.01, gyro, accel)
        other.propagate(0.01, gyro, accel)
    turn = Rotation.from_matrix(other.rotation @ base.rotation.T)
    error = np.concatenate(
        [
            turn.as_rotvec(),
            other.velocity - turn.apply(base.velocity),
            other.position - turn.apply(base.position),
            other.gyro_bias - base.gyro_bias,
            other.accel_bias - base.accel_bias,
        ]
    )
    np.testing.assert_allclose(np.outer(error, error), base.covariance, atol=2e-3 * np.abs(error).max() ** 2)


def test_the_same_samples_give_the_same_bytes():
    first, second = (reckon(make(0, ALL, 5.0)) for _ in range(2))
    assert first.positions.tobytes() == second.positions.tobytes()
    assert first.covariances.tobytes() == second.covariances.tobytes()
