"""Fixed-lag smoother over the latest keyframes and the landmarks that they see.

Landmarks are variables of their own, not smart factors: a smart factor that keeps a pose that has left the window
breaks the marginalisation. What leaves the window stays as a linear factor on its neighbours, landmarks still in view
among them, so that no measurement is used twice and none is dropped.
"""

from __future__ import annotations

from typing import NamedTuple

import gtsam
import numpy as np
from gtsam.symbol_shorthand import B, L, V, X
from numpy.typing import NDArray

from oysterbench.core.geometry import Array
from oysterbench_baselines.gtsam_vi.bundle import Bundle
from oysterbench_baselines.gtsam_vi.covariance import joint_covariance
from oysterbench_baselines.gtsam_vi.fixed_lag import FixedLagSmoother
from oysterbench_baselines.gtsam_vi.graph import Model
from oysterbench_baselines.gtsam_vi.states import Keyframe, State, insert_state, read_state


class Observation(NamedTuple):
    """A view of a landmark: keyframe, camera, ray (2,) at depth 1, and noise model."""

    keyframe: int
    camera: int
    ray: Array
    noise: gtsam.noiseModel.Base


class Window:
    """The smoother, started from an adjusted stretch of keyframes."""

    def __init__(self, model: Model, keyframes: list[Keyframe], bundle: Bundle, weak_gauge: bool = False) -> None:
        """weak_gauge: as for the smoother, where a failure has left little known of the first pose."""
        self.model = model
        settings = model.settings
        # The smoother's clock counts keyframes: at rest they are seconds apart, in motion a tenth of one.
        self._smoother = FixedLagSmoother(settings.window.keyframes, settings.window.iterations, weak_gauge=weak_gauge)
        self._observations: dict[int, list[Observation]] = {}
        self._landmarks = {int(i) for i in bundle.landmarks}
        self._rejected: set[int] = set()
        for keyframe in keyframes:
            self._remember(keyframe)
        self.lost_share, self.misfits = 0.0, 0
        last = keyframes[-1].index
        stamps = {}
        for keyframe in keyframes:
            for key in (X, V, B):
                stamps[key(keyframe.index)] = float(keyframe.index)
        for landmark in self._landmarks:
            stamps[L(landmark)] = float(self._observations[landmark][-1].keyframe)
        stamps |= dict.fromkeys(model.calibration_keys(), float(last))
        self._smoother.update(bundle.graph, bundle.values, stamps, self._newest(last))
        self._read(keyframes)

    def add(self, keyframes: list[Keyframe], predicted: State) -> None:
        """Add the last of `keyframes`, whose state is `predicted`, and bring all states in the window up to date."""
        keyframe = keyframes[-1]
        k = keyframe.index
        graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
        stamps = {key(k): float(k) for key in (X, V, B)}
        insert_state(values, k, predicted)
        bias = keyframes[-2].estimate.bias
        graph.push_back(self.model.inertial(keyframes[-2], keyframe, bias))
        if keyframe.stationary:
            graph.push_back(self.model.zero_velocity(k))
        for factor in keyframe.aiding:
            graph.push_back(factor)
        stamps |= dict.fromkeys(self.model.calibration_keys(), float(k))  # calibrations never leave
        keyframe.state = predicted
        self._remember(keyframe)
        self.misfits = 0  # tracks of a blind keyframe that no point explains, although they have parallax
        self._observe_landmarks(keyframe, graph, stamps)
        self._triangulate_landmarks(keyframes, graph, values, stamps)
        if keyframe.blind:
            graph.push_back(self.model.drag(keyframe))
        self._smoother.update(graph, values, stamps, self._newest(k))
        self._read(keyframes)
        self._landmarks = {i for i in self._landmarks if self._observations[i][-1].keyframe > k - self._lag}
        self._observations = {i: o for i, o in self._observations.items() if o[-1].keyframe > k - self._lag}
        self._rejected &= self._observations.keys()

    def sees(self, ids: NDArray[np.int64]) -> bool:
        """Whether enough of these landmarks (N,) are in the window to constrain a pose."""
        return sum(int(i) in self._landmarks for i in ids) >= self.model.settings.recovery.min_landmarks

    def joint(self, keys: list[int]) -> tuple[gtsam.Values, Array]:
        """The estimate, and the joint covariance (N, N) of some of its variables, in the order of `keys`.

        Next to nothing for the state of the last keyframe with what it shares with the filter, in the order of
        `correct_filter`. Raises RuntimeError where the equations cannot be solved.
        """
        smoother = self._smoother
        found = smoother.joint(keys)
        if found is None:
            found = joint_covariance(smoother.factors, smoother.linearised_at, keys)
        return smoother.estimate, found

    def _newest(self, keyframe: int) -> list[int]:
        """Variables whose covariance is handed to the filter: those of its last keyframe, and shared ones."""
        return [key(keyframe) for key in (X, V, B)] + list(self.model.aiding.shared_states())

    @property
    def _lag(self) -> int:
        return self.model.settings.window.keyframes

    def _remember(self, keyframe: Keyframe) -> None:
        noise = self.model.rig.pixel_noise(self.model.settings.noise, keyframe.observations.inflation)
        for landmark, ray, camera in zip(*keyframe.observations.rows(), strict=True):
            self._observations.setdefault(int(landmark), []).append(
                Observation(keyframe.index, int(camera), ray, noise)
            )

    def _observe_landmarks(
        self, keyframe: Keyframe, graph: gtsam.NonlinearFactorGraph, stamps: dict[int, float]
    ) -> None:
        """Add views of landmarks in the window; those far from the prediction have slid off and are rejected."""
        settings = self.model.settings
        ids, rays, cameras = keyframe.observations.rows()
        known = [n for n, i in enumerate(ids) if int(i) in self._landmarks]
        measured = self.model.aiding.measures_velocity(keyframe.stamp_ns)
        keyframe.measured, keyframe.blind = measured, not measured
        if not known:
            self.lost_share = 0.0
            return
        points = np.array([self._points[int(i)] for i in ids[known]])
        errors = self.model.rig.errors_px(keyframe.estimate.matrix, points, rays[known], cameras[known])
        # After a long time without tracks the prediction may be off as a whole: judge against the median. A measured
        # velocity is better than any crowd that drifts with the water.
        crowd = 0.0 if measured else float(np.median(errors))
        limit = settings.landmarks.max_innovation_px + 2.0 * crowd
        self.lost_share = float(np.mean(errors > settings.landmarks.max_innovation_px))
        noise = self.model.rig.pixel_noise(self.model.settings.noise, keyframe.observations.inflation)
        slid = {int(ids[n]) for n, error in zip(known, errors, strict=True) if error > limit}
        self._rejected |= slid
        self._landmarks -= slid
        seen = [n for n in known if int(ids[n]) not in slid]
        landmarks, count = [int(ids[n]) for n in seen], len(seen)
        views = [keyframe.index] * count, landmarks, rays[seen], cameras[seen], [noise] * count
        for factor in self.model.rig.projection_factors(*views):
            graph.push_back(factor)
        stamps |= {L(landmark): float(keyframe.index) for landmark in landmarks}
        keyframe.blind &= len(set(landmarks)) < settings.recovery.min_landmarks

    def _triangulate_landmarks(
        self,
        keyframes: list[Keyframe],
        graph: gtsam.NonlinearFactorGraph,
        values: gtsam.Values,
        stamps: dict[int, float],
    ) -> None:
        """Turn tracks that have gained enough parallax into landmarks, with all their views in the window."""
        last = keyframes[-1].index
        oldest = max(keyframes[0].index, last - self._lag + 1)
        track: list[int] = []
        observations: list[Observation] = []
        for i in keyframes[-1].observations.ids:
            landmark = int(i)
            if landmark in self._landmarks or landmark in self._rejected:
                continue
            seen = [view for view in self._observations[landmark] if view.keyframe >= oldest]
            # A stereo pair sees a caustic where it lies on the bottom at that instant: only time gives it away.
            if len({view.keyframe for view in seen}) >= self.model.settings.landmarks.min_views:
                track += [landmark] * len(seen)
                observations += seen
        if not track:
            return
        poses = {k: keyframes[k - keyframes[0].index].estimate.matrix for k in {view.keyframe for view in observations}}
        track_of, rays = np.array(track, dtype=np.int64), np.array([view.ray for view in observations])
        poses_of = np.array([poses[view.keyframe] for view in observations])
        cameras = np.array([view.camera for view in observations])
        limits = self.model.settings.landmarks
        ids, points = self.model.rig.triangulate(track_of, rays, poses_of, limits.max_error_px, limits, cameras)
        if keyframes[-1].blind:
            spread = self.model.rig.spread_deg(track_of, rays, poses_of[:, :3, :3], cameras)
            self.misfits = int(np.count_nonzero(spread >= limits.min_ray_angle_deg)) - len(ids)
        for landmark, point in zip(ids, points, strict=True):
            values.insert(L(int(landmark)), point)
            stamps[L(int(landmark))] = float(last)
            self._landmarks.add(int(landmark))
        new = [n for n, landmark in enumerate(track) if landmark in self._landmarks]
        if not new:
            return
        views = [observations[n] for n in new]
        for factor in self.model.rig.projection_factors(
            [view.keyframe for view in views],
            [track[n] for n in new],
            np.array([view.ray for view in views]),
            np.array([view.camera for view in views]),
            [view.noise for view in views],
        ):
            graph.push_back(factor)

    def _read(self, keyframes: list[Keyframe]) -> None:
        """Write the smoother's estimate into the keyframes, and into the model of the cameras."""
        values = self._smoother.estimate
        self.model.rig.read(values)
        for keyframe in keyframes[-self._lag :]:
            if values.exists(X(keyframe.index)):
                keyframe.state = read_state(values, keyframe.index)
        self._points = {i: values.atPoint3(L(i)) for i in self._landmarks if values.exists(L(i))}
        self._landmarks = set(self._points)
