"""Recovery from failures: when the window has diverged, and what is known of the pose until it is recovered."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import takewhile

import numpy as np

from oysterbench.core.geometry import Array
from oysterbench.methods import Health
from oysterbench_baselines.gtsam_vi.graph import Model, StartPrior
from oysterbench_baselines.gtsam_vi.settings import RecoverySettings
from oysterbench_baselines.gtsam_vi.states import (
    Frame,
    Keyframe,
    Known,
    State,
    coast,
    coast_through,
    time_missing,
)
from oysterbench_baselines.gtsam_vi.window import Window


@dataclass(frozen=True)
class Anchor:
    """Where a path goes on: state of the IMU, and covariance (6, 6) of base_link's pose as in a `Trajectory`."""

    state: State
    covariance: Array


@dataclass(frozen=True)
class Lost:
    """A lost path at a keyframe: its index and coasted state; stamp and covariance (6, 6) of the last good keyframe,
    and for how long since then, s, inertial samples are missing."""

    index: int
    state: State
    good_ns: int
    covariance: Array
    gap_s: float


class Recovery:
    """Monitor of the window, which remembers the last keyframe at which all was well."""

    def __init__(self, model: Model) -> None:
        self._model = model
        self._bad_keyframes = 0
        self._misfits = False  # whether tracks that fit no point are all that was bad
        self._good: tuple[int, State] | None = None  # a keyframe's index, and its state then
        self._coasted = 0  # index of the keyframe up to which the path has been coasted since
        self._lost: Lost | None = None  # at the last keyframe, since the last loss

    @property
    def has_begun(self) -> bool:
        """Whether all has been well at a keyframe."""
        return self._good is not None

    def accept(self, keyframe: Keyframe) -> None:
        """Note that all is well at a keyframe."""
        self._good, self._coasted = (keyframe.index, keyframe.estimate), keyframe.index
        if not (keyframe.blind or keyframe.stationary):  # what rests on the bottom may stir up silt as it lifts off
            self._model.note_speed(float(np.linalg.norm(keyframe.estimate.nav.velocity())))

    def has_diverged(self, window: Window, keyframe: Keyframe) -> bool:
        """Whether speed or biases are implausible, or what is seen repeatedly fits neither landmarks nor, after a time
        by inertia alone, any point at all."""
        limits, model, state = self._model.settings.recovery, self._model, keyframe.estimate
        fastest = limits.max_speed
        if keyframe.blind:
            fastest = min(fastest, limits.max_blind_speed * model.usual_speed)
        if not np.isfinite(state.matrix).all() or np.linalg.norm(state.nav.velocity()) > fastest:
            return True
        misled, misfits = window.lost_share > limits.max_lost_share, window.misfits >= limits.max_misfits
        self._bad_keyframes = self._bad_keyframes + 1 if misled or misfits else 0
        if model.bias_sigmas(state.bias) > limits.max_bias_sigmas:
            return True
        if self._bad_keyframes >= limits.max_bad_keyframes:
            self._misfits = not misled
            return True
        if self._bad_keyframes == 0:
            self.accept(keyframe)
        return False

    def distrust(self, keyframes: list[Keyframe], frames: list[Frame]) -> None:
        """Exclude what was seen since the last good keyframe from the final smoothing, but by the last keyframe, from
        which a new start is searched for."""
        assert self._good is not None  # set since the window started
        good = self._good[0]
        for keyframe in keyframes[good + 1 :]:
            keyframe.lost = True
        if len(keyframes) > good + 1:
            keyframes[good + 1].astray = not (self._misfits and self._had_seen_nothing(keyframes[: good + 1]))
        for keyframe in keyframes[good + 1 : -1]:
            keyframe.distrust_sight()
        for frame in frames:
            if frame.keyframe > good:
                frame.health = Health.COASTING
        self._bad_keyframes, self._misfits = 0, False

    def _had_seen_nothing(self, keyframes: list[Keyframe]) -> bool:
        """Whether there was nothing to see for most of the blind time up to the last of these keyframes. What is known
        by inertia alone is not doubtful; but where hardly any of what is seen makes a landmark, that may be silt."""
        blind = takewhile(lambda keyframe: keyframe.blind, reversed(keyframes))
        counts = [len(keyframe.observations.ids) for keyframe in blind]
        return bool(counts) and float(np.median(counts)) < self._model.settings.recovery.min_landmarks

    def predict(self, keyframes: list[Keyframe], frames: list[Frame]) -> Anchor:
        """Coast the path from the last good keyframe, slowing down, also for the frames whose poses have been given
        since; return what is known of the last keyframe."""
        assert self._good is not None
        index, state = self._good
        stamp_ns, limits = keyframes[index].stamp_ns, self._model.settings.recovery
        covariance = next(frame.covariance for frame in frames if frame.stamp_ns == stamp_ns)
        assert covariance is not None
        keyframes[index].state = state
        passed, turn_on = keyframes[index + 1 :], self._model.gyro_turn_on
        # It is lost anew at every keyframe within a gap: only what has been added since is coasted.
        done = next((k.index - 1 for k in passed[: self._coasted - index] if k.state is None), self._coasted)
        last = coast_through(keyframes[done].estimate, keyframes[done + 1 :], limits.memory_s)
        self._coasted = keyframes[-1].index
        for frame in frames:
            if frame.stamp_ns > stamp_ns and frame.keyframe >= done:
                frame.pose = coast(keyframes[frame.keyframe].estimate, frame.since, limits.memory_s).matrix
                time = (frame.stamp_ns - stamp_ns) * 1e-9
                gap_s = time_missing([*(k.segment for k in passed if k.index <= frame.keyframe), frame.since])
                frame.covariance = grown_covariance(covariance, time, limits, turn_on, gap_s)
        time = (keyframes[-1].stamp_ns - stamp_ns) * 1e-9
        gap_s = time_missing(keyframe.segment for keyframe in passed)
        self._lost = Lost(keyframes[-1].index, last, stamp_ns, covariance, gap_s)
        return Anchor(last, grown_covariance(covariance, time, limits, turn_on, gap_s))

    def coasting(self, keyframes: list[Keyframe], frame: Frame) -> Known:
        """What is known of a new frame while the path is lost: it coasts on, whatever a later start will find."""
        assert self._lost is not None  # since `predict`
        lost, limits = self._lost, self._model.settings.recovery
        for keyframe in keyframes[lost.index + 1 : frame.keyframe + 1]:
            state = coast(lost.state, keyframe.segment, limits.memory_s)
            gap_s = float(np.hypot(lost.gap_s, time_missing([keyframe.segment])))
            lost = self._lost = replace(lost, index=keyframe.index, state=state, gap_s=gap_s)
        time, gap_s = (frame.stamp_ns - lost.good_ns) * 1e-9, float(np.hypot(lost.gap_s, time_missing([frame.since])))
        covariance = grown_covariance(lost.covariance, time, limits, self._model.gyro_turn_on, gap_s)
        return Known(coast(lost.state, frame.since, limits.memory_s).matrix, covariance, Health.COASTING)


def grown_covariance(
    covariance: Array, time: float, settings: RecoverySettings, gyro_sigma: float, gap_s: float = 0.0
) -> Array:
    """Covariance (6, 6) of a pose after a time (s) about which nothing is known but its turns, to gyro_sigma (rad/s),
    and how vehicles usually move; gap_s: the part of it whose turns are not known either."""
    turn = np.hypot(gyro_sigma * time, settings.unknown_rate * gap_s)
    return covariance + np.diag(np.repeat([settings.unknown_speed * time, turn], 3) ** 2)


def grow_on(frames: list[Frame], settings: RecoverySettings, gyro_sigma: float) -> None:
    """Give frames without a covariance that of the last one that has it, grown by the time since."""
    known: Frame | None = None
    for frame in frames:
        if frame.covariance is not None:
            known = frame
        elif known is not None and known.covariance is not None:
            time = (frame.stamp_ns - known.stamp_ns) * 1e-9
            frame.covariance = grown_covariance(known.covariance, time, settings, gyro_sigma)


def unlevelled(anchor: Anchor) -> StartPrior:
    """What is known at a start after a failure: position, heading and biases, but neither roll and pitch nor speed."""
    pose = anchor.covariance.copy()
    pose[3:5, :], pose[:, 3:5] = 0.0, 0.0
    pose[3, 3] = pose[4, 4] = 0.5**2
    return StartPrior(pose, np.eye(3) * 2.0**2, anchor.state.bias)
