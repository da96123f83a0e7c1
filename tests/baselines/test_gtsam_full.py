"""What the fully aided baseline promises, without pictures: tracks of points, and the scalar sensors' own samples."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from oysterbench.core.errors import MethodError
from oysterbench.core.geometry import Array, align_yaw
from oysterbench.core.measurements import ImuMeasurement
from oysterbench.core.trajectory import Trajectory
from oysterbench.sequence.types import CameraCalibration, Sequence
from oysterbench_baselines.common.aiding.magnetometer import COMPASS_KEY, FIELD_UNIT
from oysterbench_baselines.common.aiding.pressure import DEPTH_KEY
from oysterbench_baselines.common.inertial import SampleBuffer
from oysterbench_baselines.gtsam_full import GtsamFull, GtsamFullSettings
from oysterbench_baselines.gtsam_full.method import aided_estimator
from oysterbench_baselines.gtsam_full.settings import BesideDvlSettings
from oysterbench_baselines.gtsam_vi.estimator import Estimator
from oysterbench_baselines.gtsam_vi.frontend import FeatureTracks, undistort
from oysterbench_baselines.gtsam_vi.settings import GtsamViSettings
from tests.helpers import sensor_dive as dive
from tests.helpers import synthetic_dive


def camera() -> CameraCalibration:
    return dataclasses.replace(synthetic_dive.camera_calibration(), rate_hz=10.0)


def tracks(sequence: dive.SensorDive, seed: int, blind: tuple[float, float]) -> list[tuple[int, np.ndarray, Array]]:
    """Stamp, ids and pixels of the points of the bottom that are tracked in each frame; none in the seconds `blind`."""
    generator = np.random.default_rng(seed)
    times = np.arange(0, sequence.duration_s, 1 / camera().rate_hz)
    motion = sequence.path.at(times)
    poses = np.tile(np.eye(4), (len(times), 1, 1))
    poses[:, :3, :3], poses[:, :3, 3] = motion.rotation, motion.position
    points = generator.uniform([-13, -7, 0], [13, 7, 1], size=(9000, 3))
    points[:, 2] = -dive.BOTTOM_M + 0.15 * np.sin(1.3 * points[:, 0]) + 0.12 * points[:, 2] ** 2
    found = synthetic_dive._track(points, poses, times, camera(), 0.4, blind, 0.01, generator, 100)
    stamps = dive.START_NS + np.round(times * 1e9).astype(np.int64)
    return [(int(stamp), *row) for stamp, row in zip(stamps, found, strict=True)]


def first_moments(sequence: Sequence) -> tuple[np.ndarray, Array, Array]:
    """Stamps (N,), gyro and accel (N, 3) of the first second."""
    samples = [sample for sample in sequence.imu() if sample.stamp_ns <= dive.START_NS + 10**9]
    stamps = np.array([sample.stamp_ns for sample in samples], dtype=np.int64)
    return stamps, np.array([sample.gyro for sample in samples]), np.array([sample.accel for sample in samples])


def estimate(sequence: Sequence, frames: list[Any], settings: GtsamFullSettings | None = None) -> Estimator:
    """Everything behind the front end."""
    estimator = aided_estimator(sequence, camera(), settings or GtsamFullSettings(), first_moments(sequence))
    kinds = [kind for kind in ("dvl", "pressure", "magnetometer") if getattr(sequence, f"{kind}_calibration")]
    samples = SampleBuffer()
    waiting = iter(frames)
    frame = next(waiting, None)
    for item in sequence.stream(*(kinds or ["imu"])):
        while frame is not None and frame[0] < item.stamp_ns:
            see(estimator, samples, frame)
            frame = next(waiting, None)
        if isinstance(item, ImuMeasurement):
            samples.add(item)
            continue
        estimator.propagate(samples.cut(item.stamp_ns))
        estimator.update(item)
    estimator.finish()
    return estimator


def see(estimator: Estimator, samples: SampleBuffer, frame) -> None:
    stamp, ids, pixels = frame
    estimator.propagate(samples.cut(stamp))
    estimator.step(stamp, FeatureTracks(ids, pixels, undistort(pixels, camera())))


def errors(sequence: dive.SensorDive, trajectory: Trajectory) -> Array:
    """(N, 6) true minus estimated position (m) and rotation (rad) in odom, whose origin and yaw are the start's."""
    truth = sequence.truth_from_start().at(trajectory.stamps_ns)
    turn = Rotation.from_quat(truth.quaternions) * Rotation.from_quat(trajectory.quaternions).inv()
    return np.column_stack([truth.positions - trajectory.positions, turn.as_rotvec()])


def nees(sequence: dive.SensorDive, trajectory: Trajectory) -> Array:
    error = errors(sequence, trajectory)
    assert trajectory.covariances is not None
    return np.einsum("ni,ni->n", error, np.linalg.solve(trajectory.covariances, error[:, :, None])[..., 0])


ALL = ("dvl", "pressure", "magnetometer")


@pytest.mark.slow
def test_a_minute_without_pictures_is_bridged_and_pictures_are_taken_up_again():
    sequence = dive.SensorDive(1, dive.rig("dvl", "pressure"), dive.survey_path(90.0, resting=False))
    estimator = estimate(sequence, tracks(sequence, 1, (15.0, 75.0)))
    trajectory = estimator.online()
    assert "restarts" not in estimator.info
    assert all(k.measured and not k.blind for k in estimator.keyframes[20:]), "by the DVL, in the dark too"
    assert len(trajectory) == 900
    error = np.linalg.norm(errors(sequence, trajectory)[:, :3], axis=1)
    path = sequence.truth().path_length
    assert error.max() < 0.01 * path
    # The pictures are used again: the window has landmarks that it sees.
    assert len(estimator.window._landmarks) > 30
    # And in the dark the estimate knows that its heading gets lost.
    heading = np.sqrt(trajectory.covariances[:, 5, 5])
    assert heading[740] > 2 * heading[140]


@pytest.mark.slow
def test_in_the_dark_from_the_first_frame_to_the_last_it_still_answers_every_frame():
    sequence = dive.SensorDive(2, dive.rig(*ALL), dive.survey_path(40.0, resting=False))
    estimator = estimate(sequence, tracks(sequence, 2, (-1.0, 99.0)))
    trajectory = estimator.online()
    assert len(trajectory) == 400
    assert np.linalg.norm(errors(sequence, trajectory)[:, :3], axis=1).max() < 0.01 * sequence.truth().path_length
    assert estimator.info["initialised"] == 1


def test_a_dive_too_short_for_a_window_keeps_the_path_of_its_dvl():
    sequence = dive.SensorDive(1, dive.rig("dvl", "pressure"), dive.survey_path(3.5, resting=False))
    estimator = estimate(sequence, tracks(sequence, 1, (np.inf, np.inf)))
    assert estimator.window is None
    for trajectory in estimator.paths().values():
        assert np.linalg.norm(errors(sequence, trajectory)[:, :3], axis=1).max() < 0.02 * sequence.truth().path_length


@pytest.mark.slow
def test_errors_are_as_large_as_the_covariances_say():
    """Not overconfident, which is what costs a user his vehicle; what it is too modest by comes from pixel_sigma_px,
    which stands for a real tracker's drift and not for the 0.4 px of these tracks."""
    values = []
    for seed in range(4):
        sequence = dive.SensorDive(seed, dive.rig(*ALL), dive.survey_path(15.0, seed % 2 == 0, phase=float(seed)))
        trajectory = estimate(sequence, tracks(sequence, seed, (np.inf, np.inf))).online()
        values.append(nees(sequence, trajectory)[[50, 100, -1]])
    high = chi2.ppf(0.9995, 6 * len(values)) / len(values)
    assert np.all(np.mean(values, axis=0) < high)
    assert np.all(np.mean(values, axis=0) > 0.6)


def test_the_smoothed_path_is_the_better_one_and_has_covariances_too():
    sequence = dive.SensorDive(1, dive.rig(*ALL), dive.survey_path(20.0, resting=False))
    estimator = estimate(sequence, tracks(sequence, 1, (np.inf, np.inf)))
    online, smoothed = estimator.online(), estimator.smoothed()
    rmse = [float(np.sqrt(np.mean(errors(sequence, t)[:, :3] ** 2))) for t in (online, smoothed)]
    assert rmse[1] < 1.05 * rmse[0]
    assert smoothed.covariances is not None
    assert 0.3 < np.mean(nees(sequence, smoothed)) < 15


@pytest.mark.slow
def test_a_rig_with_depth_and_no_dvl_starts_from_pictures_and_keeps_its_height():
    sequence = dive.SensorDive(3, dive.rig("pressure"), dive.survey_path(20.0, resting=False))
    estimator = estimate(sequence, tracks(sequence, 3, (np.inf, np.inf)))
    trajectory = estimator.online()
    assert estimator.info["initialised"] == 1
    assert estimator.info["init_s"] < 6.0  # with corners that count as little as beside a DVL: 7.4 s
    assert "restarts" not in estimator.info
    assert len(trajectory) == 200
    height = trajectory.positions[100:, 2] - sequence.truth().at(trajectory.stamps_ns).positions[100:, 2]
    assert np.ptp(height) < 0.05


@pytest.mark.slow
def test_without_a_dvl_the_window_has_the_compass_that_the_filter_has():
    sequence = dive.SensorDive(0, dive.rig("pressure", "magnetometer"), dive.survey_path(20.0, resting=False))
    estimator = estimate(sequence, tracks(sequence, 0, (np.inf, np.inf)))
    assert {COMPASS_KEY, DEPTH_KEY} <= {calibration.key for calibration in estimator.aiding.calibrations()}
    assert "restarts" not in estimator.info
    _, joint = estimator.window.joint([COMPASS_KEY])
    # What is fixed in odom is known better than before it was looked at from several headings.
    prior = GtsamFullSettings().aiding.magnetometer.field_sigma / FIELD_UNIT
    assert (np.sqrt(np.diag(joint)[:2]) < 0.5 * prior).all()
    trajectory = estimator.smoothed()
    truth = sequence.truth().at(trajectory.stamps_ns)
    aligned = align_yaw(truth.positions, trajectory.positions).apply(trajectory.positions)
    assert np.linalg.norm(aligned - truth.positions, axis=1).max() < 0.005 * truth.path_length


@pytest.mark.slow
def test_it_finds_back_to_the_true_motion_after_the_inertial_unit_has_lied():
    sequence = dive.SensorDive(4, dive.rig(*ALL), dive.survey_path(30.0, resting=False))

    def lie(sample):
        if not 12.0 < (sample.stamp_ns - dive.START_NS) * 1e-9 < 12.7:
            return sample
        return ImuMeasurement(sample.stamp_ns, sample.gyro, sample.accel + np.array([15.0, 0, 0]))

    sequence.change("imu", lie)
    estimator = estimate(sequence, tracks(sequence, 4, (np.inf, np.inf)))
    trajectory = estimator.online()
    assert np.isfinite(trajectory.positions).all()
    error = errors(sequence, trajectory)[:, :3]
    # What happened meanwhile is lost; what comes after is not.
    assert np.linalg.norm(error[160:] - error[160], axis=1).max() < 0.2


@pytest.mark.slow
def test_a_dvl_that_never_locks_leaves_the_start_to_the_pictures():
    sequence = dive.SensorDive(3, dive.rig("dvl", "pressure", max_range_m=1.0), dive.survey_path(15.0, resting=False))
    estimator = estimate(sequence, tracks(sequence, 3, (np.inf, np.inf)))
    trajectory = estimator.online()
    assert estimator.info["initialised"] == 1
    assert len(trajectory) == 150
    truth = sequence.truth().at(trajectory.stamps_ns)
    aligned = align_yaw(truth.positions, trajectory.positions).apply(trajectory.positions)
    error = np.linalg.norm(aligned - truth.positions, axis=1)
    assert np.sqrt(np.mean(error**2)) < 0.02 * truth.path_length


def test_an_unknown_camera_and_an_unknown_output_are_refused():
    sequence = dive.SensorDive(0, dive.rig("dvl"), dive.survey_path(1.0))
    with pytest.raises(MethodError, match="has no camera 'left'; cameras: none"):
        GtsamFull(camera="left").run(sequence.for_method())
    with pytest.raises(
        MethodError, match="has no camera, whose frame rate it needs even without images; run dead_reck"
    ):
        GtsamFull(settings=GtsamFullSettings(pictures=False)).run(sequence.for_method())
    with pytest.raises(MethodError, match="'smoothed' or 'online'"):
        GtsamFull(output="best")


def test_sensors_that_are_left_out_are_not_stated():
    assert GtsamFull().about["sensors"] == ["mono", "imu", "dvl", "sonar", "pressure", "compass", "altimeter"]
    unaided = GtsamFullSettings(dvl=False, sonar=False, pictures=False)
    assert GtsamFull(settings=unaided).about["sensors"] == ["imu", "pressure", "compass", "altimeter"]


def test_sensors_can_be_left_out():
    sequence = dive.SensorDive(2, dive.rig(*ALL), dive.survey_path(4.0))
    assert GtsamFullSettings().sensors(sequence) == ["dvl", "pressure", "magnetometer"]
    assert GtsamFullSettings(dvl=False, compass=False).sensors(sequence) == ["pressure"]
    aided, unaided = (
        aided_estimator(sequence, camera(), GtsamFullSettings(dvl=dvl), first_moments(sequence))
        for dvl in (True, False)
    )
    assert ("dvl" in aided.aiding.sensors, "dvl" in unaided.aiding.sensors) == (True, False)
    # Corners are all that is left then, and count as they do for those who have nothing else.
    for name, beside in dataclasses.asdict(BesideDvlSettings()).items():
        part = "landmarks" if name == "max_innovation_px" else "noise"
        assert getattr(getattr(aided.settings, part), name) == beside
        assert (
            getattr(getattr(unaided.settings, part), name) == getattr(getattr(GtsamViSettings(), part), name) != beside
        )
