"""What plain visual odometry promises: on tracks of points, and on pictures of a level bottom."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import cv2
import numpy as np
import pytest

from oysterbench.core.errors import MethodError
from oysterbench.core.geometry import Array, invert, transform
from oysterbench.core.measurements import Image
from oysterbench.core.trajectory import Trajectory
from oysterbench.evaluate.slam.scoring import SlamSettings, score
from oysterbench.evaluate.slam.settings import Align
from oysterbench.sequence.types import CameraCalibration, ImuMeasurement, Sequence
from oysterbench_baselines.visual_only import VisualOnly
from oysterbench_baselines.visual_only.lens import Lens
from oysterbench_baselines.visual_only.method import overlapping, poses_of_base
from oysterbench_baselines.visual_only.odometry import Frame, Odometry
from oysterbench_baselines.visual_only.settings import VisualOnlySettings
from oysterbench_baselines.visual_only.views import point_from_views, pose_from_points, ray_angle
from tests.helpers import synthetic_dive as dive

BOTTOM_Z, RATE_HZ = -4.0, 20.0
TEXEL_M = 0.006
BASE_M = 0.12
DOWN = np.array([[0.0, -0.866, 0.5], [-1, 0, 0], [0, -0.5, -0.866]])  # optical axes, 60 degrees below the horizon


def camera(y: float, **changes) -> CameraCalibration:
    matrix = np.array([[230.0, 0, 159.5], [0, 230, 119.5], [0, 0, 1]])
    axes = np.linalg.qr(DOWN)[0]
    axes *= np.sign(np.sum(axes * DOWN, axis=0))
    known = CameraCalibration(320, 240, RATE_HZ, matrix, np.zeros(4), transform(axes, [0.2, y, 0.0]))
    return replace(known, **changes)


class Bottom(Sequence):
    """Pictures of a level bottom with a random pattern, from a rig that flies the survey's loop; no other sensor."""

    name = "bottom"

    def __init__(self, cameras: dict[str, CameraCalibration], duration_s: float, blind: tuple[float, float] = (9, 9)):
        self.metadata = {}
        self.cameras = cameras
        self.imu_calibration = dive.imu_calibration()
        self._duration_s, self._blind = duration_s, blind
        generator = np.random.default_rng(3)
        size = round(8.0 / TEXEL_M)
        pattern = np.zeros((size, size))
        for cell in (2, 5, 14, 40):  # texels
            noise = generator.normal(size=(size // cell + 1, size // cell + 1))
            pattern += cv2.resize(noise, (size, size), interpolation=cv2.INTER_CUBIC)
        self._pattern = np.clip(110 + 28 * pattern, 0, 255).astype(np.uint8)

    @property
    def times(self) -> Array:
        return np.arange(0, self._duration_s, 1 / RATE_HZ)

    def images(self, camera: str, start_ns: int | None = None, end_ns: int | None = None) -> Iterator[Image]:
        known = self.cameras[camera]
        texels = np.array([[TEXEL_M, 0, -4.0], [0, TEXEL_M, -4.0], [0, 0, 1]])  # texel -> x, y, 1 on the bottom
        for t, T_map_base in zip(self.times, dive.survey_pose(self.times), strict=True):
            T_cam_map = invert(T_map_base @ known.T_base_cam)
            plane = np.column_stack([T_cam_map[:3, :2], BOTTOM_Z * T_cam_map[:3, 2] + T_cam_map[:3, 3]])
            grey = cv2.warpPerspective(self._pattern, known.matrix @ plane @ texels, (known.width, known.height))
            if self._blind[0] <= t < self._blind[1]:
                grey = np.full_like(grey, 90)
            stamp = dive.START_NS + round(t * 1e9)
            yield Image(stamp, camera, np.repeat(grey[..., None], 3, axis=2))

    def imu(self, start_ns: int | None = None, end_ns: int | None = None) -> Iterator[ImuMeasurement]:
        raise AssertionError("visual odometry asked for the inertial unit")

    def truth(self) -> Trajectory:
        poses = dive.survey_pose(self.times)
        stamps = dive.START_NS + np.round(self.times * 1e9).astype(np.int64)
        return poses_of_base(dict(zip(stamps.tolist(), poses, strict=True)), np.eye(4))

    @property
    def duration_s(self) -> float:
        return self._duration_s

    def contents(self) -> list[tuple[str, str, int]]:
        return []


ONE = {"cam_left": camera(BASE_M / 2)}
TWO = {**ONE, "cam_right": camera(-BASE_M / 2)}


def scored(estimate: Trajectory, truth: Trajectory, align: Align) -> dict[str, float]:
    return dict(score(truth, estimate, SlamSettings(align=align)).metrics)


# The whole method, on pictures


def test_a_stereo_pair_gives_the_path_at_its_true_scale():
    sequence = Bottom(TWO, 6.0)
    estimate = VisualOnly().run(sequence)
    metrics = scored(estimate.trajectory, sequence.truth(), "se3")
    assert estimate.info["cameras"] == ["cam_left", "cam_right"]
    assert metrics["coverage"] == 1.0
    assert metrics["ate_percent"] < 1.0
    assert 0.98 < scored(estimate.trajectory, sequence.truth(), "sim3")["scale"] < 1.02


def test_a_camera_with_pictures_of_another_size_is_no_second_one():
    small = replace(TWO["cam_right"], width=160, height=120)
    sequence = Bottom({**ONE, "cam_right": small}, 1.0)
    assert overlapping(sequence, "cam_left", VisualOnlySettings()) is None
    sequence.cameras = {**sequence.cameras, "cam_far": TWO["cam_right"]}
    assert overlapping(sequence, "cam_left", VisualOnlySettings()) == "cam_far"


def test_it_does_not_claim_to_be_online_where_the_first_frames_wait_for_a_map():
    assert VisualOnly().about["online"] is False


def test_one_camera_gives_the_path_up_to_scale_and_says_so():
    sequence = Bottom(ONE, 6.0)
    estimate = VisualOnly().run(sequence)
    metrics = scored(estimate.trajectory, sequence.truth(), "sim3")
    assert estimate.info["scale"].startswith("none")
    assert metrics["coverage"] > 0.95
    assert metrics["ate_percent"] < 2.0


def test_two_runs_give_the_same_bytes():
    first, second = (VisualOnly().run(Bottom(TWO, 1.5)).trajectory for _ in range(2))
    assert first.positions.tobytes() == second.positions.tobytes()
    assert first.quaternions.tobytes() == second.quaternions.tobytes()


def test_a_moment_without_sight_is_bridged_and_left_out_of_the_answer():
    sequence = Bottom(TWO, 4.0, blind=(2.0, 2.3))
    estimate = VisualOnly().run(sequence)
    seconds = (estimate.trajectory.stamps_ns - dive.START_NS) * 1e-9
    assert not ((seconds > 1.99) & (seconds < 2.29)).any()
    assert seconds[-1] == pytest.approx(3.95)
    assert estimate.info["located"] == 80 - 6
    assert scored(estimate.trajectory, sequence.truth(), "se3")["ate_percent"] < 1.0


def test_after_a_long_time_without_sight_it_begins_again_where_it_would_have_gone():
    sequence = Bottom(TWO, 4.5, blind=(1.5, 3.0))
    estimate = VisualOnly().run(sequence)
    seconds = (estimate.trajectory.stamps_ns - dive.START_NS) * 1e-9
    assert not ((seconds > 1.5) & (seconds < 2.99)).any()
    assert seconds[-1] == pytest.approx(4.45)
    assert estimate.info["maps"] == 2
    assert estimate.info["lost_at_ns"] is None
    metrics = scored(estimate.trajectory, sequence.truth(), "se3")
    assert metrics["coverage"] > 0.6
    assert metrics["ate_percent"] < 5.0  # 1.5 s at half a metre a second are guessed


@pytest.mark.slow
def test_one_camera_begins_again_in_the_unit_that_it_had():
    sequence = Bottom(ONE, 12.0, blind=(5.0, 6.5))
    estimate = VisualOnly().run(sequence)
    assert estimate.info["maps"] == 2
    truth = sequence.truth()
    positions = estimate.trajectory.positions
    seconds = (estimate.trajectory.stamps_ns - dive.START_NS) * 1e-9
    scales = []
    for part in (seconds < 5.0, seconds > 6.5):
        stamps = estimate.trajectory.stamps_ns[part]
        true = truth.positions[np.searchsorted(truth.stamps_ns, stamps[[0, -1]])]
        scales.append(np.linalg.norm(np.diff(positions[part][[0, -1]], axis=0)) / np.linalg.norm(np.diff(true, axis=0)))
    assert scales[1] / scales[0] == pytest.approx(1.0, abs=0.3)


def test_what_never_comes_back_is_said_to_be_lost():
    estimate = VisualOnly().run(Bottom(TWO, 4.5, blind=(1.5, 5.0)))
    seconds = (estimate.trajectory.stamps_ns - dive.START_NS) * 1e-9
    assert seconds[-1] < 1.5
    assert estimate.info["lost_at_ns"] is not None
    assert estimate.info["maps"] == 1


def test_pictures_without_a_corner_are_refused_in_one_line():
    with pytest.raises(MethodError, match="no map could be begun in 20 frames of cam_left"):
        VisualOnly().run(Bottom(ONE, 1.0, blind=(0.0, 2.0)))


def test_cameras_that_look_elsewhere_are_no_pair():
    back = camera(-BASE_M / 2)
    turned = back.T_base_cam @ transform(np.diag([-1.0, 1, -1]), np.zeros(3))
    estimate = VisualOnly().run(Bottom({**ONE, "cam_back": replace(back, T_base_cam=turned)}, 2.0))
    assert estimate.info["cameras"] == ["cam_left"]


def test_a_second_camera_that_never_recorded_leaves_the_first_to_do_it(monkeypatch):
    images = Bottom.images
    monkeypatch.setattr(
        Bottom, "images", lambda self, name, *at: images(self, name, *at) if name == "cam_left" else iter(())
    )
    estimate = VisualOnly().run(Bottom(TWO, 2.0))
    assert estimate.info["cameras"] == ["cam_left"]
    assert len(estimate.trajectory.stamps_ns) > 20


def test_an_unknown_camera_is_named():
    with pytest.raises(MethodError, match="no camera 'cam_top'; cameras: cam_left"):
        VisualOnly(camera="cam_top").run(Bottom(ONE, 1.0))


# The odometry, on tracks


@pytest.mark.parametrize("seed", [0, *(pytest.param(seed, marks=pytest.mark.slow) for seed in (1, 3, 4))])
def test_tracks_with_noise_and_outliers_give_the_path_of_the_camera(seed):
    made = dive.make_dive(seed=seed, duration_s=7.0, outliers=0.02)
    lens = Lens(made.camera)
    odometry = Odometry(VisualOnlySettings(), lens.focal_px)
    for stamp, (ids, pixels) in zip(made.stamps_ns, made.tracks, strict=True):
        odometry.add(Frame(int(stamp), ids, lens.rays(pixels)))
    true = made.truth.matrices @ made.camera.T_base_cam
    truth = poses_of_base(dict(zip(made.stamps_ns.tolist(), true, strict=True)), np.eye(4))
    metrics = scored(poses_of_base(odometry.poses, np.eye(4)), truth, "sim3")
    assert metrics["coverage"] == 1.0  # the frames before the first map are located afterwards
    assert metrics["ate_percent"] < 0.3
    assert metrics["ate_rotation_rmse_deg"] < 1.5


def test_the_true_path_of_its_camera_is_exact_by_sim3_in_whatever_unit_the_map_is():
    made = dive.make_dive(seed=0, duration_s=7.0)
    poses = made.truth.matrices @ made.camera.T_base_cam
    poses[:, :3, 3] *= 0.1
    estimate = poses_of_base(dict(zip(made.truth.stamps_ns.tolist(), poses, strict=True)), made.camera.T_base_cam)
    assert scored(estimate, made.truth, "sim3")["ate_rmse_m"] < 1e-9


# Its parts


@pytest.mark.parametrize(
    "changes",
    [
        {},
        {"distortion": np.array([0.12, 0.06, 0.0004, -0.0003])},
        {"distortion": np.array([0.05, 0.01, -0.003, 0.001]), "distortion_model": "equidistant"},
        {"port_m": 0.03, "port_index": 1.333},
    ],
)
def test_rays_and_pixels_are_inverse_to_each_other(changes):
    lens = Lens(camera(0.0, **changes))
    pixels = np.random.default_rng(0).uniform([5, 5], [315, 235], (200, 2))
    np.testing.assert_allclose(lens.pixels(lens.rays(pixels)), pixels, atol=1e-2)


def test_a_flat_port_bends_rays_by_snells_law():
    ray = Lens(camera(0.0, port_m=0.03, port_index=1.333)).rays(np.array([[300.0, 119.5]]))[0]
    air = np.arctan((300 - 159.5) / 230)
    assert np.sin(np.arctan(ray[0])) == pytest.approx(np.sin(air) / 1.333, rel=1e-9)


def test_a_point_is_found_from_its_views_and_their_angle_is_right():
    poses = np.array([transform(np.eye(3), [x, 0.0, 0.0]) for x in (0.0, 0.2, 0.5)])
    point = np.array([0.1, -0.2, 2.0])
    seen = point - poses[:, :3, 3]
    np.testing.assert_allclose(point_from_views(poses, seen[:, :2] / seen[:, 2:]), point, atol=1e-9)
    lines = seen / np.linalg.norm(seen, axis=1, keepdims=True)
    assert ray_angle(poses, point) == pytest.approx(np.arccos(lines[0] @ lines[2]))


def test_a_point_behind_the_camera_is_none():
    poses = np.array([transform(np.eye(3), [x, 0.0, 0.0]) for x in (0.0, 0.5)])
    seen = np.array([0.1, 0.2, -2.0]) - poses[:, :3, 3]
    assert point_from_views(poses, seen[:, :2] / seen[:, 2:]) is None


def test_a_pose_is_found_among_wrong_points():
    generator = np.random.default_rng(5)
    T_map_cam = dive.survey_pose(np.array([3.0]))[0]
    seen = generator.uniform([-1, -1, 1], [1, 1, 4], (60, 3))
    points = seen @ T_map_cam[:3, :3].T + T_map_cam[:3, 3]
    rays = seen[:, :2] / seen[:, 2:]
    rays[:20] += generator.normal(0, 0.2, (20, 2))
    found, agree = pose_from_points(points, rays, 1e-3, 200)
    np.testing.assert_allclose(found, T_map_cam, atol=1e-6)
    assert agree[20:].all()
    assert agree[:20].sum() <= 1
