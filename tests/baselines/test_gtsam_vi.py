"""What the visual-inertial baseline promises, without images where it can be, on rendered ones where it must."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import cv2
import gtsam
import numpy as np
import pytest
from gtsam.symbol_shorthand import B
from scipy.spatial.transform import Rotation

from oysterbench.core.errors import MethodError
from oysterbench.core.geometry import Array, align_yaw, invert
from oysterbench.core.measurements import Image
from oysterbench.core.trajectory import Trajectory, read_trajectory
from oysterbench.evaluate.slam.scoring import score
from oysterbench.methods import Health
from oysterbench.methods.options import configure
from oysterbench.sequence.euroc import EurocSequence
from oysterbench.sequence.types import ImuMeasurement, Sequence
from oysterbench_baselines.common.inertial import SampleBuffer
from oysterbench_baselines.gtsam_vi import GtsamVi, GtsamViSettings, initialisation
from oysterbench_baselines.gtsam_vi.estimator import Estimator
from oysterbench_baselines.gtsam_vi.frontend import FeatureTracks, undistort
from oysterbench_baselines.gtsam_vi.settings import InitialisationSettings
from tests.helpers import synthetic_dive as dive
from tests.helpers.paths import SHARED_DATA


def estimate(measured: dive.Dive, settings: GtsamViSettings | None = None) -> Estimator:
    """Everything behind the front end, run on a dive."""
    estimator = Estimator([measured.camera], measured.inertial, settings or GtsamViSettings())
    samples = SampleBuffer()
    for item in measured.stream():
        if isinstance(item, ImuMeasurement):
            samples.add(item)
            continue
        stamp, ids, pixels = item
        estimator.propagate(samples.cut(stamp))
        estimator.step(stamp, FeatureTracks(ids, pixels, undistort(pixels, measured.camera)))
    estimator.finish()
    return estimator


def position_error(truth: Trajectory, trajectory: Trajectory) -> float:
    """RMSE (m) after alignment in yaw and translation; never in scale."""
    known = truth.at(trajectory.stamps_ns)
    aligned = align_yaw(known.positions, trajectory.positions).apply(trajectory.positions)
    return float(np.sqrt(np.mean(np.sum((aligned - known.positions) ** 2, axis=1))))


def tilt_error(truth: Trajectory, trajectory: Trajectory) -> float:
    """Largest angle (rad) between the two ideas of up."""
    up = np.einsum("ni,ni->n", truth.matrices[:, 2, :3], trajectory.matrices[:, 2, :3])
    return float(np.arccos(np.clip(up, -1, 1)).max())


@pytest.mark.parametrize("seed", [0, *(pytest.param(seed, marks=pytest.mark.slow) for seed in (1, 2, 3))])
def test_it_recovers_a_dive_that_is_in_motion_from_its_first_frame(seed):
    measured = dive.make_dive(seed)
    estimator = estimate(measured)
    for trajectory in (estimator.online(), estimator.smoothed()):
        assert list(trajectory.stamps_ns) == list(measured.stamps_ns)
        assert position_error(measured.truth, trajectory) < 0.003 * measured.truth.path_length
        assert tilt_error(measured.truth, trajectory) < np.radians(1.0)
    assert estimator.info["init_s"] < 6.0


def test_it_recovers_a_dive_that_starts_at_rest():
    measured = dive.make_dive(5, pose=dive.resting_start_pose)
    estimator = estimate(measured)
    assert position_error(measured.truth, estimator.smoothed()) < 0.003 * measured.truth.path_length


@pytest.mark.slow
@pytest.mark.parametrize("seed", [7, 11])  # two of six among the seeds 5 to 16; the others are not rescued
def test_silt_at_the_beginning_that_drifts_as_one_is_left_out_of_the_start(seed):
    measured = dive.make_dive(seed, duration_s=12.0, silt_s=4.0)
    estimator = estimate(measured)
    trajectory = estimator.smoothed()
    assert (
        position_error(measured.truth, trajectory) < 0.03
    )  # of 6 m; with what the silt showed it is four times as much
    # What it had no sight of it has from the inertial unit, back from the start, and knows how well.
    health = estimator.health()
    assert (health[:70] == Health.COASTING).all()
    assert (health[-60:] == Health.TRACKING).all()
    assert score(measured.truth, trajectory).metrics["nees_position"] < 10.0


def test_it_holds_its_place_when_nothing_moves():
    measured = dive.make_dive(1, duration_s=8.0, pose=lambda t: dive.survey_pose(0 * t))
    trajectory = estimate(measured).smoothed()
    assert len(trajectory) == len(measured.stamps_ns)
    assert np.abs(trajectory.positions - trajectory.positions[0]).max() < 0.05


@pytest.mark.slow
def test_it_carries_on_when_it_sees_nothing_for_three_seconds():
    measured = dive.make_dive(2, blind=(9.0, 12.0))
    estimator = estimate(measured)
    assert "restarts" not in estimator.info
    assert position_error(measured.truth, estimator.online()) < 0.01 * measured.truth.path_length
    assert position_error(measured.truth, estimator.smoothed()) < 0.005 * measured.truth.path_length


def test_few_noisy_and_false_tracks_do_not_lead_it_astray():
    measured = dive.make_dive(3, most=30, pixel_noise=0.8, outliers=0.1)
    assert position_error(measured.truth, estimate(measured).smoothed()) < 0.005 * measured.truth.path_length


def lie(measured: dive.Dive) -> None:
    """The inertial unit is wrong from 8.0 to 8.7 s, by more than any estimator lives through."""
    for k, sample in enumerate(measured.samples):
        if 8.0 < (sample.stamp_ns - dive.START_NS) * 1e-9 < 8.7:
            false = sample.accel + np.array([15.0, 0, 0])
            measured.samples[k] = ImuMeasurement(sample.stamp_ns, sample.gyro, false)


def test_a_start_with_biases_that_no_inertial_unit_has_is_none(monkeypatch):
    """As where drifting silt fits if gravity points elsewhere: the accelerometer's bias then makes up for it."""
    measured = dive.make_dive(6, duration_s=8.0)
    usual, adjust, found = estimate(measured), initialisation.adjust, []

    def adjust_to_silt(model, stretch, *arguments):
        bundle = adjust(model, stretch, *arguments)
        if not found:
            tilted = gtsam.imuBias.ConstantBias(np.array([0.0, 20.0 * model.accel_turn_on, 0.0]), np.zeros(3))
            bundle.values.update(B(stretch[-1].index), tilted)
        found.append(bundle)
        return bundle

    monkeypatch.setattr(initialisation, "adjust", adjust_to_silt)
    later = estimate(measured)
    assert later.info["init_s"] > usual.info["init_s"]
    assert "restarts" not in later.info
    assert position_error(measured.truth, later.smoothed()) < 0.02


@pytest.mark.slow
def test_it_starts_anew_after_the_inertial_unit_has_lied():
    measured = dive.make_dive(4)
    lie(measured)
    estimator = estimate(measured)
    trajectory = estimator.smoothed()
    assert estimator.info["restarts"] >= 1
    assert len(trajectory) == len(measured.stamps_ns)
    # Where it is after that is a guess, how it moves from then on is not.
    late = trajectory.stamps_ns > dive.START_NS + 15_000_000_000
    assert position_error(measured.truth, trajectory.select(late)) < 0.05


@pytest.mark.parametrize(
    "stretch", [10, pytest.param(14, marks=pytest.mark.slow)]
)  # shorter and longer than the window that begins with it
@pytest.mark.slow
def test_a_new_start_may_take_longer_than_the_stretch_that_is_searched(stretch):
    measured = dive.make_dive(4, duration_s=24.0, blind=(8.8, 14.0))
    lie(measured)
    estimator = estimate(measured, GtsamViSettings(initialisation=InitialisationSettings(max_keyframes=stretch)))
    assert estimator.info["restarts"] >= 1
    assert estimator.info["initialised"] == 1
    for trajectory in (estimator.online(), estimator.smoothed()):
        assert len(trajectory) == len(measured.stamps_ns)
        assert np.isfinite(trajectory.covariances).all()
        late = trajectory.stamps_ns > dive.START_NS + 20_000_000_000
        assert position_error(measured.truth, trajectory.select(late)) < 0.05
    assert estimator.info["init_s"] < 8.8, "the first start's"
    assert estimator.info["restarted_s"] > 14.0


def test_two_runs_give_the_same_bytes():
    measured = dive.make_dive(6, duration_s=8.0)
    first, second = (estimate(measured).smoothed() for _ in range(2))
    assert first.positions.tobytes() == second.positions.tobytes()
    assert first.quaternions.tobytes() == second.quaternions.tobytes()


class FlatBottom(Sequence):
    """Pictures of a textured plane 4 m under the surface, by homography, with the inertial samples of a dive."""

    name = "flat"

    def __init__(self, duration_s: float) -> None:
        self.cameras = {"cam": dive.camera_calibration()}
        self.imu_calibration = dive.imu_calibration()
        self.metadata = {}
        self._seconds = duration_s
        noise = np.random.default_rng(0).normal(size=(1400, 1400)).astype(np.float32)
        texture = cv2.GaussianBlur(noise, (0, 0), 1.5) * 2 + cv2.GaussianBlur(noise, (0, 0), 5) * 4
        self._texture = np.clip(110 + 40 * texture, 0, 255).astype(np.uint8)

    def images(self, camera: str, start_ns: int | None = None, end_ns: int | None = None) -> Iterator[Image]:
        calibration = self.cameras[camera]
        times = np.arange(0, self._seconds, 1 / calibration.rate_hz)
        # Texels of 1 cm, the first at x = y = -7 m: columns are the directions of both axes and the origin.
        on_plane = np.array([[0.01, 0, -7], [0, 0.01, -7], [0, 0, -4], [0, 0, 1]])
        for time, pose in zip(times, dive.survey_pose(times), strict=True):
            homography = calibration.matrix @ (invert(pose @ calibration.T_base_cam) @ on_plane)[:3]
            pixels = cv2.warpPerspective(self._texture, homography, (calibration.width, calibration.height))
            yield Image(dive.START_NS + round(time * 1e9), camera, np.repeat(pixels[:, :, None], 3, axis=2))

    def imu(self, start_ns: int | None = None, end_ns: int | None = None) -> Iterator[ImuMeasurement]:
        generator = np.random.default_rng(3)
        return dive.inertial_stream(dive.survey_pose, self.imu_calibration, self._seconds, generator)

    @property
    def duration_s(self) -> float:
        return self._seconds

    def contents(self) -> list[tuple[str, str, int]]:
        return []

    def truth(self) -> Trajectory:
        times = np.arange(0, self._seconds, 0.05)
        poses = dive.survey_pose(times)
        quaternions = Rotation.from_matrix(poses[:, :3, :3]).as_quat()
        stamps = dive.START_NS + np.round(times * 1e9).astype(np.int64)
        return Trajectory(stamps, poses[:, :3, 3].copy(), quaternions)


@pytest.mark.slow
def test_it_follows_the_vehicle_from_pictures_of_a_flat_bottom():
    sequence = FlatBottom(9.0)
    result = GtsamVi().run(sequence.for_method())
    truth = sequence.truth()
    assert result.info["trajectory"] == "smoothed"
    assert len(result.trajectory) == len(truth)
    assert position_error(truth, result.trajectory) < 0.01 * truth.path_length


def test_too_short_a_sequence_still_gives_a_pose_for_every_frame():
    result = GtsamVi(output="online").run(FlatBottom(0.4).for_method())
    assert len(result.trajectory) == 8
    assert np.isfinite(result.trajectory.positions).all()
    assert result.info["initialised"] == 0


def test_an_unknown_camera_and_an_unknown_output_are_refused():
    with pytest.raises(MethodError, match="no camera 'left'; cameras: cam"):
        GtsamVi(camera="left").run(FlatBottom(0.1))
    with pytest.raises(MethodError, match="'smoothed' or 'online'"):
        GtsamVi(output="best")


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"noise.views_alike": "0"}, r"option noise\.views_alike: expected more than 0, got 0"),
        ({"frontend.max_tracks": "-3"}, r"option frontend\.max_tracks: expected 0 or more, got -3"),
        ({"recovery.unknown_speed": "nan"}, r"option recovery\.unknown_speed: expected 0 or more, got nan"),
    ],
)
def test_a_number_that_cannot_be_is_refused_by_its_name(options, message):
    with pytest.raises(MethodError, match=message):
        configure(GtsamVi, options, "gtsam_vi[...]")


def test_parts_can_be_left_out():
    method, _ = configure(GtsamVi, {"calibration.enabled": "false", "frontend.rolling_shutter": "false"}, "gtsam_vi")
    assert not method.settings.calibration.enabled
    assert not method.settings.frontend.rolling_shutter


def floor_folder() -> Path:
    folder = SHARED_DATA / "floor-euroc"
    if not (folder / "mav0").is_dir():
        pytest.skip(f"{folder} is absent; OYSTERBENCH_SHARED_DATA names the folder that holds floor-euroc")
    return folder


class Beginning(EurocSequence):
    """The first seconds of a folder in EuRoC layout."""

    seconds = 15.0

    def images(self, camera: str, start_ns: int | None = None, end_ns: int | None = None) -> Iterator[Image]:
        first = None
        for image in super().images(camera, start_ns, end_ns):
            first = first or image.stamp_ns
            if image.stamp_ns > first + self.seconds * 1e9:
                return
            yield image


@pytest.mark.slow
def test_it_follows_a_sequence_that_others_rendered():
    folder = floor_folder()
    truth = read_trajectory(folder / "truth_body.tum")
    trajectory = GtsamVi().run(Beginning(folder).for_method()).trajectory
    assert len(trajectory) >= 300
    path: Array = truth.at(trajectory.stamps_ns).positions
    assert position_error(truth, trajectory) < 0.003 * np.linalg.norm(np.diff(path, axis=0), axis=1).sum()
