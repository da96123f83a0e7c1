"""What a second camera adds to the visual-inertial baseline."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from types import SimpleNamespace

import cv2
import numpy as np
import pytest

from oysterbench.core.errors import MethodError
from oysterbench.core.geometry import Array, align_yaw, invert
from oysterbench.core.measurements import Image
from oysterbench.core.trajectory import Trajectory
from oysterbench.evaluate.slam.scoring import score
from oysterbench.evaluate.slam.settings import SlamSettings
from oysterbench.sequence.types import ImuMeasurement
from oysterbench_baselines.common.inertial import SampleBuffer
from oysterbench_baselines.gtsam_vi import GtsamVi, GtsamViSettings, GtsamViStereo
from oysterbench_baselines.gtsam_vi.estimator import Estimator
from oysterbench_baselines.gtsam_vi.flow import homogeneous
from oysterbench_baselines.gtsam_vi.frontend import FeatureTracks, FrontEnd, undistort
from oysterbench_baselines.gtsam_vi.stereo import StereoMatcher, pairs, second_camera
from tests.helpers import synthetic_dive as dive


def estimate(measured: dive.Dive, blind_right: bool = False) -> Estimator:
    """Everything behind the front end, run on the tracks of both cameras."""
    camera = dive.right_calibration()
    estimator = Estimator([measured.camera, camera], measured.inertial, GtsamViSettings())
    samples, frame = SampleBuffer(), 0
    for item in measured.stream():
        if isinstance(item, ImuMeasurement):
            samples.add(item)
            continue
        stamp, ids, pixels = item
        right = np.full((len(ids), 2), np.nan) if blind_right else undistort(measured.right[frame], camera)
        rays = undistort(pixels, measured.camera)
        estimator.propagate(samples.cut(stamp))
        estimator.step(stamp, FeatureTracks(ids, pixels, rays), right.copy)
        frame += 1
    estimator.finish()
    return estimator


def position_error(truth: Trajectory, trajectory: Trajectory) -> float:
    """RMSE (m) after alignment in yaw and translation; never in scale."""
    known = truth.at(trajectory.stamps_ns)
    aligned = align_yaw(known.positions, trajectory.positions).apply(trajectory.positions)
    return float(np.sqrt(np.mean(np.sum((aligned - known.positions) ** 2, axis=1))))


def transect_pose(t: Array) -> Array:
    """Straight ahead at 0.4 m/s without the least sway: one camera cannot tell its scale."""
    return dive.poses_of(0.4 * t, 0 * t, -3 + 0 * t, 0 * t, 0 * t, 0 * t)


def test_a_steady_straight_transect_has_its_length():
    measured = dive.make_dive(0, duration_s=10.0, pose=transect_pose)
    estimator = estimate(measured)
    assert estimator.info["init_s"] < 1.5
    for trajectory in (estimator.online(), estimator.smoothed()):
        assert np.linalg.norm(trajectory.positions[-1] - trajectory.positions[0]) == pytest.approx(4.0, abs=0.02)


def test_it_starts_at_rest_and_holds_its_place():
    measured = dive.make_dive(1, duration_s=4.0, pose=lambda t: dive.survey_pose(0 * t))
    estimator = estimate(measured)
    assert estimator.info["initialised"] == 1
    positions = estimator.online().positions
    assert np.abs(positions - positions[0]).max() < 0.02


@pytest.mark.parametrize("seed", [pytest.param(0, marks=pytest.mark.slow), 1])
def test_a_dive_is_recovered_to_a_thousandth_of_its_path(seed):
    measured = dive.make_dive(seed)
    estimator = estimate(measured)
    for trajectory in (estimator.online(), estimator.smoothed()):
        assert position_error(measured.truth, trajectory) < 0.001 * measured.truth.path_length


def test_errors_are_as_large_as_the_covariances_say():
    measured = dive.make_dive(0, duration_s=8.0)
    estimator = estimate(measured)
    for trajectory in (estimator.online(), estimator.smoothed()):
        found = score(measured.truth, trajectory, SlamSettings(align="origin")).metrics
        assert 0.2 < found["nees_pose"] < 12.0  # 6 are expected, of errors that hang together over the whole dive


@pytest.mark.slow
def test_a_second_camera_that_sees_nothing_leaves_the_first_to_do_it():
    measured = dive.make_dive(0)
    assert position_error(measured.truth, estimate(measured, blind_right=True).smoothed()) < 0.003 * 10.0


class Bottom:
    """Pictures of a textured plane, by homography, seen by a camera of the synthetic dive."""

    def __init__(self, seed: int = 0) -> None:
        noise = np.random.default_rng(seed).normal(size=(1400, 1400)).astype(np.float32)
        texture = cv2.GaussianBlur(noise, (0, 0), 1.5) * 2 + cv2.GaussianBlur(noise, (0, 0), 5) * 4
        self.texture = np.clip(110 + 40 * texture, 0, 255).astype(np.uint8)

    def seen(self, calibration, T_map_base: Array) -> np.ndarray:
        """(480, 640) grey. Texels of 1 cm, the first at x = y = -7 m, 4 m under the surface."""
        on_plane = np.array([[0.01, 0, -7], [0, 0.01, -7], [0, 0, -4], [0, 0, 1]])
        homography = calibration.matrix @ (invert(T_map_base @ calibration.T_base_cam) @ on_plane)[:3]
        return cv2.warpPerspective(self.texture, homography, (calibration.width, calibration.height))


def test_corners_are_found_in_the_second_picture_to_a_fraction_of_a_pixel():
    first, second, bottom, settings = dive.camera_calibration(), dive.right_calibration(), Bottom(), GtsamViSettings()
    pose = dive.survey_pose(np.array([1.0]))[0]
    front_end, matcher = FrontEnd(first, settings.frontend), StereoMatcher(first, second, settings)
    tracks = front_end.track(bottom.seen(first, pose), np.eye(3))
    T_map_first = pose @ first.T_base_cam
    directions = homogeneous(tracks.rays) @ T_map_first[:3, :3].T
    points = T_map_first[:3, 3] + directions * ((-4 - T_map_first[2, 3]) / directions[:, 2])[:, None]
    seen = (points - (pose @ second.T_base_cam)[:3, 3]) @ (pose @ second.T_base_cam)[:3, :3]
    expected = seen[:, :2] / seen[:, 2:]
    inside = (np.abs(expected @ np.diag([second.matrix[0, 0], second.matrix[1, 1]])) < [300, 220]).all(axis=1)
    for _ in range(2):  # without and with the depths of the last pair
        found = matcher.match(front_end.image, front_end.equalise(bottom.seen(second, pose)), tracks)
        matched = np.isfinite(found[:, 0])
        assert matched[inside].mean() > 0.8
        error = np.linalg.norm(found - expected, axis=1)[matched] * second.matrix[0, 0]
        assert np.median(error) < 0.25
        assert np.quantile(error, 0.9) < 1.0  # along the epipolar line nothing tells a wrong one


def test_another_picture_has_no_matches():
    first, second, settings = dive.camera_calibration(), dive.right_calibration(), GtsamViSettings()
    pose = dive.survey_pose(np.array([1.0]))[0]
    front_end, matcher = FrontEnd(first, settings.frontend), StereoMatcher(first, second, settings)
    tracks = front_end.track(Bottom(0).seen(first, pose), np.eye(3))
    found = matcher.match(front_end.image, front_end.equalise(Bottom(7).seen(second, pose)), tracks)
    assert np.isfinite(found[:, 0]).mean() < 0.05


def item(camera: str, ms: int) -> Image:
    return Image(ms * 1_000_000, camera, np.zeros((2, 2), dtype=np.uint8))


def test_frames_are_paired_by_their_stamps_in_whichever_order_they_come():
    sample = ImuMeasurement(15_000_000, np.zeros(3), np.zeros(3))
    order: Iterator = iter(
        [item("l", 0), item("r", 0), sample, item("r", 20), item("l", 20), item("l", 40), item("l", 60)]
    )
    found = list(pairs(order, "l", "r", 1e-3))
    assert [type(row) for row in found] == [tuple, ImuMeasurement, tuple, tuple, tuple]
    frames = [row for row in found if isinstance(row, tuple)]
    assert [(a.stamp_ns // 1_000_000, b and b.stamp_ns // 1_000_000) for a, b in frames] == [
        (0, 0), (20, 20), (40, None), (60, None),
    ]  # fmt: skip


@pytest.mark.parametrize("frames", [20, 150])
def test_frames_of_which_hardly_any_are_taken_together_are_refused_with_what_is_between_them(frames):
    taken = [(20 * k, "l") for k in range(frames)] + [(20 * k + 3 + k % 2, "r") for k in range(frames)]
    with pytest.raises(MethodError) as caught:
        list(pairs((item(camera, ms) for ms, camera in sorted(taken)), "l", "r", 1e-3))
    assert str(caught.value).startswith(
        f"of {min(frames, 100)} frames of 'l' and 'r', 0 were taken within 1 ms of each other: the nearest stamps "
        "differ by 3 ms at least, 3.5 ms in the median; correct the stamps, give --set stereo.sync_s=SECONDS if "
    )


def test_a_second_camera_may_take_a_frame_now_and_then_but_must_take_some():
    taken = [item("l", 20 * k) for k in range(200)]
    rare = [item("r", 400 * k) for k in range(10)]
    stream = sorted([*taken, *rare], key=lambda image: image.stamp_ns)
    assert sum(other is not None for _, other in pairs(iter(stream), "l", "r", 1e-3)) == 10
    with pytest.raises(MethodError, match=r"camera 'r' has no frames .*run gtsam_vi, with one camera"):
        list(pairs(iter(taken), "l", "r", 1e-3))


def test_without_a_second_camera_it_says_so():
    from tests.baselines.test_gtsam_vi import FlatBottom

    with pytest.raises(MethodError, match=r"gtsam_vi_stereo: .*no second camera.*run gtsam_vi"):
        GtsamViStereo().run(FlatBottom(0.1).for_method())
    assert GtsamVi(stereo=True).stereo


def test_a_camera_with_pictures_of_another_size_is_no_second_one():
    first, second = dive.camera_calibration(), dive.right_calibration()
    rig = SimpleNamespace(cameras={"l": first, "r": replace(second, width=second.width // 2)})
    assert second_camera(rig, "l", GtsamViSettings().stereo) is None
    rig.cameras["r"] = second
    assert second_camera(rig, "l", GtsamViSettings().stereo) == "r"
