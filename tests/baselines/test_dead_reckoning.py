"""What inertial dead reckoning promises."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest

from oysterbench.core.errors import MethodError
from oysterbench.core.geometry import align_yaw
from oysterbench.core.measurements import Image
from oysterbench.core.trajectory import Trajectory
from oysterbench.sequence.types import ImuMeasurement, Sequence
from oysterbench_baselines.dead_reckoning import DeadReckoning
from tests.helpers import synthetic_dive as dive


class InertialOnly(Sequence):
    """A sequence of inertial samples."""

    name = "inertial"

    def __init__(self, measurements: list[ImuMeasurement]) -> None:
        self.cameras = {}
        self.imu_calibration = dive.imu_calibration()
        self.metadata = {}
        self._measurements = measurements

    def images(self, camera: str, start_ns: int | None = None, end_ns: int | None = None) -> Iterator[Image]:
        return iter(())

    def imu(self, start_ns: int | None = None, end_ns: int | None = None) -> Iterator[ImuMeasurement]:
        return iter(self._measurements)

    @property
    def duration_s(self) -> float:
        return (self._measurements[-1].stamp_ns - self._measurements[0].stamp_ns) * 1e-9

    def contents(self) -> list[tuple[str, str, int]]:
        return []

    def truth(self) -> Trajectory:
        raise AssertionError("a method asked for the truth")


def measurements(noisy: bool, pose=dive.resting_start_pose, duration_s: float = 15.0) -> list[ImuMeasurement]:
    generator = np.random.default_rng(0) if noisy else None
    return dive.inertial_samples(pose, dive.imu_calibration(), duration_s, generator)


def error(trajectory: Trajectory, pose=dive.resting_start_pose) -> float:
    truth = pose((trajectory.stamps_ns - dive.START_NS) * 1e-9)[:, :3, 3]
    aligned = align_yaw(truth, trajectory.positions).apply(trajectory.positions)
    return float(np.sqrt(np.mean(np.sum((aligned - truth) ** 2, axis=1))))


def test_a_perfect_unit_that_starts_at_rest_is_followed_to_centimetres():
    result = DeadReckoning().run(InertialOnly(measurements(noisy=False)))
    assert result.info["started_at_rest"] is True
    assert error(result.trajectory) < 0.03


def test_a_real_unit_drifts_by_metres_and_nothing_breaks():
    result = DeadReckoning().run(InertialOnly(measurements(noisy=True)))
    assert 0.05 < error(result.trajectory) < 20.0


def test_the_gyro_bias_is_taken_from_rest_and_not_from_motion():
    resting, moving = (
        DeadReckoning().run(InertialOnly(measurements(True, pose))).info["started_at_rest"]
        for pose in (dive.resting_start_pose, dive.survey_pose)
    )
    assert resting
    assert not moving


def test_up_is_up_from_the_start():
    trajectory = DeadReckoning().run(InertialOnly(measurements(noisy=False))).trajectory
    truth = dive.resting_start_pose(np.zeros(1))[0]
    assert trajectory.matrices[0, 2, :3] @ truth[2, :3] > np.cos(np.radians(0.1))


def test_the_path_starts_at_the_origin_of_odom():
    trajectory = DeadReckoning().run(InertialOnly(measurements(noisy=True))).trajectory
    np.testing.assert_array_equal(trajectory.positions[0], 0.0)


def test_a_sequence_without_inertial_samples_is_refused():
    with pytest.raises(MethodError, match="expected inertial samples"):
        DeadReckoning().run(InertialOnly([]))
