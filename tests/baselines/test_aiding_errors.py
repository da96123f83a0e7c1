"""What the aiding promises of units that warm, of compasses beside motors, and of what a calibration states."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from oysterbench.sensors.dvl import DvlRecipe
from oysterbench.sensors.magnetometer import HARD_IRON, SOFT_IRON
from oysterbench.sensors.uncertainty import Uncertainty, axes
from oysterbench_baselines.common.aiding.dvl import Dvl, DvlSettings
from oysterbench_baselines.common.aiding.magnetometer import MagnetometerSettings, known_iron
from oysterbench_baselines.common.aiding.sensor import GateSettings, stated_sigmas
from oysterbench_baselines.dead_reckoning import DeadReckoning
from tests.helpers import sensor_dive as dive

ALL = ("dvl", "pressure", "magnetometer")


def turned(sequence: dive.SensorDive) -> tuple[np.ndarray, np.ndarray]:
    """(N, 3) rad by which the attitude of dead reckoning errs, about odom's axes, and its 1 sigmas."""
    trajectory = DeadReckoning().run(sequence.for_method()).trajectory
    truth = sequence.truth_from_start()
    error = Rotation.from_quat(truth.quaternions) * Rotation.from_quat(trajectory.quaternions).inv()
    assert trajectory.covariances is not None
    return error.as_rotvec(), np.sqrt(np.diagonal(trajectory.covariances[:, 3:, 3:], axis1=1, axis2=2))


def elapsed_s(sample) -> float:
    return (sample.stamp_ns - dive.START_NS) * 1e-9


@pytest.mark.slow
def test_a_gyroscope_that_warms_turns_the_vehicle_by_no_more_than_is_said():
    sequence = dive.SensorDive(0, dive.rig(*ALL), dive.survey_path(40.0))
    drift = np.array([6e-5, -6e-5, 8e-5])  # rad/s^2: 9e-4 rad/s per K, 0.1 K/s
    sequence.change("imu", lambda s: dataclasses.replace(s, gyro=s.gyro + drift * elapsed_s(s)))
    error, sigma = turned(sequence)
    assert np.all(np.abs(error) < 4 * sigma + 1e-4)
    assert np.abs(error[-1, 2]) < np.radians(2.7) < 0.8 * 0.5 * drift[2] * 40.0**2


@pytest.mark.slow
def test_a_compass_counts_for_less_beside_motors_that_come_and_go():
    calm, bent = (dive.SensorDive(0, dive.rig(*ALL), dive.survey_path(40.0)) for _ in range(2))

    def motors(sample):
        share = 0.5 + 0.5 * np.sin(2 * np.pi * elapsed_s(sample) / 7.0)
        return dataclasses.replace(sample, field=sample.field + share * np.array([2e-6, 3e-6, 0.0]))

    bent.change("magnetometer", motors)
    (_, calm_sigma), (error, sigma) = turned(calm), turned(bent)
    assert np.all(np.abs(error[:, 2]) < 4 * sigma[:, 2] + 1e-4)
    assert sigma[-1, 2] > 1.15 * calm_sigma[-1, 2]


def stated(scale: float, mount_rad: float, hard_t: float, soft: float) -> Uncertainty:
    sigmas = {"dvl.scale": scale}
    for sensor in ("dvl", "magnetometer"):
        sigmas |= {f"{sensor}.{name}": mount_rad for name in axes("rotation", "rad")}
    sigmas |= {f"magnetometer.{name}": hard_t for name in HARD_IRON}
    sigmas |= {f"magnetometer.{name}": soft for name in SOFT_IRON}
    return Uncertainty(tuple(sigmas), np.diag(np.square(list(sigmas.values()))))


def test_what_a_calibration_states_of_a_dvl_is_its_prior_beside_what_the_maker_does():
    settings = DvlSettings(scale_sigma=0.01, misalignment_sigma_deg=0.5)
    bare, told = (
        Dvl(np.eye(4), 9.8, settings, GateSettings(), uncertainty).calibration().sigmas
        for uncertainty in (None, stated(0.02, np.radians(1.0), 0.0, 0.0))
    )
    np.testing.assert_allclose(bare, [0.01, *np.radians([0.5] * 3)])
    np.testing.assert_allclose(told, [np.hypot(0.01, 0.02), *np.radians([np.hypot(0.5, 1.0)] * 3)])


def test_iron_is_that_of_the_swing_where_there_was_one():
    settings = MagnetometerSettings(mean_motor_sigma=0.0)
    swung = np.array([4e-6, -7e-6, 2e-6]), np.eye(3) * 1.02
    hard, soft, sigmas = known_iron(swung, settings, stated(0.0, 0.01, 2e-6, 0.02))
    np.testing.assert_array_equal(hard, swung[0])
    np.testing.assert_array_equal(soft, swung[1])
    np.testing.assert_allclose(sigmas[3:6], 2e-6)
    wanted = np.full((3, 3), np.hypot(0.02, 0.01))
    np.fill_diagonal(wanted, 0.02)
    np.testing.assert_allclose(sigmas[6:].reshape(3, 3), wanted)
    hard, soft, sigmas = known_iron(None, settings, None)
    assert not hard.any()
    assert sigmas[3] == settings.hard_iron_sigma


def test_a_parameter_that_a_calibration_does_not_name_is_missed():
    assert not stated_sigmas(None, "dvl", ("scale",)).any()
    with pytest.raises(KeyError, match=r"dvl\.colour"):
        stated_sigmas(stated(0.01, 0.01, 0.0, 0.0), "dvl", ("colour",))


@pytest.mark.slow
def test_scale_and_mount_that_a_calibration_missed_are_found_from_the_motion():
    """A log that is 2 % too fast, of a vehicle that heaves: depth knows a metre."""
    vehicle, path = dive.rig(*ALL, scale_error=0.0), dive.survey_path(60.0)
    assert vehicle.of(DvlRecipe)
    sequence = dive.SensorDive(3, vehicle, path)
    sequence.change("dvl", lambda s: dataclasses.replace(s, beam_velocities=1.02 * s.beam_velocities))
    info = DeadReckoning().run(sequence.for_method()).info
    assert info["dvl_scale"] == pytest.approx(1.02, abs=0.008)
