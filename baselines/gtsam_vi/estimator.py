"""The estimator behind the front end, frame by frame, in the order of the algorithm. It receives tracks only.

A filter propagates the inertial measurements from frame to frame and a fixed-lag smoother over keyframes corrects it.
Aiding sensors are objects given to it: their samples correct the filter, and their factors join the graph. An aided
filter runs from the first sample on, so every frame has a pose and a covariance whether or not anything is visible;
once the filter has been given a velocity, the window starts from it, and restarts from it after a failure.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from oysterbench.core.geometry import Array, invert
from oysterbench.core.trajectory import Trajectory
from oysterbench.methods import Health, LandmarkMap
from oysterbench.sequence.types import CameraCalibration, ImuCalibration
from oysterbench_baselines.common.aiding import Aiding
from oysterbench_baselines.common.filter import FLOOR, VELOCITY, InertialNoise, InvariantFilter
from oysterbench_baselines.common.inertial import Segment
from oysterbench_baselines.common.memory import hand_back
from oysterbench_baselines.gtsam_vi.bundle import Bundle
from oysterbench_baselines.gtsam_vi.calibration import CameraUncertainty
from oysterbench_baselines.gtsam_vi.covariance import between_keyframes, covariances_until
from oysterbench_baselines.gtsam_vi.fallback import dead_reckon, go_back, go_on
from oysterbench_baselines.gtsam_vi.frontend import NO_TRACKS, FeatureTracks, Observations, Translation
from oysterbench_baselines.gtsam_vi.graph import Model, StartPrior
from oysterbench_baselines.gtsam_vi.handover import correct_filter
from oysterbench_baselines.gtsam_vi.health import HealthWatch
from oysterbench_baselines.gtsam_vi.initialisation import FilterStartSettings, Initialiser
from oysterbench_baselines.gtsam_vi.keyframes import (
    DataAssociation,
    has_turned,
    is_keyframe,
    is_stationary,
    is_under_way,
)
from oysterbench_baselines.gtsam_vi.loops import LoopCloser
from oysterbench_baselines.gtsam_vi.mapping import Palette, landmark_map
from oysterbench_baselines.gtsam_vi.paths import known_now, known_then, path_of, trajectory_of
from oysterbench_baselines.gtsam_vi.recovery import Recovery, grow_on
from oysterbench_baselines.gtsam_vi.settings import GtsamViSettings
from oysterbench_baselines.gtsam_vi.smoothing import smooth
from oysterbench_baselines.gtsam_vi.states import Frame, Keyframe, State, backward, forward, state_of
from oysterbench_baselines.gtsam_vi.window import Window

MatchSecond = Callable[[], Array]
"""Function that finds the tracks of a frame in the second camera's image: rays (N, 2), NaN where it does not see
them."""


@dataclass(frozen=True)
class AidedFilter:
    """A filter that runs from the first sample on, its aiding sensors, and when a window may start from it."""

    filter: InvariantFilter
    aiding: Aiding
    start: FilterStartSettings = field(default_factory=FilterStartSettings)


class Estimator:
    """Estimator of a path from inertial measurements, aiding-sensor samples and frames of tracks, in time order.

    cameras: one, or two with a common view. aided: what there is besides cameras and IMU. uncertainty: of the cameras,
    which are then calibrated online.
    """

    def __init__(
        self,
        cameras: list[CameraCalibration],
        imu: ImuCalibration,
        settings: GtsamViSettings,
        aided: AidedFilter | None = None,
        uncertainty: CameraUncertainty | None = None,
    ) -> None:
        self.imu, self.settings = imu, settings
        noise = InertialNoise.of(imu, settings.noise.imu_inflation)
        self.aiding = aided.aiding if aided else Aiding()
        self.filter = aided.filter if aided else InvariantFilter(np.eye(3), noise, imu.gravity)
        self.model = Model(cameras, imu, settings, self.aiding, uncertainty)
        self.window: Window | None = None
        self.loops = LoopCloser(cameras[0], self.model, settings) if settings.loops.enabled else None
        self.keyframes: list[Keyframe] = []
        self.frames: list[Frame] = []
        self.info: dict[str, float | int | str] = {}
        self._aided = aided is not None
        self._initialiser = Initialiser(self.model, aided.start if aided else None)
        self._recovery = Recovery(self.model)
        self._association = DataAssociation(settings, self.model.rig.T_imu_cam[:3, :3])
        self._watch = HealthWatch(settings.recovery.memory_s)
        self._since_frame: list[Segment] = []
        self._since_keyframe: list[Segment] = []
        self._palette = Palette()
        self._first_known: tuple[Frame, State] | None = None  # the first frame of which the filter knew the pose
        self._smoothed: tuple[list[Keyframe], Bundle] | None = None

    @property
    def navigating(self) -> bool:
        """Whether the filter knows where it is: from a window, or from a velocity that it has been given."""
        return self.window is not None or self.aiding.knows_velocity

    @property
    def gyro_bias(self) -> Array:
        """Latest gyro bias estimate (3,) rad/s, after a failure that from before it; zero before there is one."""
        if self._aided or self.window is not None:
            return self.filter.gyro_bias
        return self._initialiser.gyro_bias

    def propagate(self, segment: Segment) -> None:
        """Propagate by the inertial measurements up to the next sample or frame."""
        if self._aided or self.window is not None:
            self.filter.propagate_all(segment)
        self._since_frame.append(segment)
        if self.keyframes:
            self._since_keyframe.append(segment)
            self.aiding.propagate(segment)

    def update(self, sample: Any) -> None:
        """Correct the filter with a sample of an aiding sensor, taken at the end of the last segment."""
        self.aiding.update(self.filter, sample)

    def step(
        self,
        stamp_ns: int,
        tracks: FeatureTracks = NO_TRACKS,
        match_second: MatchSecond | None = None,
        image: NDArray[np.uint8] | None = None,
        pixels: NDArray[np.uint8] | None = None,
    ) -> None:
        """Process the next frame, up to whose stamp all measurements have been propagated; no tracks if it is missing.

        match_second: called for keyframes only. image (H, W): equalised, for place recognition; pixels (H, W, 3) RGB or
        (H, W): as taken, for the landmarks' colours.
        """
        observations, landmarks, order = self._associate(tracks)
        if self._is_keyframe(observations):
            second = None if match_second is None else match_second()[order]
            self._add_keyframe(stamp_ns, replace(observations, right=second, inflation=self._association.inflation()))
            if self.keyframes[-1].segment.has_gap:
                self._pass_over()
            elif self.window is None:
                self._initialise()
            else:
                self._smooth(self.window)
            if self.window is not None:
                correct_filter(self.filter, self.window, self.keyframes[-1], self.model)
            if self.loops is not None and image is not None:
                self.loops.add_keyframe(self.keyframes, image)
                self._watch.look_for_ties(self.loops)
            if pixels is not None:
                self._palette.add(pixels, replace(tracks, ids=landmarks))
        self._add_frame(stamp_ns, observations.ids)

    def has_moved(self, segment: Segment) -> bool:
        """Whether the vehicle has certainly moved or turned over a segment: an image that repeats the last one is then
        a stored one and not current."""
        limits = self.settings.frontend
        if has_turned(segment, self.gyro_bias, self.model.gyro_turn_on, limits.repeat_px / self.model.rig.focal):
            return True
        if self.window is None:
            return False
        sigma = np.sqrt(np.trace(self.filter.covariance[VELOCITY, VELOCITY]))
        return bool(np.linalg.norm(self.filter.velocity) > max(limits.repeat_speed, 5 * sigma))

    def moved(self, stamp_ns: int, duration: float) -> Translation | None:
        """Translation of the first camera over `duration` s up to a stamp; None if the filter does not know it."""
        if not self.navigating:
            return None
        f, T_imu_cam = self.filter, self.model.rig.T_imu_cam
        arm = np.cross(f.rate, T_imu_cam[:3, 3])
        velocity = T_imu_cam[:3, :3].T @ (f.rotation.T @ f.velocity + arm)
        sigma = float(np.sqrt(np.trace(f.covariance[VELOCITY, VELOCITY]) / 3))
        if not self.aiding.measures_velocity(stamp_ns):  # it comes from the very tracks that are to be judged
            sigma = float(np.hypot(sigma, self.settings.frontend.motion_sigma))
        return Translation(velocity * duration, sigma * duration)

    # The parts of a step.

    def _associate(self, tracks: FeatureTracks) -> tuple[Observations, NDArray[np.int64], NDArray[np.intp]]:
        """Observations of the frame, sorted by landmark; landmarks (N,) of its tracks, and their sorting order (N,)."""
        segment, self._since_frame = Segment.join(self._since_frame), []
        rays = np.asarray(tracks.at_stamp, dtype=float)
        landmarks = self._association.landmarks(tracks.ids, rays, segment, self.gyro_bias)
        order = np.argsort(landmarks, kind="stable")
        return Observations(landmarks[order], rays[order]), landmarks, order

    def _is_keyframe(self, observations: Observations) -> bool:
        if not self.keyframes:
            return True
        last, since = self.keyframes[-1].observations, Segment.join(self._since_keyframe)
        return is_keyframe(last, observations, since, self.gyro_bias, self.model.rig, self.settings)

    def _add_keyframe(self, stamp_ns: int, observations: Observations) -> None:
        segment, self._since_keyframe = Segment.join(self._since_keyframe), []
        for frame in reversed(self.frames):  # their measurements are the first part of the keyframe's
            if frame.keyframe != len(self.keyframes) - 1:
                break
            frame.since = segment.first(len(frame.since.dt))
        if not self.keyframes and "dvl" in self.aiding.sensors:
            self._hold_start()
        self.aiding.add_keyframe(len(self.keyframes), stamp_ns, self.filter, segment.duration)
        may_rest = bool(self.keyframes) and not (self.navigating and is_under_way(self.filter, self.settings))
        stationary = may_rest and is_stationary(
            self.keyframes[-1].observations, observations, segment, self.gyro_bias, self.model
        )
        self.keyframes.append(Keyframe(len(self.keyframes), stamp_ns, observations, segment, stationary))

    def _initialise(self, final: bool = False) -> None:
        """Try to start the window from the latest keyframes."""
        initialiser, last = self._initialiser, self.keyframes[-1]
        if self.aiding.knows_velocity:
            start = initialiser.from_filter(self.keyframes, self.filter)
        else:
            self.aiding.initialise(last.index, state_of(self.filter), None)
            for keyframe in self.keyframes[initialiser.first + 1 :]:
                keyframe.aiding = keyframe.aiding or self.aiding.factors(keyframe.index, state_of(self.filter))
            start = initialiser.from_observations(self.keyframes, final)
        if start is None:
            return
        self.window = start.window
        now = (last.stamp_ns - self.keyframes[0].stamp_ns) * 1e-9
        self.info |= start.info | {"init_s" if "init_s" not in self.info else "restarted_s": now}
        self._recovery.accept(last)
        self._fill_back(start.stretch[0].index)
        if self._initialiser.anchor is not None:  # what was lost has the poses that were known then
            lost = [frame for frame in self.frames if frame.keyframe < start.stretch[0].index]
            grow_on(lost, self.settings.recovery, self.model.gyro_turn_on)
        if any(frame.covariance is None for frame in self.frames):
            known = covariances_until(start.bundle, self.keyframes, start.stretch, self.filter.noise, self.model)
            for frame in self.frames:
                frame.covariance = known[frame.keyframe] if frame.covariance is None else frame.covariance
        self._give()

    def _smooth(self, window: Window) -> None:
        """Add the factors of the last keyframe; smooth; marginalise what leaves the window."""
        keyframe = self.keyframes[-1]
        keyframe.aiding = self.aiding.factors(keyframe.index, self.keyframes[-2].estimate)
        try:
            window.add(self.keyframes, self.model.when_taken(keyframe, state_of(self.filter)))
            diverged = self._recovery.has_diverged(window, keyframe)
        except RuntimeError:  # GTSAM: the system of equations cannot be solved
            diverged = True
        if diverged:
            self._restart()

    def _pass_over(self) -> None:
        """Begin anew at a keyframe before which inertial samples are missing: no factor knows of that time."""
        self.info["imu_gaps"] = int(self.info.get("imu_gaps", 0)) + 1
        self.keyframes[-1].lost = True
        self._initialiser.first = self.keyframes[-1].index
        if self._recovery.has_begun:
            self._restart()

    def _restart(self) -> None:
        """Give up the window and search for a new start from this keyframe on: an aided filter keeps running, and the
        next window starts from it; otherwise the velocity is that of the last good keyframe."""
        self.info["restarts"] = int(self.info.get("restarts", 0)) + 1
        self.window = None
        self._recovery.distrust(self.keyframes, self.frames)
        self._watch.lose(self.keyframes[-1].index)
        self._initialiser.first = self.keyframes[-1].index
        if not self.aiding.knows_velocity:
            self._initialiser.anchor = self._recovery.predict(self.keyframes, self.frames)
            return
        for keyframe in self.keyframes:
            if keyframe.state is None or not np.isfinite(keyframe.state.matrix).all():
                keyframe.state = state_of(self.filter)
        self.keyframes[-1].state = state_of(self.filter)
        self._hold_start()

    def _hold_start(self) -> None:
        """Make a window that starts now know its first state as well as the filter does."""
        f = self.filter
        velocity = f.covariance[VELOCITY, VELOCITY] + np.eye(3) * 1e-6
        self.model.start_prior[self._initialiser.first] = StartPrior(f.pose_covariance(f.position), velocity)

    def _add_frame(self, stamp_ns: int, landmarks: NDArray[np.int64]) -> None:
        frame = Frame(stamp_ns, self.keyframes[-1].index, Segment.join(self._since_keyframe))
        if self.navigating:
            frame.pose = self.filter.pose
            self._first_known = self._first_known or (frame, state_of(self.filter))
        if self._aided or self.window is not None:
            place = (self.filter.pose @ invert(self.imu.T_base_imu))[:3, 3]
            frame.covariance = self.filter.pose_covariance(place) + FLOOR
        sees = self.window is not None and self.window.sees(landmarks)
        frame.health = self._watch.health(stamp_ns, frame.keyframe, sees)
        frame.correction = None if self.loops is None else self.loops.correction
        self.frames.append(frame)
        if self.navigating:
            frame.online = frame.known
        elif self._recovery.has_begun:
            frame.online = self._recovery.coasting(self.keyframes, frame)

    # Frames from before there was a window.

    def _fill_back(self, index: int) -> None:
        """Fill in the states of the keyframes before `index`, back along the inertial measurements, and the missing
        poses of frames."""
        go_back(self.keyframes, index, self.imu.gravity)
        for frame in self.frames:
            if frame.pose is None:
                if self.window is not None and frame.keyframe >= index:
                    frame.health = Health.TRACKING  # the start has seen it
                frame.pose = forward(self.keyframes[frame.keyframe].estimate, frame.since, self.model.params).matrix

    def _give(self) -> None:
        """Give frames without an online pose what is known of them by now."""
        for frame in self.frames:
            frame.online = frame.online or frame.known

    def _dead_reckon(self) -> None:
        """Fill in states from the inertial measurements alone, from level or the last good state on; where an aided
        filter has known its velocity, only those before that."""
        if self.keyframes and self.keyframes[0].state is None:
            if self._first_known is not None:
                frame, state = self._first_known
                self.keyframes[frame.keyframe].state = backward(state, frame.since, self.imu.gravity)
                return self._fill_back(frame.keyframe)
            return dead_reckon(self.keyframes, self.frames, self.imu, self.filter.noise, self.settings.zero_velocity)
        go_on(self.keyframes, self.model.params)
        self._fill_back(0)
        grow_on(self.frames, self.settings.recovery, self.model.gyro_turn_on)

    # Results.

    def finish(self) -> None:
        """End the sequence: make a last attempt at a start, or dead-reckon a path without one."""
        if self.window is None and len(self.keyframes) > 1 and not self.aiding.knows_velocity:
            self._initialise(final=True)
        self.info["keyframes"] = len(self.keyframes)
        self.info["initialised"] = int(self._recovery.has_begun or self.aiding.knows_velocity)
        if self.loops is not None:
            self.info["places"], self.info["loops"] = len(self.loops.places), len(self.loops.loops)
            self.loops.rest()
        if len(self.keyframes) > self.settings.smoothing.piece_keyframes:
            hand_back()  # before the final smoothing of a long path needs more
        if self.aiding.knows_velocity:
            self.info |= {f"refused_{kind}": count for kind, count in self.aiding.refused.items()}
        if self.window is None:
            self._initialiser.give_up(self.keyframes)
            self._dead_reckon()
        self._give()

    def paths(self) -> dict[str, Trajectory]:
        """Smoothed and online path, by name."""
        return {"smoothed": self.smoothed(), "online": self.online()}

    def online(self) -> Trajectory:
        """T_odom_base at every frame as it was known at that frame: it coasts while the path is lost. Before the first
        start, as it was known at that start."""
        return path_of(self.frames, known_then, self.imu.T_base_imu)

    def smoothed(self) -> Trajectory:
        """T_odom_base at every frame after an adjustment of all keyframes; where none can be made, as known before."""
        if self.window is None and (self.aiding.knows_velocity or not self._recovery.has_begun):
            return path_of(self.frames, known_now, self.imu.T_base_imu)
        keyframes = self.keyframes if self.loops is None else self.loops.joined(self.keyframes)
        try:
            smoothed = smooth(self.model, keyframes, self.frames)
        except RuntimeError:  # GTSAM: the system of equations cannot be solved
            self.info["smoothing_failed"] = 1
            return path_of(self.frames, known_now, self.imu.T_base_imu)
        self._smoothed = keyframes, smoothed.bundle
        self.info |= self.aiding.counts()
        if len(smoothed.bundle.errors_px):
            self.info["smoothed_error_px"] = float(np.median(smoothed.bundle.errors_px))
        try:
            known = smoothed.covariances(invert(self.imu.T_base_imu)[:3, 3], self.model)
        except RuntimeError:  # the system is singular there; the poses are unaffected
            self.info["covariances_failed"] = 1
            return trajectory_of(self.frames, smoothed.poses, [], self.imu.T_base_imu)
        covariances = between_keyframes(known, keyframes, self.frames)
        return trajectory_of(self.frames, smoothed.poses, covariances, self.imu.T_base_imu)

    def health(self, path: str = "smoothed") -> NDArray[np.uint8]:
        """How the pose of each frame was obtained, one `Health` each, in a path of `paths`."""
        known = known_then if path == "online" else known_now
        return np.array([known(frame).health for frame in self.frames], dtype=np.uint8)

    def map(self) -> LandmarkMap | None:
        """Keyframes and landmarks of the smoothed path; None before there is one, or without images."""
        if self._smoothed is None or not self._palette:
            return None
        return landmark_map(self.model, *self._smoothed, self._palette)
