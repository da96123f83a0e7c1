"""The estimator behind the front end: key frames, initialisation, fixed lag, final smoothing. It sees tracks only."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import gtsam
import numpy as np
from gtsam.symbol_shorthand import X
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from oysterbench.geometry import Array, invert
from oysterbench.sequence.types import CameraCalibration, ImuCalibration
from oysterbench.trajectory import Trajectory
from oysterbench_baselines.common.inertial import Segment, relative_rotation
from oysterbench_baselines.gtsam_vi.frontend import homogeneous
from oysterbench_baselines.gtsam_vi.graph import Bundle, Model, adjust
from oysterbench_baselines.gtsam_vi.inertial import extend, preintegrate
from oysterbench_baselines.gtsam_vi.initialisation import View, closed_form_start, level_rotation
from oysterbench_baselines.gtsam_vi.loops import LoopCloser
from oysterbench_baselines.gtsam_vi.settings import Settings
from oysterbench_baselines.gtsam_vi.smoothing import smooth
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
    states_of,
)
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
        self.model = Model(self.camera, self.imu, self.settings, self.right)
        self._window: Window | None = None
        self._since: list[Segment] = []
        self._measurements: gtsam.PreintegratedCombinedMeasurements | None = None
        self._next_attempt_s = 0.0
        self._first = 0  # key frame at which the search for a start begins
        self._anchor: State | None = None  # its state, when there was a start before
        self._good: tuple[int, State] | None = None  # the last key frame at which all was well, and its state then
        self._bad_keyframes = 0
        self.loops = LoopCloser(self.camera, self.model, self.settings) if self.settings.loops else None

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
        order = np.argsort(ids, kind="stable")
        view = View(np.asarray(ids, dtype=np.int64)[order], np.asarray(rays, dtype=float)[order])
        if self.keyframes:
            self._since.append(segment)
        if self._measurements is not None:
            extend(self._measurements, segment)
        predicted = self._predict()
        if self._is_keyframe(view):
            if right is not None:
                view = View(view.ids, view.rays, right()[order])
            self._add_keyframe(stamp_ns, view, predicted)
            predicted = self.keyframes[-1].state if self._window else None
        frame = Frame(stamp_ns, self.keyframes[-1].index, Segment.join(self._since))
        frame.online = predicted.matrix if predicted else None
        frame.correction = None if self.loops is None else self.loops.correction
        self.frames.append(frame)

    def look(self, picture: NDArray[np.uint8]) -> None:
        """The equalised picture (H, W) of the last frame: places are known again by those of key frames."""
        if self.loops is None:
            return
        if self.frames[-1].stamp_ns == self.keyframes[-1].stamp_ns:
            self.loops.add_keyframe(self.keyframes, picture)
        self.frames[-1].correction = self.loops.correction

    def _predict(self) -> State | None:
        if self._window is None:
            return None
        last = self.keyframes[-1].state
        return State(self._measurements.predict(last.nav, last.bias), last.bias)

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
        return self._parallax(last.rays[in_last], view.rays[in_view], turn) >= settings.keyframe_parallax_px

    def _parallax(self, before: Array, after: Array, R_before_after: Array) -> float:
        """Median flow (px) between rays (N, 2) that a rotation does not explain."""
        turned = homogeneous(before) @ R_before_after
        flow = after - turned[:, :2] / np.maximum(turned[:, 2:], 0.1)
        return float(np.median(np.linalg.norm(flow, axis=1))) * self.model.focal

    def _at_rest(self, view: View, duration: float) -> bool:
        """The picture has not moved since the last key frame.

        Judged by the affine flow that fits all tracks: their own noise averages out in it, and motion in any direction
        or about any axis shows.
        """
        last = self.keyframes[-1].view
        shared, in_last, in_view = np.intersect1d(last.ids, view.ids, assume_unique=True, return_indices=True)
        if len(shared) < self.settings.init_min_tracks or duration < self.settings.rest_s:
            return False
        flow = (view.rays[in_view] - last.rays[in_last]) * self.model.focal
        length = np.linalg.norm(flow, axis=1)
        calm = length <= 3 * np.median(length)
        places = homogeneous(last.rays[in_last][calm])
        fit = places @ np.linalg.lstsq(places, flow[calm], rcond=None)[0]
        return float(np.sqrt(np.mean(np.sum(fit**2, axis=1)))) < self.settings.rest_px

    def _add_keyframe(self, stamp_ns: int, view: View, predicted: State | None) -> None:
        segment = Segment.join(self._since)
        rest = bool(self.keyframes) and self._at_rest(view, segment.duration)
        self.keyframes.append(Keyframe(len(self.keyframes), stamp_ns, view, segment, rest))
        self._since = []
        if self._window is not None:
            self.keyframes[-1].aiding = self._aiding_of(len(self.keyframes) - 1, self.keyframes[-2].state)
            try:
                self._window.add(self.keyframes, predicted)
                diverged = self._has_diverged()
            except RuntimeError:  # GTSAM: the system of equations cannot be solved
                diverged = True
            if diverged:
                self._restart()
        else:
            self._try_to_start(self.settings.init_scale_sigma)
        if self._window is not None:
            self._measurements = preintegrate(Segment.join([]), self.keyframes[-1].state.bias, self.model.params)

    def _aiding_of(self, k: int, before: State) -> list[gtsam.NonlinearFactor]:
        """Factors of other sensors for key frame k, `before` the state one earlier: here none."""
        return []

    # Initialisation.

    def _try_to_start(self, max_scale_sigma: float) -> None:
        """Search the latest key frames for a start; accept it when its scale is well determined."""
        settings = self.settings
        stretch = self.keyframes[self._first :][-settings.init_max_keyframes :]
        now = (stretch[-1].stamp_ns - self.keyframes[0].stamp_ns) * 1e-9
        counts = np.unique(np.concatenate([k.view.sights()[0] for k in stretch]), return_counts=True)[1]
        if np.count_nonzero(counts >= settings.min_views) < settings.init_min_tracks or now < self._next_attempt_s:
            return
        metric = _seen_twice(stretch[-1].view) >= settings.init_min_tracks
        if metric:
            least, least_s = settings.init_stereo_keyframes, settings.init_stereo_s
        else:
            least, least_s = settings.init_min_keyframes, settings.init_min_s
        elapsed = sum(k.segment.duration for k in stretch[1:] if metric or not k.at_rest)
        if len(stretch) < least or elapsed < least_s:
            return
        self._next_attempt_s = now + settings.init_retry_s
        start = closed_form_start(
            [k.view for k in stretch],
            [k.segment for k in stretch[1:]],
            self.model.T_imu_cams,
            self.imu.gravity,
            self.model.gyro_turn_on,
            self.model.accel_turn_on,
            settings.pixel_sigma_px / self.model.focal,
        )
        states = states_of(start, self._anchor)
        try:
            bundle = adjust(self.model, stretch, states, settings.init_gates_px)
        except RuntimeError:  # GTSAM: the system of equations cannot be solved
            return
        if len(bundle.landmarks) < settings.init_min_tracks:
            return
        error = float(np.median(bundle.errors_px))
        if not error <= settings.init_max_error_px:
            return
        if not metric:
            sigma = _scale_sigma(bundle, stretch)
            if not sigma <= max_scale_sigma:
                return
            self.info["init_scale_sigma"] = sigma
        self.info["init_error_px"] = error
        for keyframe in stretch[1:] if self._anchor else stretch:
            keyframe.state = read_state(bundle.values, keyframe.index)
        self.info["init_s"] = now
        self._window = Window(self.model, stretch, bundle)
        self._good = (self.keyframes[-1].index, self.keyframes[-1].state)
        self._fill_back(stretch[0].index)

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

    def _has_diverged(self) -> bool:
        """Speed or biases beyond belief, or most landmarks far from where they were predicted, time and again."""
        settings, state = self.settings, self.keyframes[-1].state
        if not np.isfinite(state.matrix).all() or np.linalg.norm(state.nav.velocity()) > settings.max_speed:
            return True
        gyro = np.abs(state.bias.gyroscope()).max() / self.model.gyro_turn_on
        accel = np.abs(state.bias.accelerometer()).max() / self.model.accel_turn_on
        if self._window.lost_share > settings.max_lost_share:
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
        index, state = self._good
        stamp_ns = self.keyframes[index].stamp_ns
        for keyframe in self.keyframes[index:]:
            keyframe.state = coast(state, (keyframe.stamp_ns - stamp_ns) * 1e-9)
        for frame in self.frames:
            if frame.stamp_ns > stamp_ns:
                frame.online = coast(state, (frame.stamp_ns - stamp_ns) * 1e-9).matrix
        self._first, self._anchor = self.keyframes[-1].index, self.keyframes[-1].state
        self._window = None
        self._measurements = None
        self._bad_keyframes = 0

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

    def online(self) -> Trajectory:
        """T_odom_base at every frame as it was known at that frame; before the start, as it was known at the start."""
        return self._trajectory([f.online if f.correction is None else f.correction @ f.online for f in self.frames])

    def smoothed(self) -> Trajectory:
        """T_odom_base at every frame after an adjustment of all key frames; the online path where none can be made."""
        if self._window is None or len(self.keyframes) < 3 or "restarts" in self.info:
            return self.online()
        keyframes = self.keyframes if self.loops is None else self.loops.joined(self.keyframes)
        try:
            bundle, poses = smooth(self.model, keyframes, self.frames)
        except RuntimeError:  # GTSAM: the system of equations cannot be solved
            self.info["smoothing_failed"] = 1
            return self.online()
        if len(bundle.errors_px):
            self.info["smoothed_error_px"] = float(np.median(bundle.errors_px))
        return self._with_covariances(self._trajectory(poses), bundle)

    def _with_covariances(self, trajectory: Trajectory, bundle: Bundle) -> Trajectory:
        """The smoothed trajectory with what is known of its covariances: here nothing."""
        return trajectory

    def _trajectory(self, poses: list[Array]) -> Trajectory:
        stamps = np.array([frame.stamp_ns for frame in self.frames], dtype=np.int64)
        matrices = np.array(poses).reshape(-1, 4, 4) @ invert(self.imu.T_base_imu)
        quaternions = Rotation.from_matrix(matrices[:, :3, :3]).as_quat() if len(poses) else np.empty((0, 4))
        return Trajectory(stamps, matrices[:, :3, 3].copy(), quaternions)


def _seen_twice(view: View) -> int:
    """Number of tracks that both cameras see."""
    return 0 if view.right is None else int(np.isfinite(view.right[:, 0]).sum())


def _scale_sigma(bundle: Bundle, keyframes: list[Keyframe]) -> float:
    """Relative 1-sigma uncertainty of scale: of the longest way from the first key frame, along it."""
    positions = np.array([bundle.values.atPose3(X(k.index)).translation() for k in keyframes])
    offsets = positions - positions[0]
    far = int(np.argmax(np.linalg.norm(offsets, axis=1)))
    length = float(np.linalg.norm(offsets[far]))
    if length < 1e-3:
        return float("inf")
    try:
        covariance = gtsam.Marginals(bundle.graph, bundle.values).marginalCovariance(X(keyframes[far].index))
    except RuntimeError:
        return float("inf")
    # GTSAM states the translation in the axes of the pose itself.
    along = bundle.values.atPose3(X(keyframes[far].index)).rotation().matrix().T @ offsets[far] / length
    return float(np.sqrt(along @ covariance[3:, 3:] @ along)) / length
