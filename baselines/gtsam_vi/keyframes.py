"""From tracks to keyframes: which landmark a track shows, what makes a keyframe, and when the vehicle is at rest."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from oysterbench.core.geometry import Array
from oysterbench_baselines.common.filter import VELOCITY, InvariantFilter
from oysterbench_baselines.common.inertial import Segment, relative_rotation
from oysterbench_baselines.gtsam_vi.cameras import CameraRig
from oysterbench_baselines.gtsam_vi.flow import homogeneous
from oysterbench_baselines.gtsam_vi.frontend import Observations
from oysterbench_baselines.gtsam_vi.graph import Model
from oysterbench_baselines.gtsam_vi.settings import GtsamViSettings


class DataAssociation:
    """Association of tracks with landmarks, and how far tracks are to be trusted.

    A track follows what looks the same from one frame to the next, and on relief one corner turns into another as it is
    passed: on an orbit over shells, tracks live for a minute and slide over them by tens of pixels, so smoothly that no
    single step gives it away. A track seen from a different side than at first is therefore another landmark.
    """

    def __init__(self, settings: GtsamViSettings, R_imu_cam: Array) -> None:
        self._settings, self._R_imu_cam = settings, R_imu_cam
        self._R_start_imu = np.eye(3)
        self._count = 0
        # Of the last frame's tracks: ids (N,), landmarks (N,), and directions (N, 3) of the landmarks' first rays.
        self._ids = self._landmarks = np.empty(0, dtype=np.int64)
        self._first = np.empty((0, 3))
        self._kept: list[float] = []  # share of the tracks kept by each frame since the last keyframe

    def landmarks(self, ids: NDArray[np.int64], rays: Array, segment: Segment, gyro_bias: Array) -> NDArray[np.int64]:
        """Landmarks (N,) of the next frame's tracks, ids (N,) and rays (N, 2); segment: measurements since the last."""
        self._R_start_imu = self._R_start_imu @ relative_rotation(segment, gyro_bias)
        if len(ids) == 0:
            return ids
        _, before, now = np.intersect1d(self._ids, ids, assume_unique=True, return_indices=True)
        if len(self._ids):
            self._kept.append(len(before) / len(self._ids))
        directions = homogeneous(rays) @ (self._R_start_imu @ self._R_imu_cam).T
        directions /= np.linalg.norm(directions, axis=1)[:, None]
        landmarks, first = np.zeros(len(ids), dtype=np.int64), np.zeros((len(ids), 3))
        landmarks[now], first[now] = self._landmarks[before], self._first[before]
        new = (first * directions).sum(axis=1) < np.cos(np.radians(self._settings.landmarks.max_turn_deg))
        new |= ~first.any(axis=1)  # tracks that were not there before
        landmarks[new], first[new] = self._count + np.arange(np.count_nonzero(new)), directions[new]
        self._count += int(np.count_nonzero(new))
        self._ids, self._landmarks, self._first = ids, landmarks, first
        return landmarks

    def inflation(self) -> float:
        """Factor by which the tracks since the last call are less certain than usual: where light moves over the
        bottom, most are lost from frame to frame, and those that are left have been shifted by it."""
        noise, kept = self._settings.noise, max(float(np.mean(self._kept or [1.0])), 1e-3)
        self._kept = []
        return min(float(kept**-noise.loss_power), noise.max_inflation)


def is_keyframe(
    last: Observations, now: Observations, since: Segment, gyro_bias: Array, rig: CameraRig, settings: GtsamViSettings
) -> bool:
    """Whether there is enough parallax, or enough tracks lost or time passed since the last keyframe, for a new one."""
    limits = settings.keyframes
    if since.duration < limits.min_s:
        return False
    if since.duration >= limits.max_s:
        return True
    shared, in_last, in_now = np.intersect1d(last.ids, now.ids, assume_unique=True, return_indices=True)
    if len(shared) < limits.shared * len(last.ids):
        return True
    if len(shared) == 0:
        return False
    R_imu_cam = rig.T_imu_cam[:3, :3]
    turn = R_imu_cam.T @ relative_rotation(since, gyro_bias) @ R_imu_cam
    return parallax(last.rays[in_last], now.rays[in_now], turn) * rig.focal >= limits.parallax_px


def parallax(before: Array, after: Array, R_before_after: Array) -> float:
    """Median flow, at depth 1, between rays (N, 2) and (N, 2) that a rotation does not explain."""
    turned = homogeneous(before) @ R_before_after
    flow = after - turned[:, :2] / np.maximum(turned[:, 2:], 0.1)
    return float(np.median(np.linalg.norm(flow, axis=1)))


def is_stationary(before: Observations, after: Observations, segment: Segment, gyro_bias: Array, model: Model) -> bool:
    """Zero-velocity detection: whether neither image nor gyroscope has moved over a segment.

    The image is judged by the affine flow that fits all tracks: their own noise averages out in it, and motion in any
    direction or about any axis shows. Where nothing but silt, a veil or the port is visible, it stands still while the
    vehicle turns.
    """
    rig, settings = model.rig, model.settings
    shared, in_before, in_after = np.intersect1d(before.ids, after.ids, assume_unique=True, return_indices=True)
    if len(shared) < settings.initialisation.min_tracks or segment.duration < settings.zero_velocity.min_s:
        return False
    if has_turned(segment, gyro_bias, model.gyro_turn_on, settings.zero_velocity.flow_px / rig.focal):
        return False
    flow = (after.rays[in_after] - before.rays[in_before]) * rig.focal
    length = np.linalg.norm(flow, axis=1)
    calm = length <= 3 * np.median(length)
    places = homogeneous(before.rays[in_before][calm])
    fit = places @ np.linalg.lstsq(places, flow[calm], rcond=None)[0]
    return float(np.sqrt(np.mean(np.sum(fit**2, axis=1)))) < settings.zero_velocity.flow_px


def has_turned(segment: Segment, gyro_bias: Array, bias_sigma: float, least: float) -> bool:
    """Whether the vehicle has certainly turned by more than `least` rad over a segment; bias_sigma: of the gyro bias,
    rad/s."""
    turn = Rotation.from_matrix(relative_rotation(segment, gyro_bias)).magnitude()
    return bool(turn > 3 * bias_sigma * segment.duration + least)


def is_under_way(filter: InvariantFilter, settings: GtsamViSettings) -> bool:
    """Whether the vehicle is moving beyond doubt. Where nothing but a veil, silt or the port is visible, the image
    stands still while the vehicle moves."""
    of = settings.zero_velocity
    sigma = np.hypot(np.sqrt(np.trace(filter.covariance[VELOCITY, VELOCITY])), of.sigma)
    return bool(np.linalg.norm(filter.velocity) > of.speed_sigmas * sigma)
