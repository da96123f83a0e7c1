"""Clouds: depths and echoes against scenes that are known by formula, and the command that makes them."""

from __future__ import annotations

import json
import subprocess
from dataclasses import replace

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import oysterbench
from oysterbench.core.errors import OysterbenchError, SequenceError, TrajectoryError
from oysterbench.core.geometry import transform
from oysterbench.core.measurements import Image, ImuMeasurement
from oysterbench.core.ply import read_ply
from oysterbench.core.trajectory import Trajectory, write_tum
from oysterbench.core.trajectory.frames import poses_of_frame
from oysterbench.mapping import CloudSettings, build_cloud
from oysterbench.mapping.cloud import PointCloud, thinned, without_outliers
from oysterbench.mapping.echoes import heard_points
from oysterbench.mapping.pictures import seen_points
from oysterbench.mapping.views import PoseInterpolator, check_upright, partner
from oysterbench.sequence import Sequence
from oysterbench.sequence.types import CameraCalibration
from tests.helpers.hand_made_dive import BOTTOM_Z, OPTICAL, turn
from tests.helpers.paths import COMMAND

WIDTH, HEIGHT, FOCAL = 160, 120, 115.0
BOTTOM, TOP = -1.0, -0.85  # of the ground, and of a plateau on it
PLATEAU = (0.6, 1.0)  # from and to, along x
SPEED, RATE_HZ, SECONDS = 0.4, 20.0, 4.0
TEXEL_M = 0.004
TEXTURE = cv2.GaussianBlur(np.random.default_rng(5).integers(0, 256, (1200, 1200, 3), dtype=np.uint8), (0, 0), 1.5)
TEXTURE = np.clip((TEXTURE.astype(float) - 127.5) * 4.0 + 127.5, 0, 255).astype(np.float32)


def camera(y: float, distortion=(0.0, 0.0, 0.0, 0.0)) -> CameraCalibration:
    """Looks 60 degrees down."""
    return CameraCalibration(
        width=WIDTH,
        height=HEIGHT,
        rate_hz=RATE_HZ,
        matrix=np.array([[FOCAL, 0, (WIDTH - 1) / 2], [0, FOCAL, (HEIGHT - 1) / 2], [0, 0, 1.0]]),
        distortion=np.array(distortion),
        T_base_cam=transform(turn("y", 60) @ OPTICAL, [0.1, y, 0.0]),
    )


class Reef(Sequence):
    """A straight flight over a textured ground with a plateau, its pictures by ray casting in closed form."""

    name = "reef"
    metadata = {}  # noqa: RUF012
    imu_calibration = None  # type: ignore[assignment]

    def __init__(self, cameras: dict[str, CameraCalibration]) -> None:
        self.cameras = cameras
        self.stamps = 10**18 + np.arange(round(RATE_HZ * SECONDS)) * round(1e9 / RATE_HZ)

    @property
    def duration_s(self) -> float:
        return SECONDS

    def contents(self):
        return [(f"/{name}/image", "", round(SECONDS * RATE_HZ)) for name in self.cameras]

    def truth(self) -> Trajectory:
        t = (self.stamps - self.stamps[0]) * 1e-9
        positions = np.column_stack([SPEED * t, 0.05 * np.sin(t), 0.02 * np.cos(t)])
        return Trajectory(self.stamps, positions, np.tile([0.0, 0, 0, 1], (len(t), 1)))

    def imu(self, start_ns=None, end_ns=None):
        for stamp in self.stamps:
            yield ImuMeasurement(int(stamp), np.zeros(3), np.array([0, 0, 9.81]))

    def images(self, name, start_ns=None, end_ns=None):
        calibration = self.cameras[name]
        pixels = np.stack(np.meshgrid(np.arange(WIDTH), np.arange(HEIGHT)), axis=-1).reshape(-1, 1, 2).astype(float)
        rays = cv2.undistortPoints(pixels, calibration.matrix, calibration.distortion).reshape(-1, 2)
        rays = np.column_stack([rays, np.ones(len(rays))])
        for stamp, T_map_base in zip(self.stamps, self.truth().matrices, strict=True):
            T = T_map_base @ calibration.T_base_cam
            directions, origin = rays @ T[:3, :3].T, T[:3, 3]
            ground = origin + directions * ((BOTTOM - origin[2]) / directions[:, 2])[:, None]
            top = origin + directions * ((TOP - origin[2]) / directions[:, 2])[:, None]
            on_top = (top[:, 0] > PLATEAU[0]) & (top[:, 0] < PLATEAU[1])
            hits = np.where(on_top[:, None], top, ground)
            yield Image(int(stamp), name, colours_at(hits).reshape(HEIGHT, WIDTH, 3).astype(np.uint8))


def colours_at(points: np.ndarray) -> np.ndarray:
    """(N, 3) of the texture at points (N, 3); the plateau's is another part of it."""
    shift = np.where(points[:, 2] > (BOTTOM + TOP) / 2, 300, 0)
    u = (points[:, 0] / TEXEL_M + 200 + shift).astype(np.float32)
    v = (points[:, 1] / TEXEL_M + 600).astype(np.float32)
    return cv2.remap(TEXTURE, u[:, None], v[:, None], cv2.INTER_LINEAR, borderMode=cv2.BORDER_WRAP).reshape(-1, 3)


def distances(points: np.ndarray) -> np.ndarray:
    """(N,) m to the surface, the walls of the plateau left out."""
    on_top = (points[:, 0] > PLATEAU[0]) & (points[:, 0] < PLATEAU[1])
    return np.where(on_top, np.minimum(abs(points[:, 2] - TOP), abs(points[:, 2] - BOTTOM)), abs(points[:, 2] - BOTTOM))


MONO = {"cam": camera(0.0)}
STEREO = {"cam_left": camera(0.06), "cam_right": camera(-0.06)}
BENT = {"cam": camera(0.0, (-0.2, 0.05, 0.001, -0.001))}


@pytest.fixture(scope="module")
def clouds():
    return {name: build_cloud(Reef(rig), Reef(rig).truth()) for name, rig in [("mono", MONO), ("stereo", STEREO)]}


@pytest.mark.parametrize("rig", ["mono", "stereo"])
def test_points_lie_on_the_surface_with_its_colours(rig, clouds):
    cloud = clouds[rig]
    assert len(cloud) > 5000
    away = distances(cloud.points)
    # A disparity to a quarter of a pixel: 12 mm for the pair at 1.1 m, 10 mm for one camera's sources.
    assert np.median(away) < 0.008
    assert np.percentile(away, 95) < 0.04
    assert (abs(cloud.points[:, 2] - TOP) < 0.02).sum() > 500
    clear = away < 0.004
    grey = colours_at(cloud.points[clear]).mean(axis=1)
    assert np.corrcoef(grey, cloud.colours[clear].mean(axis=1))[0, 1] > 0.8


def test_a_bent_lens_is_straightened(clouds):
    reef = Reef(BENT)
    cloud = build_cloud(reef, reef.truth())
    assert len(cloud) > 0.5 * len(clouds["mono"])
    assert np.median(distances(cloud.points)) < 0.008


def test_the_cloud_is_in_the_frame_of_the_trajectory(clouds):
    reef = Reef(STEREO)
    moved = replace(reef.truth(), positions=reef.truth().positions + np.array([5.0, -3.0, 2.0]))
    cloud = build_cloud(reef, moved)
    assert np.median(distances(cloud.points - [5.0, -3.0, 2.0])) < 0.008
    # Voxels are cut elsewhere, and so the number of points is not the same to the one.
    assert len(cloud) == pytest.approx(len(clouds["stereo"]), rel=0.05)


def test_where_the_path_has_a_gap_there_are_no_views():
    reef = Reef(STEREO)
    truth = reef.truth()
    seconds = (truth.stamps_ns - truth.stamps_ns[0]) * 1e-9
    path = PoseInterpolator(truth.select((seconds < 1.0) | (seconds > 3.0)), 0.3)
    assert path.at(int(truth.stamps_ns[0]) + 2 * 10**9) is None
    assert path.at(int(truth.stamps_ns[-1]) + 1) is None
    whole, parted = (
        thinned(seen_points(reef, "cam_left", each, CloudSettings()), 0.01)
        for each in (PoseInterpolator(truth, 0.3), path)
    )
    assert 0.2 < len(parted) / len(whole) < 0.8


def test_a_pose_between_two_is_interpolated():
    truth = Reef(MONO).truth()
    halfway = PoseInterpolator(truth, 0.3).at(int(truth.stamps_ns[3] + truth.stamps_ns[4]) // 2)
    np.testing.assert_allclose(halfway[:3, 3], truth.positions[3:5].mean(axis=0), atol=1e-6)


def test_a_gap_as_large_as_may_be_is_bridged_whatever_its_stamps_were_rounded_to():
    """Seconds since 1970 in float64 are exact to some 0.2 us."""
    stamps = ((1_700_000_000_000_012_345 + np.arange(50) * 300_000_000) * 1e-9 * 1e9).astype(np.int64)
    assert (np.diff(stamps) > 300_000_000).any()
    path = Trajectory(stamps, np.zeros((50, 3)), np.tile([0.0, 0.0, 0.0, 1.0], (50, 1)))
    poses, rolling = PoseInterpolator(path, 0.3), replace(camera(0.0), readout_s=0.2)
    assert all(poses.at(stamp) is not None for stamp in (stamps[:-1] + 10**8).tolist())
    assert not any(np.isnan(poses.of_rows(rolling, stamp)).any() for stamp in (stamps[1:-1] + 10**8).tolist())
    assert PoseInterpolator(path, 0.2999).at(int(stamps[0]) + 10**8) is None


def test_rows_taken_in_a_gap_of_the_path_have_the_pose_before_it():
    truth, rolling = Reef(MONO).truth(), replace(camera(0.0), readout_s=0.2)
    stamp = int(truth.stamps_ns[10])
    parted = PoseInterpolator(truth.select(abs(truth.stamps_ns - stamp - 5 * 10**8) >= 5 * 10**8), 0.3)
    whole = PoseInterpolator(truth, 0.3).of_rows(rolling, stamp)
    found, half = parted.of_rows(rolling, stamp), rolling.height // 2
    np.testing.assert_allclose(found[:half], whole[:half], atol=1e-9)
    np.testing.assert_allclose(found[half + 1 :], np.tile(parted.at(stamp) @ rolling.T_base_cam, (half - 1, 1, 1)))


def test_cameras_that_look_elsewhere_make_no_pair():
    assert partner(Reef(STEREO), "cam_left", CloudSettings()) == "cam_right"
    away = replace(camera(-0.06), T_base_cam=transform(turn("z", 90) @ OPTICAL, [0.0, -0.06, 0.0]))
    assert partner(Reef({"cam_left": camera(0.06), "cam_side": away}), "cam_left", CloudSettings()) is None


# Echoes


def test_beams_and_altimeters_hit_the_bottom(dive_file):
    dive = oysterbench.open(dive_file)
    dive.sonars = {}  # its pictures are noise
    heard = list(heard_points(dive, PoseInterpolator(dive.truth(), 0.3), CloudSettings()))
    points = np.concatenate(heard)
    assert len(points) == 3 * 16 + 12 + 9  # three beams of sixteen samples, the fourth of twelve, and the altimeter
    beams, altimeter = points[:-9], points[-9:]
    np.testing.assert_allclose(beams[:, 2], BOTTOM_Z, atol=1e-5)
    assert (np.ptp(beams[:, :2], axis=0) > 0.5).all()
    assert (abs(altimeter[:, 2] - BOTTOM_Z) < 0.2).all()
    near = CloudSettings(echo_far_m=0.4)
    assert sum(map(len, heard_points(oysterbench.open(dive_file), PoseInterpolator(dive.truth(), 0.3), near))) == 0


def test_a_fan_puts_each_beam_on_the_leading_edge_of_its_echo(dive_file):
    from oysterbench.core.measurements import SonarImage
    from oysterbench.mapping.echoes import _fan

    sonar = oysterbench.open(dive_file).sonars["fls"]
    pixels = np.full((sonar.bins, sonar.beams), 10, dtype=np.uint16)
    pixels[20:24, :8] = 900  # the left half hears the bottom, the right half nothing
    pixels[22, :8] = 1000
    points = _fan(sonar, CloudSettings())(SonarImage(0, "fls", pixels))
    assert len(points) == 8
    np.testing.assert_allclose(np.linalg.norm(points, axis=1), sonar.ranges_m[20])
    np.testing.assert_allclose(np.arctan2(points[:, 1], points[:, 0]), sonar.azimuths_rad[:8])
    np.testing.assert_allclose(np.arcsin(points[:, 2] / sonar.ranges_m[20]), -sonar.vfov_rad / 2)


def test_echoes_take_their_colours_from_the_pictures(dive_file):
    dive = oysterbench.open(dive_file)
    cloud = build_cloud(dive, dive.truth(), "echoes", settings=CloudSettings(voxel_m=0.05))
    seen = (cloud.colours != 128).any(axis=1)
    assert 0.05 < seen.mean() < 1.0
    # The bottom of the hand-made dive is (60, 90, 80) and up to 20 more, its oysters are lighter.
    assert (cloud.colours[seen].mean(axis=0) > [60, 90, 80]).all()


# Thinning, outliers, mistakes


def test_a_voxel_keeps_the_mean_of_its_points_and_their_number():
    points = np.array([[0.001, 0, 0], [0.003, 0, 0], [0.5, 0.5, -0.5]])
    colours = np.array([[10, 20, 30], [20, 40, 50], [1, 2, 3]], dtype=np.uint8)
    cloud = thinned([(points[:1], colours[:1]), (points[1:], colours[1:])], 0.01)
    order = np.argsort(cloud.points[:, 0])
    np.testing.assert_allclose(cloud.points[order], [[0.002, 0, 0], [0.5, 0.5, -0.5]])
    assert cloud.colours[order].tolist() == [[15, 30, 40], [1, 2, 3]]
    assert cloud.observations[order].tolist() == [2, 1]


def test_a_cloud_far_from_the_origin_of_its_world_is_the_same_as_one_near_it(tmp_path):
    points = np.random.default_rng(5).random((4000, 3)) * [2.0, 2.0, 0.3]
    colours = np.zeros(points.shape, dtype=np.uint8)
    utm = np.array([500_000.0, 4_500_000.0, 0.0])
    near, far = (thinned([(points + off, colours)], 0.1) for off in (np.zeros(3), utm))
    assert len(near) == len(far)
    far.write(tmp_path / "far.ply", "far")
    written = read_ply(tmp_path / "far.ply")
    np.testing.assert_allclose([written[axis] for axis in "xyz"], (near.points + utm).T, rtol=0, atol=1e-6)


def test_points_too_far_apart_for_their_voxels_are_refused():
    points = np.array([[0.0, 0.0, 0.0], [0.0, 20_000.0, 0.0]])
    with pytest.raises(TrajectoryError, match=r"more than 10486 m from the first one: .* voxels of 0.01 m"):
        thinned([(points, np.zeros((2, 3), dtype=np.uint8))], 0.01)


def test_what_stands_alone_is_removed():
    grid = np.stack(np.meshgrid(np.arange(20), np.arange(20), [0]), axis=-1).reshape(-1, 3) * 0.01
    points = np.concatenate([grid, [[0.1, 0.1, 3.0]]])
    cloud = PointCloud(points, np.zeros(points.shape, dtype=np.uint8), np.ones(len(points), dtype=np.int32))
    assert without_outliers(cloud, CloudSettings()).points[:, 2].max() == 0.0
    assert len(without_outliers(cloud, CloudSettings())) >= 396  # the corners of a square have fewer neighbours


@pytest.mark.parametrize(
    ("arguments", "error", "message"),
    [
        ({"cameras": ["cam_top"]}, SequenceError, "reef has no camera 'cam_top'; its cameras: cam"),
        ({"source": "echoes"}, SequenceError, "reef has neither DVL, altimeter nor imaging sonar"),
        ({"source": "guesses"}, SequenceError, "expected one of images, echoes, got 'guesses'"),
    ],
)
def test_what_cannot_be_made_is_named(arguments, error, message):
    reef = Reef(MONO)
    with pytest.raises(error, match=message):
        build_cloud(reef, reef.truth(), **arguments)


def test_a_trajectory_of_another_time_and_a_length_of_nothing_are_named():
    reef = Reef(MONO)
    late = replace(reef.truth(), stamps_ns=reef.truth().stamps_ns + 10**12)
    with pytest.raises(TrajectoryError, match=r"expected a trajectory of reef, from 1000000000\.000 to 1000000004"):
        build_cloud(reef, late)
    with pytest.raises(OysterbenchError, match="voxel_m: expected more than 0 m, got 0"):
        CloudSettings(voxel_m=0.0)
    with pytest.raises(OysterbenchError, match="far_m: expected a finite number, got inf"):
        CloudSettings(far_m=float("inf"))


def test_poses_by_which_gravity_would_not_pull_down_are_refused(dive_file):
    opened = oysterbench.open(dive_file)
    truth = opened.truth()
    check_upright(opened, truth)
    w_first = replace(truth, quaternions=np.roll(truth.quaternions, 1, axis=1))
    with pytest.raises(TrajectoryError, match=r"deg from upright .* order w x y z: give --quaternion wxyz"):
        check_upright(opened, w_first)
    name, camera = next(iter(opened.cameras.items()))
    of_camera = poses_of_frame(truth, camera.T_base_cam)
    with pytest.raises(TrajectoryError, match=rf"they look like poses of {name}: give --T-body-estimate=") as caught:
        check_upright(opened, of_camera)
    place = np.array(str(caught.value).rpartition("=")[2].split(","), dtype=float)
    assert place[:3] == pytest.approx(camera.T_base_cam[:3, 3], abs=1e-5)
    lying = Rotation.from_euler("y", 40, degrees=True) * Rotation.from_quat(truth.quaternions)
    with pytest.raises(TrajectoryError, match=r"in a world whose z points up$"):
        check_upright(opened, replace(truth, quaternions=lying.as_quat()))


def test_the_true_path_is_called_truth_and_a_file_is_read_as_said(dive_file, tmp_path):
    truth = oysterbench.open(dive_file).truth()
    write_tum(tmp_path / "poses.tum", truth)
    lines = [line for line in (tmp_path / "poses.tum").read_text().splitlines() if not line.startswith("#")]
    swapped = [" ".join([*words[:4], words[7], *words[4:7]]) for words in map(str.split, lines)]
    (tmp_path / "w.tum").write_text("\n".join(swapped))
    found = []
    for name, more in (("truth", ()), (tmp_path / "w.tum", ("--quaternion", "wxyz"))):
        words = [COMMAND, "map", dive_file, "--trajectory", name, "--from", "echoes", "--json", *more]
        done = subprocess.run([*words, "--out", tmp_path / "a.ply"], capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stderr
        assert ("the true path is used" in done.stderr) == (name == "truth")
        found.append({**json.loads(done.stdout), "cpu_s": 0})
    assert found[0] == found[1]


def test_the_command_writes_a_cloud_and_says_how_large_it_is(dive_file, tmp_path):
    write_tum(tmp_path / "poses.tum", oysterbench.open(dive_file).truth())
    along = ["--trajectory", tmp_path / "poses.tum", "--from", "echoes", "--voxel", "0.05"]
    words = [COMMAND, "map", dive_file, *along, "--json"]
    done = subprocess.run([*words, "--out", tmp_path / "a.ply"], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    facts = json.loads(done.stdout)
    assert facts["points"] == len(read_ply(tmp_path / "a.ply")) > 50
    refused = subprocess.run([*words, "--out", tmp_path / "a.xyz"], capture_output=True, text=True, check=False)
    assert refused.returncode == 1
    assert "expected the name of a .ply file" in refused.stderr
