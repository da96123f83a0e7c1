"""Monocular or stereo visual odometry: a pose for each frame from landmarks, landmarks at each keyframe from poses."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from oysterbench.core.geometry import Array
from oysterbench_baselines.visual_only.settings import VisualOnlySettings
from oysterbench_baselines.visual_only.views import (
    point_from_views,
    pose_from_points,
    ray_angle,
    relative_poses,
    reprojection_errors,
    view_errors,
)

SAME_TURN_RAD, SAME_SWING_RAD = np.radians(3.0), np.radians(20.0)
"""Motions that differ by less are taken for estimates of one: the false one of a plane differs more from the true."""

MatchRight = Callable[[float | None], tuple[NDArray[np.int64], Array]]
"""Function from the depth to start at, m, to ids (M,) and rays (M, 2) in the right camera of tracks of the frame."""


@dataclass
class Landmark:
    """A track as keyframes saw it: poses T_map_cam (4, 4) and rays (2,); and its point (3,) in the map, once known."""

    poses: list[Array] = field(default_factory=list)
    rays: list[Array] = field(default_factory=list)
    point: Array | None = None

    def see(self, T_map_cam: Array, ray: Array, most: int) -> None:
        """Add a view; of more than `most`, drop the oldest."""
        self.poses, self.rays = [*self.poses, T_map_cam][-most:], [*self.rays, ray][-most:]


@dataclass(frozen=True)
class Frame:
    """What a frame shows: ids (N,) of tracks and their rays (N, 2)."""

    stamp_ns: int
    ids: NDArray[np.int64]
    rays: Array

    def of(self, ids: NDArray[np.int64]) -> Array:
        """Rays (M, 2) of some tracks; the frame's ids must be sorted."""
        return self.rays[np.searchsorted(self.ids, ids)]


@dataclass(frozen=True)
class Located:
    """T_map_cam (4, 4) of a frame, how many landmarks agree on it, and the sum of their squared errors."""

    T_map_cam: Array
    landmarks: int
    squares: float


@dataclass(frozen=True)
class Start:
    """A first map: landmarks by track, poses T_map_cam by stamp of the frames so far, and the mean squared error of
    their tracks, in which those that fit no landmark, or no pose, count with the greatest error that is accepted."""

    motion: Array  # T_first_last (4, 4) that it was made from
    landmarks: dict[int, Landmark]
    poses: dict[int, Array]
    points: int
    error: float


@dataclass(frozen=True)
class Farewell:
    """Where a map was last seen from: stamp, T_map_cam (4, 4), and the camera's velocity (3,) then, per second."""

    stamp_ns: int
    T_map_cam: Array
    velocity: Array

    def guess(self, stamp_ns: int) -> Array:
        """Predict T_map_cam (4, 4) at a later stamp: same attitude, same velocity."""
        T_map_cam = self.T_map_cam.copy()
        T_map_cam[:3, 3] += self.velocity * (stamp_ns - self.stamp_ns) * 1e-9
        return T_map_cam

    def scale_of(self, poses: dict[int, Array]) -> float:
        """Factor on the unit of a new map that makes its camera as fast; one where either stands still."""
        first, last = min(poses), max(poses)
        way = float(np.linalg.norm(poses[last][:3, 3] - poses[first][:3, 3]))
        wanted = float(np.linalg.norm(self.velocity)) * (last - first) * 1e-9
        return wanted / way if wanted > 0 and way > 0 else 1.0


def are_different(first: Array, second: Array) -> bool:
    """Whether two motions (4, 4) with translations of length one are more than estimates of one."""
    turn = np.arccos(np.clip((np.trace(first[:3, :3].T @ second[:3, :3]) - 1) / 2, -1, 1))
    swing = np.arccos(np.clip(first[:3, 3] @ second[:3, 3], -1, 1))
    return bool(turn > SAME_TURN_RAD or swing > SAME_SWING_RAD)


class Odometry:
    """Poses T_map_cam of one camera, `map` being where it was in the first frame of the map.

    focal_px turns the settings' pixels into rays. T_left_right (4, 4): the other camera of a stereo pair, which gives
    the map its scale; without one the median depth at the start is taken as `start_depth_m`.

    A map that is not seen for `begin_again_s` is given up for a new one, which is placed where the camera would be had
    it moved on as before; without a second camera, in a unit in which it is as fast as before. That is a guess, and all
    that a camera can say about the time in which it saw nothing.
    """

    def __init__(self, settings: VisualOnlySettings, focal_px: float, T_left_right: Array | None = None) -> None:
        self.settings = settings
        self.T_left_right = T_left_right
        self.poses: dict[int, Array] = {}  # stamp, ns -> T_map_cam
        self.lost_ns: int | None = None
        self.key_frames = 0
        self.maps = 0
        self._farewell: Farewell | None = None  # from the map before this one
        self._px = 1.0 / focal_px
        self._landmarks: dict[int, Landmark] = {}
        self._waiting: list[Frame] = []  # frames before there is a map
        self._key: Frame | None = None
        self._known_at_key = 0

    def add(self, frame: Frame, match_right: MatchRight | None = None) -> Array | None:
        """Add the next frame and return its pose; None as long as there is no map, or it is no longer seen."""
        if self.key_frames == 0:
            self._start(frame, match_right)
            return self.poses.get(frame.stamp_ns)
        found = self._locate(frame)
        if found is None:
            if self.lost_ns is None:
                self.lost_ns = frame.stamp_ns
            if frame.stamp_ns - max(self.poses) <= self.settings.begin_again_s * 1e9:
                return None
            self._give_up()
            self._start(frame, match_right)
            return self.poses.get(frame.stamp_ns)
        self.lost_ns = None
        self.poses[frame.stamp_ns] = found.T_map_cam
        if self._is_key(frame, found.landmarks):
            self._add_key(frame, found.T_map_cam, match_right)
        return found.T_map_cam

    @property
    def landmarks(self) -> Array:
        """Points (L, 3) of the map whose tracks are alive."""
        return np.array([mark.point for mark in self._landmarks.values() if mark.point is not None]).reshape(-1, 3)

    def _start(self, frame: Frame, match_right: MatchRight | None) -> None:
        """Start a map: at once with stereo, after enough parallax without."""
        if self.T_left_right is not None:
            if match_right is not None:
                T_map_cam = np.eye(4) if self._farewell is None else self._farewell.guess(frame.stamp_ns)
                self._add_key(frame, T_map_cam, match_right)
                if len(self.landmarks) < self.settings.start_min_points:
                    self.key_frames, self._landmarks = 0, {}
                else:
                    self.poses[frame.stamp_ns] = T_map_cam
                    self._begun()
            return
        self._waiting.append(frame)
        first = self._waiting[0]
        common = np.intersect1d(first.ids, frame.ids)
        if len(common) < self.settings.start_min_points:
            self._waiting = [frame]
            return
        before, after = first.of(common), frame.of(common)
        if np.median(np.linalg.norm(after - before, axis=1)) < self.settings.start_parallax_px * self._px:
            return
        motions = relative_poses(before, after, self.settings.essential_error_px * self._px)
        maps = sorted(
            (start for T_first_now in motions if (start := self._map_of(first, frame, T_first_now)) is not None),
            key=lambda start: start.error,
        )
        if not maps or maps[0].points < self.settings.start_min_points:
            return
        # Two views of a plane allow for two motions; which is true shows in the frames between, or in later ones.
        rivals = [start for start in maps[1:] if are_different(start.motion, maps[0].motion)]
        if all(rival.error > self.settings.start_margin * maps[0].error for rival in rivals):
            self._take(maps[0], frame)

    def _map_of(self, first: Frame, last: Frame, T_first_last: Array) -> Start | None:
        """Build the map of two views; None where it is too small or the frames between them do not fit it."""
        settings = self.settings
        common = np.intersect1d(first.ids, last.ids)
        self._landmarks = {}
        self._see(first, np.eye(4))
        self._see(last, T_first_last)
        # Regardless of the angle: a point too far away to be used still reveals a false motion.
        self._triangulate(last, 0.0)
        points = self.landmarks
        if len(points) < settings.start_min_points or np.median(points[:, 2]) <= 0:
            return None
        self._scale(settings.start_depth_m / float(np.median(points[:, 2])))
        poses, errors = {}, []
        worst = (settings.pose_error_px * self._px) ** 2
        for frame in self._waiting:
            found = self._locate(frame, drop=False)
            tracks = len(np.intersect1d(frame.ids, common))
            if found is not None:
                poses[frame.stamp_ns] = found.T_map_cam
                errors.append((found.squares + worst * (tracks - found.landmarks)) / tracks)
            else:
                errors.append(worst)
        if last.stamp_ns not in poses or len(poses) < settings.start_agreement * len(self._waiting):
            return None
        self._forget_far(settings.min_ray_angle_deg)
        return Start(T_first_last, self._landmarks, poses, len(self.landmarks), float(np.mean(errors)))

    def _take(self, start: Start, last: Frame) -> None:
        """Continue from a map."""
        self._landmarks, poses = start.landmarks, start.poses
        if self._farewell is not None:
            factor, T_map_first = self._farewell.scale_of(poses), self._farewell.guess(min(poses))
            self._scale(factor)
            self._move(T_map_first)
            poses = {stamp: T_map_first @ _scaled(T, factor) for stamp, T in poses.items()}
        self.poses |= poses
        self.key_frames, self._key, self._waiting = 2, last, []
        self._known_at_key = len(self.landmarks)
        self._begun()

    def _begun(self) -> None:
        self.maps, self.lost_ns = self.maps + 1, None

    def _give_up(self) -> None:
        """Give up this map for a new one, and remember where it was last seen from."""
        stamps = sorted(self.poses)
        last = stamps[-1]
        before = next((stamp for stamp in reversed(stamps) if last - stamp > self.settings.speed_s * 1e9), stamps[0])
        moved = self.poses[last][:3, 3] - self.poses[before][:3, 3]
        velocity = moved / ((last - before) * 1e-9) if last > before else np.zeros(3)
        self._farewell = Farewell(last, self.poses[last], velocity)
        self.key_frames, self._key, self._landmarks, self._waiting = 0, None, {}, []

    def _scale(self, factor: float) -> None:
        for mark in self._landmarks.values():
            mark.poses = [_scaled(T, factor) for T in mark.poses]
            mark.point = None if mark.point is None else factor * mark.point

    def _move(self, T: Array) -> None:
        for mark in self._landmarks.values():
            mark.poses = [T @ pose for pose in mark.poses]
            mark.point = None if mark.point is None else T[:3, :3] @ mark.point + T[:3, 3]

    def _locate(self, frame: Frame, drop: bool = True) -> Located | None:
        """Locate a frame by the landmarks that it sees; None where too few agree on a pose.

        drop: give up those that do not agree: their tracks have slid off their points, or they move.
        """
        settings = self.settings
        marks = [self._landmarks.get(int(track)) for track in frame.ids]
        known = np.array([mark is not None and mark.point is not None for mark in marks], dtype=bool)
        ids = frame.ids[known]
        points = np.array([mark.point for mark in marks if mark is not None and mark.point is not None]).reshape(-1, 3)
        found = pose_from_points(points, frame.rays[known], settings.pose_error_px * self._px, settings.pose_trials)
        if found is None:
            return None
        T_map_cam, agree = found
        if agree.sum() < max(settings.min_inliers, settings.min_inlier_share * len(agree)):
            return None
        if drop:
            for track in ids[~agree]:
                del self._landmarks[int(track)]
        errors = reprojection_errors(points[agree], T_map_cam, frame.rays[known][agree])
        return Located(T_map_cam, len(errors), float(np.sum(errors**2)))

    def _is_key(self, frame: Frame, known: int) -> bool:
        assert self._key is not None
        common = np.intersect1d(self._key.ids, frame.ids)
        if len(common) < self.settings.min_inliers or known < self.settings.key_share * self._known_at_key:
            return True
        moved = np.linalg.norm(frame.of(common) - self._key.of(common), axis=1)
        return float(np.median(moved)) > self.settings.key_parallax_px * self._px

    def _add_key(self, frame: Frame, T_map_cam: Array, match_right: MatchRight | None) -> None:
        """Record what a keyframe sees, and fit all landmarks in it to their views."""
        depth = self._median_depth(T_map_cam)
        self._see(frame, T_map_cam)
        if match_right is not None and self.T_left_right is not None:
            ids, rays = match_right(depth)
            for track, ray in zip(ids, rays, strict=True):
                # The right view counts as one more of the same landmark: a base of known length.
                mark = self._landmarks[int(track)]
                mark.see(T_map_cam @ self.T_left_right, ray, self.settings.max_views)
        one = self.T_left_right is None
        self._triangulate(frame, self.settings.min_ray_angle_deg if one else self.settings.stereo_min_angle_deg)
        live = set(frame.ids.tolist())
        self._landmarks = {track: mark for track, mark in self._landmarks.items() if track in live}
        self._key = frame
        self._known_at_key = len(self.landmarks)
        self.key_frames += 1

    def _median_depth(self, T_map_cam: Array) -> float | None:
        points = self.landmarks
        return float(np.median((points - T_map_cam[:3, 3]) @ T_map_cam[:3, 2])) if len(points) else None

    def _see(self, frame: Frame, T_map_cam: Array) -> None:
        for track, ray in zip(frame.ids.tolist(), frame.rays, strict=True):
            self._landmarks.setdefault(track, Landmark()).see(T_map_cam, ray, self.settings.max_views)

    def _forget_far(self, angle_deg: float) -> None:
        """Discard points whose rays meet at less than an angle."""
        for mark in self._landmarks.values():
            if mark.point is not None and ray_angle(np.array(mark.poses), mark.point) < np.radians(angle_deg):
                mark.point = None

    def _triangulate(self, frame: Frame, angle_deg: float) -> None:
        """Triangulate the tracks of a keyframe from all their views, where the rays meet at such an angle; those that
        do not fit start anew."""
        settings = self.settings
        for track in frame.ids.tolist():
            mark = self._landmarks[track]
            if len(mark.poses) < 2:
                continue
            poses, rays = np.array(mark.poses), np.array(mark.rays)
            point = point_from_views(poses, rays)
            if point is None or ray_angle(poses, point) < np.radians(angle_deg):
                continue
            if view_errors(point, poses, rays).max() < settings.landmark_error_px * self._px:
                mark.point = point
            else:
                # Started anew from its last view: the track has slid, or one of the poses was wrong.
                self._landmarks[track] = Landmark([mark.poses[-1]], [mark.rays[-1]])


def _scaled(T: Array, factor: float) -> Array:
    """Convert a pose (4, 4) to another unit."""
    return np.block([[T[:3, :3], factor * T[:3, 3:]], [T[3:]]])
