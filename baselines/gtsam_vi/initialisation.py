"""Initialisation of the window: when to look for a start, where it is, and whether to accept what is found."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import gtsam
import numpy as np
from gtsam.symbol_shorthand import X

from oysterbench.core.geometry import Array
from oysterbench_baselines.common.filter import InvariantFilter
from oysterbench_baselines.gtsam_vi.bundle import Bundle, adjust
from oysterbench_baselines.gtsam_vi.closed_form import closed_form_start
from oysterbench_baselines.gtsam_vi.covariance import joint_covariance
from oysterbench_baselines.gtsam_vi.frontend import Observations
from oysterbench_baselines.gtsam_vi.graph import Model
from oysterbench_baselines.gtsam_vi.recovery import Anchor, grown_covariance, unlevelled
from oysterbench_baselines.gtsam_vi.settings import GtsamViSettings
from oysterbench_baselines.gtsam_vi.states import (
    Keyframe,
    State,
    backward,
    coast_through,
    read_state,
    state_of,
    states_of,
    time_missing,
)
from oysterbench_baselines.gtsam_vi.window import Window


@dataclass(frozen=True)
class Start:
    """A window that starts with an adjusted stretch of keyframes, whose states are set; info: how it was found."""

    stretch: list[Keyframe]
    bundle: Bundle
    window: Window
    info: dict[str, float]


@dataclass(frozen=True)
class FilterStartSettings:
    """When a filter that knows its velocity is certain enough of roll and pitch for a window to start from its state,
    but not before `min_s` and `min_keyframes`: a single keyframe has no landmarks."""

    tilt_deg: float = 1.0  # 1 sigma
    min_s: float = 1.5
    min_keyframes: int = 4


class Initialiser:
    """Search for a start among the keyframes from `first` on; after the loss of an earlier start, the first of them is
    at `anchor`."""

    def __init__(self, model: Model, filter_start: FilterStartSettings | None) -> None:
        self.model = model
        self.first = 0
        self.anchor: Anchor | None = None
        self._filter_start = filter_start or FilterStartSettings()
        self._next_attempt_s = 0.0
        self._pause_s = model.settings.initialisation.retry_s

    @property
    def gyro_bias(self) -> Array:
        """Gyro bias (3,) rad/s from before the loss; zero where there is none."""
        return np.zeros(3) if self.anchor is None else np.asarray(self.anchor.state.bias.gyroscope())

    def from_observations(self, keyframes: list[Keyframe], final: bool) -> Start | None:
        """Find a start from tracks and inertial measurements, if its scale is well determined; final: last attempt."""
        limits = self.model.settings.initialisation
        stretch = keyframes[self.first :][-limits.max_keyframes :]
        now = (stretch[-1].stamp_ns - keyframes[0].stamp_ns) * 1e-9
        too_soon = now < self._next_attempt_s and not final
        if too_soon or not is_worth_a_try(stretch, self.model.settings):
            return None
        # Where nothing is found time and again, as in murky water, the search itself would take most of the run time.
        self._next_attempt_s = now + self._pause_s
        self._pause_s = min(self._pause_s * limits.retry_growth, limits.max_retry_s)
        if self.anchor is not None:
            if stretch[0].index > self.first:
                self._move_anchor(keyframes, stretch[0])
            self.model.start_prior[stretch[0].index] = unlevelled(self.anchor)
        at = None if self.anchor is None else self.anchor.state
        most = limits.relaxed_scale_sigma if final else limits.scale_sigma
        whole = stretch[0].index
        stretch, bundle = self._find(stretch, at, most)
        if bundle is None:
            return None
        started = stretch if at is None else stretch[1:]
        for keyframe in started:
            keyframe.state = read_state(bundle.values, keyframe.index)
        try:
            window = Window(self.model, stretch, bundle, weak_gauge=at is not None)
        except RuntimeError:  # GTSAM: the system of equations cannot be solved
            for keyframe in started:
                keyframe.state = None
            return None
        self._pause_s = limits.retry_s
        info = {} if is_metric(stretch, self.model.settings) else {"init_scale_sigma": scale_sigma(bundle, stretch)}
        info["init_error_px"] = float(np.median(bundle.errors_px))
        if stretch[0].index > whole:
            for keyframe in keyframes[: stretch[0].index]:
                keyframe.distrust_sight()
        return Start(stretch, bundle, window, info)

    def _find(
        self, stretch: list[Keyframe], anchor: State | None, max_scale_sigma: float
    ) -> tuple[list[Keyframe], Bundle | None]:
        """Return a stretch and its adjustment, or its later half if what the earlier half saw does not fit the rest.

        Silt drifts as one, and a start made of it, wholly or in part, fits well enough. But then the later half alone
        fits clearly better, or determines the scale better than the whole does, which consistent data never do.
        """
        model, settings = self.model, self.model.settings
        whole, half = find_start(model, stretch, anchor, max_scale_sigma), stretch[len(stretch) // 2 :]
        if anchor is not None or not is_worth_a_try(half, settings):
            return stretch, whole
        later = find_start(model, half, anchor, np.inf)
        if later is None:
            return stretch, whole
        known = scale_sigma(later, half)
        if whole is not None and known >= scale_sigma(whole, stretch):
            share = float(np.median(later.errors_px)) / max(float(np.median(whole.errors_px)), 1e-9)
            if share >= settings.initialisation.later_error:
                return stretch, whole
        certain = known <= max_scale_sigma or is_metric(half, settings)
        return half, later if certain else None

    def from_filter(self, keyframes: list[Keyframe], filter: InvariantFilter) -> Start | None:
        """Find a start from the state of a filter that knows its velocity, once its roll and pitch are certain."""
        limits, settings = self._filter_start, self.model.settings
        stretch = keyframes[self.first :]
        elapsed = (stretch[-1].stamp_ns - stretch[0].stamp_ns) * 1e-9
        tilt = np.sqrt(np.diag(filter.covariance)[:2].max())
        if len(stretch) < limits.min_keyframes or elapsed < limits.min_s or tilt > np.radians(limits.tilt_deg):
            return None
        states = [state_of(filter)]
        for keyframe in reversed(stretch[1:]):
            states.insert(0, backward(states[0], keyframe.segment, self.model.imu.gravity))
        self.model.aiding.initialise(stretch[-1].index, states[-1], filter)
        for keyframe, before in zip(stretch[1:], states[:-1], strict=True):
            keyframe.aiding = self.model.aiding.factors(keyframe.index, before)
        gates = 3 * settings.landmarks.max_innovation_px, settings.landmarks.max_error_px
        try:
            bundle = adjust(self.model, stretch, states, gates)
            window = Window(self.model, stretch, bundle)
        except RuntimeError:  # GTSAM: the system of equations cannot be solved
            return None
        for keyframe in stretch[1:] if self.first else stretch:
            keyframe.state = read_state(bundle.values, keyframe.index)
        return Start(stretch, bundle, window, {})

    def give_up(self, keyframes: list[Keyframe]) -> None:
        """End a search that found no new start after a loss."""
        if self.anchor is not None:
            self._pass_by(keyframes[self.first :])
            keyframes[-1].distrust_sight()

    @staticmethod
    def _pass_by(keyframes: list[Keyframe]) -> None:
        """Note that consecutive keyframes have led to no start."""
        for before, keyframe in pairwise(keyframes):
            before.distrust_sight()
            keyframe.lost = True

    def _move_anchor(self, keyframes: list[Keyframe], to: Keyframe) -> None:
        """Coast the anchor on to a later keyframe: the search has outlasted the stretch that it looks at."""
        assert self.anchor is not None
        limits, passed = self.model.settings.recovery, keyframes[self.first + 1 : to.index + 1]
        state = coast_through(self.anchor.state, passed, limits.memory_s)
        self._pass_by(keyframes[self.first : to.index + 1])
        time = (to.stamp_ns - keyframes[self.first].stamp_ns) * 1e-9
        turn_on, gap_s = self.model.gyro_turn_on, time_missing(keyframe.segment for keyframe in passed)
        covariance = grown_covariance(self.anchor.covariance, time, limits, turn_on, gap_s)
        self.model.start_prior.pop(self.first, None)
        self.first, self.anchor = to.index, Anchor(state, covariance)


def is_metric(stretch: list[Keyframe], settings: GtsamViSettings) -> bool:
    """Whether two cameras see enough tracks in common to determine the scale."""
    return _seen_twice(stretch[-1].observations) >= settings.initialisation.min_tracks


def is_worth_a_try(stretch: list[Keyframe], settings: GtsamViSettings) -> bool:
    """Whether there are enough tracks, keyframes and time (with one camera, time in motion) to attempt a start."""
    metric = is_metric(stretch, settings)
    if metric:
        least, least_s = settings.initialisation.stereo_keyframes, settings.initialisation.stereo_s
    else:
        least, least_s = settings.initialisation.min_keyframes, settings.initialisation.min_s
    elapsed = sum(k.segment.duration for k in stretch[1:] if metric or not k.stationary)
    if len(stretch) < least or elapsed < least_s:
        return False
    counts = np.unique(np.concatenate([k.observations.rows()[0] for k in stretch]), return_counts=True)[1]
    return int(np.count_nonzero(counts >= settings.landmarks.min_views)) >= settings.initialisation.min_tracks


def find_start(model: Model, stretch: list[Keyframe], anchor: State | None, max_scale_sigma: float) -> Bundle | None:
    """Adjust a stretch, its first keyframe at the anchor; None if it does not fit or its scale is uncertain."""
    settings = model.settings
    share = 1.0 if anchor is None else settings.recovery.known_bias
    start = closed_form_start(
        [k.observations for k in stretch],
        [k.segment for k in stretch[1:]],
        model.rig.T_imu_cams,
        model.imu.gravity,
        share * model.gyro_turn_on,
        share * model.accel_turn_on,
        settings.noise.pixel_sigma_px / model.rig.focal,
        gtsam.imuBias.ConstantBias() if anchor is None else anchor.bias,
    )
    try:
        bundle = adjust(model, stretch, states_of(start, anchor), settings.initialisation.gates_px)
    except RuntimeError:  # GTSAM: the system of equations cannot be solved
        return None
    if len(bundle.landmarks) < settings.initialisation.min_tracks:
        return None
    if not np.median(bundle.errors_px) <= settings.initialisation.max_error_px:
        return None
    # Drifting silt may fit only if gravity points elsewhere, which a huge bias of the accelerometer then explains.
    bias = read_state(bundle.values, stretch[-1].index).bias
    if model.bias_sigmas(bias) > settings.recovery.max_bias_sigmas:
        return None
    if not is_metric(stretch, settings) and not scale_sigma(bundle, stretch) <= max_scale_sigma:
        return None
    return bundle


def _seen_twice(view: Observations) -> int:
    """Number of tracks that both cameras see."""
    return 0 if view.right is None else int(np.isfinite(view.right[:, 0]).sum())


def scale_sigma(bundle: Bundle, keyframes: list[Keyframe]) -> float:
    """Relative 1-sigma uncertainty of scale: that of the longest displacement from the first keyframe, along it."""
    poses = [bundle.values.atPose3(X(k.index)) for k in keyframes]
    offsets = np.array([pose.translation() for pose in poses]) - poses[0].translation()
    far = int(np.argmax(np.linalg.norm(offsets, axis=1)))
    length = float(np.linalg.norm(offsets[far]))
    if length < 1e-3:
        return float("inf")
    try:
        covariance = joint_covariance(bundle.graph, bundle.values, [X(keyframes[0].index), X(keyframes[far].index)])
    except RuntimeError:
        return float("inf")
    along = offsets[far] / length
    # GTSAM has the translation in the axes of the pose itself, after the rotation.
    slope = np.zeros(12)
    slope[3:6] = -poses[0].rotation().matrix().T @ along
    slope[9:12] = poses[far].rotation().matrix().T @ along
    return float(np.sqrt(slope @ covariance @ slope)) / length
