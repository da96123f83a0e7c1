"""The estimator behind the front end: key frames, initialisation, fixed lag, final smoothing. It sees tracks only."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import gtsam
import numpy as np
from gtsam.symbol_shorthand import B, V, X
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from oysterbench.core.geometry import Array, invert
from oysterbench.core.trajectory import Trajectory
from oysterbench.methods import LandmarkMap
from oysterbench.sequence.types import CameraCalibration, ImuCalibration
from oysterbench_baselines.common.filter import CORE, VELOCITY, InertialNoise, InvariantFilter
from oysterbench_baselines.common.inertial import Segment, relative_rotation
from oysterbench_baselines.gtsam_vi.covariance import (
    FLOOR,
    anchored,
    carry,
    covariances_until,
    filter_covariance,
    filter_slopes,
    pose_covariances,
    set_state,
)
from oysterbench_baselines.gtsam_vi.frontend import Tracks
from oysterbench_baselines.gtsam_vi.graph import Bundle, Model
from oysterbench_baselines.gtsam_vi.initialisation import View, level_rotation
from oysterbench_baselines.gtsam_vi.loops import LoopCloser
from oysterbench_baselines.gtsam_vi.mapping import Palette, landmark_map
from oysterbench_baselines.gtsam_vi.motion import at_rest, parallax
from oysterbench_baselines.gtsam_vi.settings import Settings
from oysterbench_baselines.gtsam_vi.smoothing import smooth
from oysterbench_baselines.gtsam_vi.starting import find_start, is_metric, is_worth_a_try, scale_sigma
from oysterbench_baselines.gtsam_vi.states import (
    Frame,
    Keyframe,
    State,
    backward,
    coast,
    forward,
    hold,
    make_state,
    read_state,
)
from oysterbench_baselines.gtsam_vi.trackbook import TrackBook
from oysterbench_baselines.gtsam_vi.window import Window

Right = Callable[[], Array]
"""Looks for the tracks of a frame in the second camera's picture."""


@dataclass
class Estimator:
    """Takes frames of tracks, with the inertial measurements before each, in time order.

    right: a second camera that sees what the first sees.
    """

    camera: CameraCalibration
    imu: ImuCalibration
    settings: Settings
    right: CameraCalibration | None = None
    keyframes: list[Keyframe] = field(default_factory=list)
    frames: list[Frame] = field(default_factory=list)
    info: dict[str, float | int | str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.filter = InvariantFilter(
            np.eye(3), InertialNoise.of(self.imu, self.settings.imu_inflation), self.imu.gravity
        )
        self.model = Model(self.camera, self.imu, self.settings, self.right)
        self._window: Window | None = None
        self._since: list[Segment] = []
        self._book = TrackBook(self.settings, self.model.T_imu_cam[:3, :3])
        self._landmarks = np.empty(0, dtype=np.int64)  # of the last frame's tracks
        self._next_attempt_s = 0.0
        self._first = 0  # key frame at which the search for a start begins
        self._anchor: State | None = None  # its state, when there was a start before
        self._good: tuple[int, State] | None = None  # the last key frame at which all was well, and its state then
        self._anchor_covariance: Array | None = None  # (6, 6) of that pose
        self._bad_keyframes = 0
        self.loops = LoopCloser(self.camera, self.model, self.settings) if self.settings.loops else None
        self.palette = Palette()
        self._adjusted: tuple[list[Keyframe], Bundle] | None = None  # of the final smoothing

    @property
    def gyro_bias(self) -> Array:
        """Latest estimate (3,) rad/s; zero before there is one."""
        return self.keyframes[-1].state.bias.gyroscope() if self._window else np.zeros(3)

    def add_frame(
        self, stamp_ns: int, segment: Segment, ids: NDArray[np.int64], rays: Array, right: Right | None = None
    ) -> None:
        """The next frame: measurements since the last one, and tracks: ids (N,) and undistorted rays (N, 2).

        right: gives rays (N, 2) of the second camera to the same, NaN where it does not see them; only key frames ask.
        """
        self._landmarks = self._book.landmarks(ids, rays, segment, self.gyro_bias)
        order = np.argsort(self._landmarks, kind="stable")
        view = View(self._landmarks[order], np.asarray(rays, dtype=float)[order])
        if self.keyframes:
            self._since.append(segment)
        if self._window is not None:
            self._carry(segment)
        predicted = self._predict()
        if self._is_keyframe(view):
            view = View(view.ids, view.rays, None if right is None else right()[order], self._book.spread())
            self._add_keyframe(stamp_ns, view, predicted)
            predicted = self.keyframes[-1].state if self._window else None
        frame = Frame(stamp_ns, self.keyframes[-1].index, Segment.join(self._since))
        frame.online = predicted.matrix if predicted else None
        if self._window is not None:
            place = (self.filter.pose @ invert(self.imu.T_base_imu))[:3, 3]
            frame.covariance = self.filter.pose_covariance(place) + FLOOR
        frame.correction = None if self.loops is None else self.loops.correction
        self.frames.append(frame)

    def look(self, picture: NDArray[np.uint8]) -> None:
        """The equalised picture (H, W) of the last frame: places are known again by those of key frames."""
        if self.loops is None:
            return
        if self.frames[-1].stamp_ns == self.keyframes[-1].stamp_ns:
            self.loops.add_keyframe(self.keyframes, picture)
        self.frames[-1].correction = self.loops.correction

    def paint(self, pixels: NDArray[np.uint8], tracks: Tracks) -> None:
        """The picture as it was taken, (H, W, 3) RGB or (H, W) grey, and the tracks of the last frame."""
        if self.frames[-1].stamp_ns == self.keyframes[-1].stamp_ns:
            self.palette.add(pixels, replace(tracks, ids=self._landmarks))

    def has_moved(self, segment: Segment) -> bool:
        """Whether the vehicle has certainly moved or turned over a segment: what repeats a picture is then no picture
        of now, but one that was stored."""
        settings = self.settings
        turn = Rotation.from_matrix(relative_rotation(segment, self.gyro_bias)).magnitude()
        if turn > 3 * self.model.gyro_turn_on * segment.duration + settings.repeat_px / self.model.focal:
            return True
        if self._window is None:
            return False
        sigma = np.sqrt(np.trace(self.filter.covariance[VELOCITY, VELOCITY]))
        return bool(np.linalg.norm(self.filter.velocity) > max(settings.repeat_speed, 5 * sigma))

    def _predict(self) -> State | None:
        return None if self._window is None else self._filter_state()

    def _filter_state(self) -> State:
        f = self.filter
        return make_state(f.rotation, f.position, f.velocity, f.gyro_bias, f.accel_bias)

    # The filter, which carries the window's estimate and its covariance from one key frame to the next.

    def _carry(self, segment: Segment) -> None:
        carry(self.filter, segment)

    def _correct_filter(self, window: Window) -> None:
        """The filter goes on from the window's estimate of the last key frame, with its covariance."""
        k, calibrations = self.keyframes[-1].index, self._calibrations()
        f, state = self.filter, self.keyframes[-1].state
        set_state(f, state)
        try:
            values, joint = window.joint([X(k), V(k), B(k), *calibrations])
        except RuntimeError:  # GTSAM: the system of equations cannot be solved
            return
        slopes = filter_slopes(state, k, len(f.covariance))
        for key, (rows, unit) in calibrations.items():
            slopes[key] = np.zeros((len(f.covariance), len(unit)))
            slopes[key][rows] = np.diag(unit)
        covariance = filter_covariance(joint, slopes)
        if covariance is None:
            return
        for key, (rows, unit) in calibrations.items():
            f.extra[rows.start - CORE : rows.stop - CORE] = unit * values.atVector(key)
        untold = np.setdiff1d(np.arange(len(covariance)), np.flatnonzero(np.hstack(list(slopes.values())).any(axis=1)))
        covariance[np.ix_(untold, untold)] = f.covariance[np.ix_(untold, untold)]
        f.covariance = covariance

    def _calibrations(self) -> dict[int, tuple[slice, Array]]:
        """Variables that filter and window share beside the state: rows of the filter's error, units (N,), by key."""
        return {}

    # Key frames.

    def _is_keyframe(self, view: View) -> bool:
        """Enough parallax, enough tracks lost, or enough time since the last key frame."""
        settings = self.settings
        if not self.keyframes:
            return True
        since = Segment.join(self._since)
        if since.duration < settings.keyframe_min_s:
            return False
        if since.duration >= settings.keyframe_max_s:
            return True
        last = self.keyframes[-1].view
        shared, in_last, in_view = np.intersect1d(last.ids, view.ids, assume_unique=True, return_indices=True)
        if len(shared) < settings.keyframe_shared * len(last.ids):
            return True
        if len(shared) == 0:
            return False
        turn = self.model.T_imu_cam[:3, :3].T @ relative_rotation(since, self.gyro_bias) @ self.model.T_imu_cam[:3, :3]
        return (
            parallax(last.rays[in_last], view.rays[in_view], turn) * self.model.focal >= settings.keyframe_parallax_px
        )

    def _add_keyframe(self, stamp_ns: int, view: View, predicted: State | None) -> None:
        segment = Segment.join(self._since)
        rest = bool(self.keyframes) and at_rest(self.keyframes[-1].view, view, segment.duration, self.model)
        self.keyframes.append(Keyframe(len(self.keyframes), stamp_ns, view, segment, rest))
        self._since = []
        if self._window is not None:
            self.keyframes[-1].aiding = self._aiding_of(len(self.keyframes) - 1, self.keyframes[-2].state)
            try:
                self._window.add(self.keyframes, predicted)
                diverged = self._has_diverged(self._window)
            except RuntimeError:  # GTSAM: the system of equations cannot be solved
                diverged = True
            if diverged:
                self._restart()
        else:
            self._try_to_start(self.settings.init_scale_sigma)
        if self._window is not None:
            self._correct_filter(self._window)

    def _aiding_of(self, k: int, before: State) -> list[gtsam.NonlinearFactor]:
        """Factors of other sensors for key frame k, `before` the state one earlier: here none."""
        return []

    # Initialisation.

    def _try_to_start(self, max_scale_sigma: float) -> None:
        """Search the latest key frames for a start; accept it when its scale is well determined."""
        stretch = self.keyframes[self._first :][-self.settings.init_max_keyframes :]
        now = (stretch[-1].stamp_ns - self.keyframes[0].stamp_ns) * 1e-9
        if now < self._next_attempt_s or not is_worth_a_try(stretch, self.settings):
            return
        self._next_attempt_s = now + self.settings.init_retry_s
        if self._anchor is not None and stretch[0].index > self._first:
            self._move_anchor(stretch[0])
        if self._anchor_covariance is not None:
            self.model.starts[stretch[0].index] = anchored(self._anchor_covariance)
        bundle = find_start(self.model, stretch, self._anchor, max_scale_sigma)
        if bundle is None:
            return
        if not is_metric(stretch, self.settings):
            self.info["init_scale_sigma"] = scale_sigma(bundle, stretch)
        self.info["init_error_px"] = float(np.median(bundle.errors_px))
        started = stretch[1:] if self._anchor else stretch
        for keyframe in started:
            keyframe.state = read_state(bundle.values, keyframe.index)
        try:
            self._window = Window(self.model, stretch, bundle, loose=self._anchor is not None)
        except RuntimeError:  # GTSAM: the system of equations cannot be solved
            for keyframe in started:
                keyframe.state = None
            return
        self.info["init_s"] = now
        self._good = (self.keyframes[-1].index, self.keyframes[-1].state)
        self._fill_back(stretch[0].index)
        known = covariances_until(bundle, self.keyframes, stretch, self.filter.noise, self.model)
        for frame in self.frames:
            if frame.covariance is None:
                frame.covariance = known[frame.keyframe]

    def _move_anchor(self, keyframe: Keyframe) -> None:
        """The search has gone on for longer than the stretch that it looks at: until `keyframe` the path coasts."""
        assert self._anchor is not None
        assert self._anchor_covariance is not None
        start_ns, state = self.keyframes[self._first].stamp_ns, self._anchor
        for passed in self.keyframes[self._first + 1 : keyframe.index + 1]:
            passed.state = coast(state, (passed.stamp_ns - start_ns) * 1e-9)
            passed.trusted = False
        self._anchor_covariance = self._coasted(self._anchor_covariance, (keyframe.stamp_ns - start_ns) * 1e-9)
        self.model.starts.pop(self._first, None)
        self._first, self._anchor = keyframe.index, keyframe.state

    def _fill_back(self, index: int) -> None:
        """States of the key frames before `index`, back along the inertial measurements; poses of all frames."""
        for k in range(index - 1, -1, -1):
            if self.keyframes[k].state is not None:
                break
            after = self.keyframes[k + 1]
            self.keyframes[k].state = hold(after.state) if after.at_rest else self._back(after.state, after.segment)
        for frame in self.frames:
            if frame.online is None:
                frame.online = forward(self.keyframes[frame.keyframe].state, frame.since, self.model.params).matrix

    def _back(self, state: State, segment: Segment) -> State:
        return backward(state, segment, self.imu.gravity)

    # Divergence.

    def _has_diverged(self, window: Window) -> bool:
        """Speed or biases beyond belief, or most landmarks far from where they were predicted, time and again."""
        settings, state = self.settings, self.keyframes[-1].state
        if not np.isfinite(state.matrix).all() or np.linalg.norm(state.nav.velocity()) > settings.max_speed:
            return True
        gyro = np.abs(state.bias.gyroscope()).max() / self.model.gyro_turn_on
        accel = np.abs(state.bias.accelerometer()).max() / self.model.accel_turn_on
        if window.lost_share > settings.max_lost_share:
            self._bad_keyframes += 1
        else:
            self._bad_keyframes = 0
        if max(gyro, accel) > settings.max_bias_sigmas or self._bad_keyframes >= settings.max_bad_keyframes:
            return True
        if self._bad_keyframes == 0:
            self._good = (self.keyframes[-1].index, state)
        return False

    def _restart(self) -> None:
        """Search for a start anew, from this key frame on.

        The measurements since the last good key frame are not to be trusted: the path goes on from there at the
        velocity it had, also for the frames whose poses have been given since.
        """
        self.info["restarts"] = int(self.info.get("restarts", 0)) + 1
        assert self._good is not None  # since the window began
        index, state = self._good
        stamp_ns = self.keyframes[index].stamp_ns
        covariance = next(frame.covariance for frame in self.frames if frame.stamp_ns == stamp_ns)
        for keyframe in self.keyframes[index:]:
            keyframe.state = coast(state, (keyframe.stamp_ns - stamp_ns) * 1e-9)
        for frame in self.frames:
            if frame.stamp_ns > stamp_ns:
                time = (frame.stamp_ns - stamp_ns) * 1e-9
                frame.online = coast(state, time).matrix
                frame.covariance = self._coasted(covariance, time)
        self._distrust()
        self._first, self._anchor = self.keyframes[-1].index, self.keyframes[-1].state
        self._anchor_covariance = self._coasted(covariance, (self.keyframes[-1].stamp_ns - stamp_ns) * 1e-9)
        self._window = None
        self._bad_keyframes = 0

    def _distrust(self) -> None:
        """The measurements since the last good key frame take no part in the final smoothing."""
        assert self._good is not None
        for keyframe in self.keyframes[self._good[0] + 1 :]:
            keyframe.trusted = False

    def _coasted(self, covariance: Array, time: float) -> Array:
        """Covariance (6, 6) of a pose after a time (s) of which nothing is known but what vehicles do."""
        settings = self.settings
        grown = np.repeat([settings.unknown_speed, settings.unknown_rate], 3) * time
        return covariance + np.diag(grown**2)

    # Results.

    def finish(self) -> None:
        """The end of the sequence: the last chance for a start, or a path without one."""
        if self._window is None and len(self.keyframes) > 1:
            self._next_attempt_s = 0.0
            self._try_to_start(self.settings.init_relaxed_scale_sigma)
        self.info["keyframes"] = len(self.keyframes)
        self.info["initialised"] = int(self._window is not None)
        if self.loops is not None:
            self.info["places"], self.info["loops"] = len(self.loops.places), len(self.loops.loops)
        if self._window is None:
            self._reckon()

    def _reckon(self) -> None:
        """States from the inertial measurements alone, from rest and level (or the last good state) on."""
        if self.keyframes and self.keyframes[0].state is None:
            segment = Segment.join([k.segment for k in self.keyframes[1:6]])
            up = segment.accel.mean(axis=0) if len(segment.dt) else np.array([0.0, 0.0, 1.0])
            self.keyframes[0].state = make_state(level_rotation(up), np.zeros(3), np.zeros(3), np.zeros(3), np.zeros(3))
        for before, keyframe in zip(self.keyframes[:-1], self.keyframes[1:], strict=True):
            if keyframe.state is None and keyframe.at_rest:
                keyframe.state = hold(before.state)
            elif keyframe.state is None:
                keyframe.state = forward(before.state, keyframe.segment, self.model.params)
        self._fill_back(0)

    def paths(self) -> dict[str, Trajectory]:
        """Both paths, by name."""
        return {"smoothed": self.smoothed(), "online": self.online()}

    def online(self) -> Trajectory:
        """T_odom_base at every frame as it was known at that frame; before the start, as it was known at the start."""
        poses, covariances = [], []
        for frame in self.frames:
            turn = np.eye(4) if frame.correction is None else frame.correction
            poses.append(turn @ frame.online)
            if frame.covariance is not None:
                both = np.kron(np.eye(2), turn[:3, :3])
                covariances.append(both @ frame.covariance @ both.T)
        return self._trajectory(poses, covariances)

    def smoothed(self) -> Trajectory:
        """T_odom_base at every frame after an adjustment of all key frames; the online path where none can be made."""
        if self._window is None or len(self.keyframes) < 3:
            return self.online()
        keyframes = self.keyframes if self.loops is None else self.loops.joined(self.keyframes)
        try:
            bundle, poses = smooth(self.model, keyframes, self.frames)
        except RuntimeError:  # GTSAM: the system of equations cannot be solved
            self.info["smoothing_failed"] = 1
            return self.online()
        self._adjusted = keyframes, bundle
        if len(bundle.errors_px):
            self.info["smoothed_error_px"] = float(np.median(bundle.errors_px))
        lever = invert(self.imu.T_base_imu)[:3, 3]
        # Each frame with the covariance of the key frame before it: the one after holds it from the other side.
        known = pose_covariances(bundle, keyframes, lever, self.model)
        return self._trajectory(poses, [known[frame.keyframe] for frame in self.frames])

    def map(self) -> LandmarkMap | None:
        """Key frames and landmarks of the smoothed path; None before there is one, and without pictures."""
        if self._adjusted is None or not self.palette:
            return None
        return landmark_map(self.model, *self._adjusted, self.palette)

    def _trajectory(self, poses: list[Array], covariances: list[Array]) -> Trajectory:
        """T_odom_base from T_odom_imu; with covariances where every frame has one."""
        stamps = np.array([frame.stamp_ns for frame in self.frames], dtype=np.int64)
        matrices = np.array(poses).reshape(-1, 4, 4) @ invert(self.imu.T_base_imu)
        quaternions = Rotation.from_matrix(matrices[:, :3, :3]).as_quat() if len(poses) else np.empty((0, 4))
        spread = np.array(covariances) if len(poses) and len(covariances) == len(poses) else None
        return Trajectory(stamps, matrices[:, :3, 3].copy(), quaternions, spread)
