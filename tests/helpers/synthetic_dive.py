"""A dive without images: a smooth path over a cloud of points, its inertial samples, and tracks of the points."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from oysterbench.core.geometry import Array, invert, transform
from oysterbench.core.trajectory import Trajectory
from oysterbench.sequence.types import CameraCalibration, ImuCalibration, ImuMeasurement

START_NS = 1_700_000_000_000_000_000
GRAVITY = 9.80665


def survey_pose(t: Array) -> Array:
    """(N, 4, 4) T_map_base of a vehicle on a loop of 2.2 m radius at 0.5 m/s, 1 m over the bottom, hovering gently."""
    angle = 0.5 * t / 2.2
    radius = 2.2 + 0.15 * np.sin(2 * angle + 0.4) + 0.06 * np.sin(2 * np.pi * 0.21 * t)
    along = angle + 0.03 * np.sin(2 * np.pi * 0.17 * t + 1.0)
    z = -3.0 + 0.06 * np.sin(2 * np.pi * 0.27 * t + 0.5) + 0.08 * np.sin(1.5 * angle)
    yaw = along + np.pi / 2 + np.radians(4) * np.sin(2 * np.pi * 0.13 * t)
    pitch = np.radians(3) * np.sin(2 * np.pi * 0.23 * t + 0.7)
    roll = np.radians(3) * np.sin(2 * np.pi * 0.31 * t + 0.2)
    return poses_of(radius * np.cos(along), radius * np.sin(along), z, yaw, pitch, roll)


def resting_start_pose(t: Array) -> Array:
    """The same after two seconds at rest."""
    moving = np.maximum(t - 2.0, 0.0)
    return survey_pose(moving**2 / (moving + 1.5))


def poses_of(x: Array, y: Array, z: Array, yaw: Array, pitch: Array, roll: Array) -> Array:
    poses = np.zeros((len(x), 4, 4))
    poses[:, :3, :3] = Rotation.from_euler("ZYX", np.column_stack([yaw, pitch, roll])).as_matrix()
    poses[:, :3, 3] = np.column_stack([x, y, z])
    poses[:, 3, 3] = 1.0
    return poses


def camera_calibration() -> CameraCalibration:
    focal = 320 / np.tan(np.radians(69 / 2))
    optical = np.array([[0.0, 0, 1], [-1, 0, 0], [0, -1, 0]])  # optical axes in a camera that looks forward
    tilt = Rotation.from_euler("y", 30, degrees=True).as_matrix()
    matrix = np.array([[focal, 0, 319.5], [0, focal, 239.5], [0, 0, 1]])
    return CameraCalibration(640, 480, 20.0, matrix, np.zeros(4), transform(tilt @ optical, [0.18, 0, -0.02]))


def right_calibration() -> CameraCalibration:
    """A second camera, 12 cm to the right of the first."""
    first = camera_calibration()
    return dataclasses.replace(first, T_base_cam=first.T_base_cam @ transform(np.eye(3), [0.12, 0, 0]))


def imu_calibration() -> ImuCalibration:
    """The unit of the rig bluerov2."""
    return ImuCalibration(
        200.0, 6.98e-5, 2.0e-5, 5.0e-3, 9.81e-4, 1.0e-4, 5.0e-2, GRAVITY, transform(np.eye(3), [-0.05, 0.02, 0.03])
    )


@dataclass(frozen=True)
class Dive:
    """stamps_ns (F,) of the frames; tracks: per frame ids (N,) and pixels (N, 2); truth T_map_base at the frames.

    right: per frame pixels (N, 2) of the same in `right_calibration()`'s picture, NaN outside it.
    """

    camera: CameraCalibration
    inertial: ImuCalibration
    samples: list[ImuMeasurement]
    stamps_ns: np.ndarray
    tracks: list[tuple[np.ndarray, Array]]
    truth: Trajectory
    right: list[Array]

    def stream(self) -> Iterator[ImuMeasurement | tuple[int, np.ndarray, Array]]:
        """Samples and frames in time order, samples first at one stamp."""
        waiting = iter(self.samples)
        sample = next(waiting, None)
        for stamp, (ids, pixels) in zip(self.stamps_ns, self.tracks, strict=True):
            while sample is not None and sample.stamp_ns <= stamp:
                yield sample
                sample = next(waiting, None)
            yield int(stamp), ids, pixels


def make_dive(
    seed: int,
    duration_s: float = 20.0,
    pose: Callable[[Array], Array] = survey_pose,
    pixel_noise: float = 0.4,
    noisy_imu: bool = True,
    blind: tuple[float, float] = (np.inf, np.inf),
    outliers: float = 0.01,
    most: int = 130,
    silt_s: float = 0.0,
) -> Dive:
    """A dive. blind: seconds in which the camera sees nothing. outliers: share of tracks that slide over the scene.
    most: tracks at a time. silt_s: until when all that is seen swirls as one, by 12 cm every 2.5 s.
    """
    generator = np.random.default_rng(seed)
    camera, inertial = camera_calibration(), imu_calibration()
    samples = inertial_samples(pose, inertial, duration_s, generator if noisy_imu else None)
    times = np.arange(0, duration_s + 1e-9, 1 / camera.rate_hz)
    stamps = START_NS + np.round(times * 1e9).astype(np.int64)
    poses = pose(times)
    points = generator.uniform([-7, -7, 0], [7, 7, 1], size=(6000, 3))
    points[:, 2] = -4.0 + 0.15 * np.sin(1.3 * points[:, 0]) * np.cos(1.7 * points[:, 1]) + 0.12 * points[:, 2] ** 2
    seen = list(
        _follow(points, _beside(poses, times, silt_s), times, camera, pixel_noise, blind, outliers, generator, most)
    )
    tracks = [(ids, pixels) for ids, pixels, _ in seen]
    noise = np.random.default_rng(seed + 1000)  # of its own: one camera sees the same with and without a second
    right = [
        _seen_by(right_calibration(), points[rows], T_map_base, pixel_noise, noise)
        for T_map_base, (_, _, rows) in zip(poses, seen, strict=True)
    ]
    quaternions = Rotation.from_matrix(poses[:, :3, :3]).as_quat()
    truth = Trajectory(stamps, poses[:, :3, 3].copy(), quaternions)
    return Dive(camera, inertial, samples, stamps, tracks, truth, right)


def _beside(poses: Array, times: Array, silt_s: float) -> Array:
    """Poses from which the scene at rest looks as what swirls does from the true ones."""
    angle = np.where(times < silt_s, 2 * np.pi * times / 2.5, 0.0)
    beside = poses.copy()
    beside[:, :2, 3] += 0.12 * np.column_stack([np.sin(angle), 1 - np.cos(angle)])
    return beside


def _seen_by(camera: CameraCalibration, points: Array, T_map_base: Array, noise: float, generator) -> Array:
    """Noisy pixels (N, 2) of points (N, 3); NaN where they are not in the picture."""
    seen = points @ invert(T_map_base @ camera.T_base_cam)[:3, :3].T + invert(T_map_base @ camera.T_base_cam)[:3, 3]
    pixels = (seen / np.maximum(seen[:, 2:], 1e-3) @ camera.matrix.T)[:, :2]
    pixels += generator.normal(size=pixels.shape) * noise
    inside = (pixels > 5).all(axis=1) & (pixels < [camera.width - 6, camera.height - 6]).all(axis=1)
    inside &= seen[:, 2] > 0.3
    return np.where(inside[:, None], pixels, np.nan)


def inertial_samples(
    pose: Callable[[Array], Array],
    calibration: ImuCalibration,
    duration_s: float,
    generator: np.random.Generator | None,
) -> list[ImuMeasurement]:
    """Samples at the instants k / rate; with a generator, the unit's turn-on biases, random walks and white noise."""
    return list(inertial_stream(pose, calibration, duration_s, generator))


def inertial_stream(
    pose: Callable[[Array], Array],
    calibration: ImuCalibration,
    duration_s: float,
    generator: np.random.Generator | None,
) -> Iterator[ImuMeasurement]:
    """The same samples one by one: as objects, those of half an hour take 200 MB."""
    rate = calibration.rate_hz
    times = np.arange(0, duration_s + 1e-9, 1 / rate)
    h = 1e-3
    T_base_imu = calibration.T_base_imu
    before, now, after = (pose(times + offset) @ T_base_imu for offset in (-h, 0.0, h))
    acceleration = (before[:, :3, 3] - 2 * now[:, :3, 3] + after[:, :3, 3]) / h**2
    force = np.einsum("nji,nj->ni", now[:, :3, :3], acceleration + np.array([0, 0, calibration.gravity]))
    turn = np.einsum("nji,njk->nik", before[:, :3, :3], after[:, :3, :3])
    gyro = Rotation.from_matrix(turn).as_rotvec() / (2 * h)
    if generator is not None:
        n = len(times)
        for signal, density, walk, turn_on in (
            (gyro, calibration.gyro_noise_density, calibration.gyro_random_walk, calibration.gyro_turn_on),
            (force, calibration.accel_noise_density, calibration.accel_random_walk, calibration.accel_turn_on),
        ):
            signal += generator.normal(size=3) * turn_on
            signal += np.cumsum(generator.normal(size=(n, 3)), axis=0) * walk / np.sqrt(rate)
            signal += generator.normal(size=(n, 3)) * density * np.sqrt(rate)
    stamps = START_NS + np.round(times * 1e9).astype(np.int64)
    return (ImuMeasurement(int(s), g.copy(), f.copy()) for s, g, f in zip(stamps, gyro, force, strict=True))


def _track(*arguments, **keywords):
    """Per frame, ids and noisy pixels of the points followed."""
    return ((ids, pixels) for ids, pixels, _ in _follow(*arguments, **keywords))


def _follow(points, poses, times, camera, pixel_noise, blind, outliers, generator, most, life_s=2.5):
    """Per frame, ids, noisy pixels and rows of the points followed: white noise, a slow drift, loss after a random
    time."""
    live: dict[int, list] = {}  # point -> [track id, drift, slide]
    next_id = 0
    for t, T_map_base in zip(times, poses, strict=True):
        seen = points @ np.linalg.inv(T_map_base @ camera.T_base_cam)[:3, :3].T
        seen += invert(T_map_base @ camera.T_base_cam)[:3, 3]
        pixels = (seen / np.maximum(seen[:, 2:], 1e-3)) @ camera.matrix.T
        visible = (seen[:, 2] > 0.3) & (seen[:, 2] < 4.5) & (pixels[:, 0] > 5) & (pixels[:, 0] < 634)
        visible &= (pixels[:, 1] > 5) & (pixels[:, 1] < 474)
        if blind[0] <= t < blind[1]:
            visible[:] = False
        live = {p: s for p, s in live.items() if visible[p] and generator.random() > 1 / (life_s * camera.rate_hz)}
        free = [p for p in generator.permutation(np.flatnonzero(visible)) if p not in live]
        for p in free[: most - len(live)]:
            slide = generator.normal(size=2) * 2.0 if generator.random() < outliers else np.zeros(2)
            live[p] = [next_id, np.zeros(2), slide]
            next_id += 1
        ids, rows, which = [], [], []
        for p, state in live.items():
            which.append(p)
            state[1] = state[1] + generator.normal(size=2) * 0.02 + state[2]
            ids.append(state[0])
            rows.append(pixels[p, :2] + state[1] + generator.normal(size=2) * pixel_noise)
        order = np.argsort(ids)
        points_of = np.array(which, dtype=np.int64)
        yield np.array(ids, dtype=np.int64)[order], np.array(rows).reshape(-1, 2)[order], points_of[order]
