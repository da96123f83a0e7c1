"""What gtsam_full does when its sensors fail, alone and together: it answers every frame, and recovers."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator
from types import MappingProxyType
from typing import Any

import numpy as np
import pytest

from oysterbench.core.geometry import Array
from oysterbench.core.measurements import DvlMeasurement, Image, MagneticMeasurement, PressureMeasurement
from oysterbench.core.trajectory import Trajectory
from oysterbench_baselines.dead_reckoning import DeadReckoning
from oysterbench_baselines.gtsam_full import GtsamFull
from oysterbench_baselines.gtsam_vi.estimator import Estimator
from tests.baselines.test_gtsam_full import ALL, camera, errors, estimate, tracks
from tests.helpers import sensor_dive as dive

NEVER = (np.inf, np.inf)


def make(seed: int, seconds: float, sensors: tuple[str, ...] = ALL) -> dive.SensorDive:
    return dive.SensorDive(seed, dive.rig(*sensors), dive.survey_path(seconds, resting=False, phase=float(seed)))


def during(begin_s: float, end_s: float, how: Callable[[Any], Any]) -> Callable[[Any], Any]:
    """how(sample) from begin_s to end_s, and the sample as it is otherwise."""

    def change(sample: Any) -> Any:
        elapsed = (sample.stamp_ns - dive.START_NS) * 1e-9
        return how(sample) if begin_s <= elapsed < end_s else sample

    return change


def deaf(sample: DvlMeasurement, keep: int = 0) -> DvlMeasurement:
    """Without bottom lock but for the first `keep` beams."""
    valid = np.arange(4) < keep
    return dataclasses.replace(
        sample,
        velocity=np.full(3, np.nan),
        covariance=np.full((3, 3), np.nan),
        beam_velocities=np.where(valid, sample.beam_velocities, np.nan),
        beam_ranges=np.where(valid, sample.beam_ranges, np.nan),
        beam_valid=valid,
    )


def off_m(sequence: dive.SensorDive, trajectory: Trajectory) -> Array:
    """(N,) error of position, m."""
    return np.linalg.norm(errors(sequence, trajectory)[:, :3], axis=1)


def answered(sequence: dive.SensorDive, trajectory: Trajectory) -> bool:
    """Every frame has a pose and a covariance."""
    assert trajectory.covariances is not None
    finite = np.isfinite(trajectory.positions).all() and np.isfinite(trajectory.covariances).all()
    return len(trajectory) == round(10 * sequence.duration_s) and bool(finite)


@pytest.fixture(scope="module")
def dark_dive() -> tuple[dive.SensorDive, Estimator]:
    """150 s, of which the camera sees nothing from 15 s to 135 s."""
    sequence = make(1, 150.0)
    return sequence, estimate(sequence, tracks(sequence, 1, (15.0, 135.0)))


@pytest.mark.slow  # a minute is bridged in test_gtsam_full
def test_two_minutes_in_the_dark_drift_as_a_dvl_does_and_pictures_are_taken_up_again(dark_dive):
    sequence, estimator = dark_dive
    trajectory = estimator.online()
    assert answered(sequence, trajectory)
    assert off_m(sequence, trajectory).max() < 0.005 * sequence.truth().path_length
    assert "restarts" not in estimator.info
    assert len(estimator.window._landmarks) > 30


@pytest.mark.slow
def test_the_smoothed_path_bridges_them_as_well(dark_dive):
    sequence, estimator = dark_dive
    trajectory = estimator.smoothed()
    assert answered(sequence, trajectory)
    assert off_m(sequence, trajectory).max() < 0.005 * sequence.truth().path_length


@pytest.mark.slow
@pytest.mark.parametrize("keep", [0, 2])
def test_pictures_carry_it_while_the_dvl_has_lost_the_bottom(keep):
    """Ten seconds. The inertial unit alone would be a metre off; two beams of four leave one direction to it."""
    sequence = make(2, 20.0)
    sequence.change("dvl", during(8.0, 18.0, lambda sample: deaf(sample, keep)))
    estimator = estimate(sequence, tracks(sequence, 2, NEVER))
    trajectory = estimator.online()
    assert answered(sequence, trajectory)
    assert off_m(sequence, trajectory).max() < 0.01 * sequence.truth().path_length
    assert "restarts" not in estimator.info


@pytest.mark.slow
def test_ranges_count_only_where_the_dvl_gives_no_velocity():
    """From 6 s to 10 s it measures how far the bottom is, and not how fast it passes."""
    sequence = make(2, 12.0)

    def mute(sample: DvlMeasurement) -> DvlMeasurement:
        nothing = np.full(4, np.nan)
        return dataclasses.replace(sample, velocity=nothing[:3], beam_velocities=nothing)

    sequence.change("dvl", during(6.0, 10.0, mute))
    estimator = estimate(sequence, tracks(sequence, 2, NEVER))
    stamps = [
        estimator.keyframes[k].stamp_ns for k, echoes in estimator.aiding.sensors["ranges"].echoes.items() if echoes
    ]
    elapsed = (np.array(stamps) - dive.START_NS) * 1e-9
    assert len(elapsed) > 3
    assert elapsed.min() > 6.5
    assert elapsed.max() < 10.5


@pytest.mark.slow
def test_neither_pictures_nor_a_dvl_for_five_seconds_leave_it_unsure_and_not_lost():
    sequence = make(3, 18.0)
    sequence.change("dvl", during(8.0, 13.0, deaf))
    trajectory = estimate(sequence, tracks(sequence, 3, (8.0, 13.0))).online()
    assert answered(sequence, trajectory)
    sigma = np.sqrt(trajectory.covariances[:, 0, 0] + trajectory.covariances[:, 1, 1])
    assert sigma[128] > 3 * sigma[78]
    off = errors(sequence, trajectory)[:, :3]
    assert np.all(np.linalg.norm(off[:, :2], axis=1) < 5 * sigma + 1e-3)
    assert np.linalg.norm(off[-1] - off[145]) < 0.05  # what is lost is lost, and no more


@pytest.mark.slow
def test_a_picture_that_stands_still_is_no_rest_while_the_vehicle_is_known_to_move():
    """A veil, or spots on the port: from 6 s to 12 s forty points stay where they are in the picture."""
    sequence, generator = make(6, 16.0), np.random.default_rng(6)
    pixels = generator.uniform([40, 40], [600, 440], size=(40, 2))
    frames = tracks(sequence, 6, (6.0, 12.0))
    for n, (stamp, ids, _) in enumerate(frames):
        if not len(ids) and 6.0 <= (stamp - dive.START_NS) * 1e-9 < 12.0:
            frames[n] = stamp, np.arange(40) + 10**6, pixels + generator.normal(0, 0.1, pixels.shape)
    estimator = estimate(sequence, frames)
    assert answered(sequence, estimator.online())
    for trajectory in estimator.paths().values():
        assert off_m(sequence, trajectory).max() < 0.01 * sequence.truth().path_length


@pytest.mark.slow
def test_spikes_of_pressure_and_a_wreck_beside_the_compass_are_refused():
    generator = np.random.default_rng(0)
    sequence = make(4, 16.0)

    def spike(sample: PressureMeasurement) -> PressureMeasurement:
        if generator.random() > 0.05:
            return sample
        return dataclasses.replace(sample, pressure=sample.pressure + generator.choice([-1, 1]) * 2e4)  # 2 m

    def iron(sample: MagneticMeasurement) -> MagneticMeasurement:
        return dataclasses.replace(sample, field=sample.field + np.array([20e-6, -15e-6, 5e-6]))

    sequence.change("pressure", spike)
    sequence.change("magnetometer", during(8.0, 8.4, iron))
    estimator = estimate(sequence, tracks(sequence, 4, NEVER))
    trajectory = estimator.online()
    assert estimator.info["refused_pressure"] > 5
    assert estimator.info["refused_magnetometer"] > 1
    assert answered(sequence, trajectory)
    error = errors(sequence, trajectory)
    assert np.abs(error[:, 2]).max() < 0.05
    assert np.abs(error[:, 5]).max() < np.radians(2)


class Filmed(dive.SensorDive):
    """A dive with a camera, which takes black pictures for `seconds`, and none afterwards."""

    seconds = 3.0

    def __init__(self, seed: int, seconds: float) -> None:
        super().__init__(seed, dive.rig(*ALL), dive.survey_path(seconds, resting=False))
        self.cameras = MappingProxyType({"cam": dataclasses.replace(camera(), width=160, height=120)})

    def images(self, camera: str, start_ns: int | None = None, end_ns: int | None = None) -> Iterator[Image]:
        for k in range(round(10 * self.seconds)):
            yield Image(dive.START_NS + k * 10**8, camera, np.zeros((120, 160, 3), dtype=np.uint8))


def test_black_pictures_and_then_none_at_all_leave_a_pose_for_every_frame_that_should_be():
    sequence = Filmed(5, 8.0)
    result = GtsamFull(output="online").run(sequence.for_method())
    trajectory = result.trajectory
    steps = np.diff(trajectory.stamps_ns) * 1e-9
    assert trajectory.stamps_ns[0] == dive.START_NS
    assert steps.max() <= 0.2
    assert trajectory.stamps_ns[-1] >= dive.START_NS + round(7.9e9)
    # It errs as dead reckoning does, which is what it is then, and knows it.
    reckoned = DeadReckoning().run(sequence.for_method()).trajectory.at(trajectory.stamps_ns)
    assert off_m(sequence, trajectory).max() < 1.2 * off_m(sequence, reckoned).max()
    sigma = np.sqrt(np.trace(trajectory.covariances[:, :3, :3], axis1=1, axis2=2))
    assert np.all(off_m(sequence, trajectory) < 3 * sigma + 1e-3)


def test_the_same_samples_and_seed_give_the_same_bytes():
    first, second = (GtsamFull(seed=7).run(Filmed(5, 4.0).for_method()).trajectory for _ in range(2))
    assert first.positions.tobytes() == second.positions.tobytes()
    assert first.covariances.tobytes() == second.covariances.tobytes()
    assert GtsamFull().seed == 0
