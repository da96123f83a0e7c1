"""The factors of DVL, depth and compass: zero at the truth, and with the derivatives that they claim."""

from __future__ import annotations

import dataclasses
from typing import Any

import gtsam
import numpy as np
import pytest
from gtsam.symbol_shorthand import B, V, X
from scipy.spatial.transform import Rotation

from oysterbench.core.geometry import Array, invert, transform
from oysterbench.sensors.dvl import DvlRecipe
from oysterbench.sensors.imu import ImuRecipe
from oysterbench_baselines.common.aiding.dvl import (
    DVL_KEY,
    Interval,
    Latency,
    Ping,
    Velocity,
    beam_rows,
    sum_velocities,
    velocity_error,
    velocity_factor,
)
from oysterbench_baselines.common.aiding.instants import History
from oysterbench_baselines.common.aiding.magnetometer import field_error
from oysterbench_baselines.common.aiding.pressure import DEPTH_KEY, depth_error, depth_factor
from oysterbench_baselines.common.inertial import SampleBuffer
from oysterbench_baselines.gtsam_vi.states import State, make_state
from tests.helpers import sensor_dive as dive

GRAVITY = 9.80665
TOLERANCE = 2e-4  # m/s, at 0.5 m/s: what inertial samples of 100 Hz and a lever arm of 12 cm leave
IN_TIME = Latency(0.0, 0.0)
BEGIN_S = 20.0  # of the interval in the dive


def perfect_dive() -> dive.SensorDive:
    """Ten samples a second of a DVL without errors, and an inertial unit without."""
    vehicle = dive.rig("dvl", beam_noise_m_s=0.0, scale_error=0.0, range_noise_share=0.0)
    silent: dict[str, Any] = dict.fromkeys(
        ("gyro_noise_density", "gyro_turn_on", "gyro_bias_instability", "gyro_step"), 0.0
    )
    silent |= dict.fromkeys(("accel_noise_density", "accel_turn_on", "accel_bias_instability", "accel_step"), 0.0)
    unit, log = vehicle.of(ImuRecipe)[0], vehicle.of(DvlRecipe)[0]
    sensors = dataclasses.replace(unit, **silent), dataclasses.replace(log, misalignment_deg=0.0, rate_hz=10.0)
    return dive.SensorDive(0, dataclasses.replace(vehicle, sensors=sensors), dive.survey_path(30.0))


def interval(sequence: dive.SensorDive, seconds: float, first_s: float = 0.05) -> tuple[Interval, State]:
    """The pings from first_s after BEGIN_S on, and the true state at BEGIN_S."""
    begin = dive.START_NS + round(BEGIN_S * 1e9)
    samples, history, pings = SampleBuffer(), History(0.6), []
    for item in sequence.stream("dvl", start_ns=begin - 10**9, end_ns=begin + round(seconds * 1e9) + 1):
        time = (item.stamp_ns - begin) * 1e-9
        if not hasattr(item, "beam_valid"):
            samples.add(item)
            history.add(samples.cut(item.stamp_ns))
            if item.stamp_ns == begin:
                history.mark()
        elif time >= first_s and (rows := beam_rows(item, 0.001)) is not None:
            pings.append(Ping(time, *rows))
    motion = sequence.path.at(np.array([BEGIN_S]))
    T_base_imu = sequence.imu_calibration.T_base_imu
    rotation = motion.rotation[0] @ T_base_imu[:3, :3]
    velocity = motion.velocity[0] + motion.rotation[0] @ np.cross(motion.rate[0], T_base_imu[:3, 3])
    state = make_state(rotation, motion.position[0], velocity, np.zeros(3), np.zeros(3))
    return Interval(history.about_mark(), pings), state


def summed(seconds: float = 0.4, gyro_bias: Array | None = None) -> tuple[Velocity, State]:
    sequence = perfect_dive()
    parts, state = interval(sequence, seconds)
    assert sequence.dvl_calibration is not None
    T_imu_dvl = invert(sequence.imu_calibration.T_base_imu) @ sequence.dvl_calibration.T_base_sensor
    if gyro_bias is not None:
        nav = state.nav
        state = State(nav, gtsam.imuBias.ConstantBias(np.zeros(3), gyro_bias))
    velocity = sum_velocities(parts, IN_TIME, state, GRAVITY, T_imu_dvl)
    assert velocity is not None
    return velocity, state


def test_samples_over_an_interval_say_the_velocity_at_its_beginning():
    velocity, state = summed()
    error, _ = velocity_error(velocity, GRAVITY, state.nav.pose(), state.nav.velocity(), state.bias, np.zeros(4))
    assert error.shape == (3,)
    assert np.abs(error).max() < TOLERANCE  # m/s, at 0.5 m/s
    # Four samples of 1 mm/s per beam; sideways beams see the sine of 22.5 deg.
    expected = 0.001 / np.sqrt(
        4 * 4 * np.array([np.cos(np.radians(22.5)) ** 2] + [np.sin(np.radians(22.5)) ** 2 / 2] * 2)
    )
    np.testing.assert_allclose(np.sort(velocity.sigmas), np.sort(expected), rtol=0.02)


def test_a_changed_gyro_bias_is_made_up_for():
    _, state = summed()
    off, _ = summed(gyro_bias=np.array([2e-3, -1e-3, 3e-3]))
    at = state.nav.pose(), state.nav.velocity(), gtsam.imuBias.ConstantBias(), np.zeros(4)
    error, _ = velocity_error(off, GRAVITY, *at)
    unchanged = dataclasses.replace(off, bias=gtsam.imuBias.ConstantBias())
    assert np.abs(error).max() < TOLERANCE
    assert np.abs(velocity_error(unchanged, GRAVITY, *at)[0]).max() > 5e-4  # what it would be without


def test_two_beams_still_give_two_rows():
    sequence = perfect_dive()
    parts, state = interval(sequence, 0.1)
    (ping,) = parts.pings
    kept = [0, 2]
    lame = dataclasses.replace(
        ping, directions=ping.directions[kept], along=ping.along[kept], variances=ping.variances[kept]
    )
    T_imu_dvl = invert(sequence.imu_calibration.T_base_imu) @ sequence.dvl_calibration.T_base_sensor
    velocity = sum_velocities(dataclasses.replace(parts, pings=[lame]), IN_TIME, state, GRAVITY, T_imu_dvl)
    assert velocity is not None
    error, _ = velocity_error(velocity, GRAVITY, state.nav.pose(), state.nav.velocity(), state.bias, np.zeros(4))
    assert error.shape == (2,)
    assert np.abs(error).max() < TOLERANCE


def test_without_a_lock_there_is_no_factor():
    sequence = perfect_dive()
    deaf = dataclasses.replace(
        next(sequence.dvl()),
        velocity=np.full(3, np.nan),
        covariance=np.full((3, 3), np.nan),
        beam_velocities=np.full(4, np.nan),
        beam_valid=np.zeros(4, dtype=bool),
    )
    assert beam_rows(deaf, 0.001) is None
    parts, state = interval(sequence, 0.1)
    assert sum_velocities(dataclasses.replace(parts, pings=[]), IN_TIME, state, GRAVITY, np.eye(4)) is None


def test_a_ping_from_before_the_key_frame_says_the_velocity_at_it():
    sequence = perfect_dive()
    parts, state = interval(sequence, 0.0, first_s=-0.31)
    assert [round(ping.time_s, 3) for ping in parts.pings] == [-0.3, -0.2, -0.1, 0.0]
    early = dataclasses.replace(parts, pings=parts.pings[:2])
    assert sequence.dvl_calibration is not None
    T_imu_dvl = invert(sequence.imu_calibration.T_base_imu) @ sequence.dvl_calibration.T_base_sensor
    velocity = sum_velocities(early, IN_TIME, state, GRAVITY, T_imu_dvl)
    assert velocity is not None
    error, _ = velocity_error(velocity, GRAVITY, state.nav.pose(), state.nav.velocity(), state.bias, np.zeros(4))
    assert np.abs(error).max() < TOLERANCE


def test_what_is_not_known_of_a_dvls_latency_counts_once_for_all_its_pings():
    """20 ms too much of latency: the error is what its sigma says, however many pings there are."""
    sequence = perfect_dive()
    T_imu_dvl = invert(sequence.imu_calibration.T_base_imu) @ sequence.dvl_calibration.T_base_sensor
    parts, state = interval(sequence, 0.4)
    velocity = sum_velocities(parts, Latency(0.02, 0.02), state, GRAVITY, T_imu_dvl)
    sure = sum_velocities(parts, Latency(0.02, 0.0), state, GRAVITY, T_imu_dvl)
    assert velocity is not None
    assert sure is not None
    at = state.nav.pose(), state.nav.velocity(), state.bias, np.zeros(4)
    worst = [np.abs(velocity_error(v, GRAVITY, *at)[0] / v.sigmas).max() for v in (velocity, sure)]
    assert worst[0] < 1.2
    assert worst[1] > 1.5


def numerical(error, values: list[Any], sizes: list[int], step: float = 1e-6) -> list[Array]:
    """Central differences by retraction of each argument."""
    slopes = []
    for k, size in enumerate(sizes):
        columns = []
        for axis in range(size):
            ends = []
            for sign in (1, -1):
                moved = list(values)
                change = sign * step * np.eye(size)[axis]
                moved[k] = values[k].retract(change) if hasattr(values[k], "retract") else _add(values[k], change)
                ends.append(error(*moved)[0])
            columns.append((ends[0] - ends[1]) / (2 * step))
        slopes.append(np.array(columns).T)
    return slopes


def _add(value, change: Array):
    if isinstance(value, gtsam.imuBias.ConstantBias):
        return gtsam.imuBias.ConstantBias(value.accelerometer() + change[:3], value.gyroscope() + change[3:])
    return value + change


def test_the_velocity_factors_derivatives_are_those_of_its_error():
    velocity, state = summed()
    pose = state.nav.pose().retract(np.array([0.1, -0.2, 0.3, 1.0, 2.0, 3.0]))
    bias = gtsam.imuBias.ConstantBias(np.array([0.1, -0.05, 0.02]), np.array([0.01, 0.02, -0.01]))
    at = [pose, np.array([0.4, -0.2, 0.1]), bias, np.array([0.01, 0.02, -0.01, 0.03])]
    _, slopes = velocity_error(velocity, GRAVITY, *at)
    wanted = numerical(lambda *v: velocity_error(velocity, GRAVITY, *v), at, [6, 3, 6, 4])
    for slope, other in zip(slopes, wanted, strict=True):
        np.testing.assert_allclose(slope, other, atol=1e-7)


def test_the_calibration_of_a_dvl_multiplies_what_it_sees():
    velocity, state = summed()
    sequence = perfect_dive()
    twist, scale = np.array([0.004, -0.003, 0.005]), 0.002
    turn = Rotation.from_rotvec(-twist).as_matrix()

    def twisted(sample):
        seen = (1 + scale) * turn @ sample.velocity
        return dataclasses.replace(sample, velocity=seen, beam_velocities=sample.beam_directions @ seen)

    sequence.change("dvl", twisted)
    parts, _ = interval(sequence, 0.4)
    T_imu_dvl = invert(sequence.imu_calibration.T_base_imu) @ sequence.dvl_calibration.T_base_sensor
    velocity = sum_velocities(parts, IN_TIME, state, GRAVITY, T_imu_dvl)
    at = state.nav.pose(), state.nav.velocity(), state.bias
    known, _ = velocity_error(velocity, GRAVITY, *at, np.concatenate([[scale], twist]))
    unknown, _ = velocity_error(velocity, GRAVITY, *at, np.zeros(4))
    assert np.abs(known).max() < TOLERANCE
    assert np.abs(unknown).max() > 1e-3


def test_the_compass_factors_derivatives_are_those_of_its_error():
    generator = np.random.default_rng(0)
    pose = gtsam.Pose3(transform(Rotation.from_rotvec([0.2, -0.4, 1.0]).as_matrix(), [1, 2, 3]))
    iron = np.concatenate(
        [[1.0, 2.0, -4.5], [0.4, -0.7, 0.2], (np.eye(3) + 0.05 * generator.normal(size=(3, 3))).ravel()]
    )
    mount = Rotation.from_rotvec([0.3, 0.1, -0.2]).as_matrix()
    field = np.array([1.0, -2.0, -4.0])
    _, slopes = field_error(field, mount, pose, iron)
    wanted = numerical(lambda *v: field_error(field, mount, *v), [pose, iron], [6, 15])
    for slope, other in zip(slopes, wanted, strict=True):
        np.testing.assert_allclose(slope, other, atol=1e-8)


def test_the_depth_error_has_the_derivatives_that_it_claims_and_is_zero_at_the_truth():
    pose = gtsam.Pose3(transform(Rotation.from_rotvec([0.4, -0.7, 1.1]).as_matrix(), [3.0, -2.0, -1.5]))
    lever, offset = np.array([0.1, -0.3, 0.2]), np.array([-2.5])
    height = float(pose.transformFrom(lever)[2] + offset[0])
    error, slopes = depth_error(height, lever, pose, offset)
    assert error == pytest.approx(0.0, abs=1e-12)
    wanted = numerical(lambda *v: depth_error(height, lever, *v), [pose, offset], [6, 1])
    for slope, other in zip(slopes, wanted, strict=True):
        np.testing.assert_allclose(slope, other, atol=1e-8)


def test_depths_hold_z_over_their_own_level_and_neither_x_nor_y_however_far_away():
    """Of two key frames: the first is where it is, the second as far below as the readings say."""
    lever, level, noise = np.array([0.1, 0.0, 0.2]), -4.0, gtsam.noiseModel.Isotropic.Sigma
    pose = gtsam.Pose3(transform(np.eye(3), [2000.0, -3000.0, -1.0]))
    values, graph = gtsam.Values(), gtsam.NonlinearFactorGraph()
    for k, z in enumerate((-1.0, -1.5)):
        values.insert(X(k), pose)
        graph.push_back(gtsam.PriorFactorPose3(X(k), pose, noise(6, 1e-4 if k == 0 else 1.0)))
        graph.push_back(depth_factor(k, z + 0.2 + level, lever, 1e-3))
    values.insert(DEPTH_KEY, np.zeros(1))
    graph.push_back(gtsam.PriorFactorVector(DEPTH_KEY, np.zeros(1), noise(1, 10.0)))
    found = gtsam.LevenbergMarquardtOptimizer(graph, values).optimize()
    assert found.atVector(DEPTH_KEY)[0] == pytest.approx(level, abs=1e-4)
    assert found.atPose3(X(1)).transformFrom(lever)[2] == pytest.approx(-1.3, abs=1e-4)
    np.testing.assert_allclose(found.atPose3(X(1)).translation()[:2], [2000.0, -3000.0], atol=0.02)


def test_the_velocity_factor_gives_the_solver_the_same_error():
    velocity, state = summed()
    values = gtsam.Values()
    values.insert(X(3), state.nav.pose())
    values.insert(V(3), state.nav.velocity() + np.array([0.01, 0.0, 0.0]))
    values.insert(B(3), state.bias)
    values.insert(DVL_KEY, np.zeros(4))
    factor = velocity_factor(velocity, 3, GRAVITY, 1e6)
    error, _ = velocity_error(velocity, GRAVITY, state.nav.pose(), values.atVector(V(3)), state.bias, np.zeros(4))
    assert factor.error(values) == pytest.approx(0.5 * np.sum((error / velocity.sigmas) ** 2), rel=1e-6)
