"""Fixed-lag smoother over the latest key frames and the landmarks that they see.

Landmarks are variables of their own, not smart factors: a smart factor that keeps a pose that has left the window
breaks the marginalisation. What leaves the window stays as a linear factor on its neighbours, landmarks still in view
among them, so that no measurement is used twice and none is dropped.
"""

from __future__ import annotations

import gtsam
import numpy as np
from gtsam.symbol_shorthand import B, L, V, X

from oysterbench.geometry import Array
from oysterbench_baselines.gtsam_vi.graph import Bundle, Model
from oysterbench_baselines.gtsam_vi.states import Keyframe, State, insert_state, read_state


class Window:
    """The smoother, started from an adjusted stretch of key frames."""

    def __init__(self, model: Model, keyframes: list[Keyframe], bundle: Bundle) -> None:
        self.model = model
        settings = model.settings
        params = gtsam.LevenbergMarquardtParams()
        params.setMaxIterations(settings.lag_iterations)
        params.setRelativeErrorTol(1e-3)
        # The smoother's clock counts key frames: at rest they are seconds apart, in motion a tenth of one.
        self._smoother = gtsam.BatchFixedLagSmoother(float(settings.lag_keyframes), params)
        self._observations: dict[int, list[tuple[int, Array]]] = {}
        self._landmarks = {int(i) for i in bundle.landmarks}
        self._rejected: set[int] = set()
        for keyframe in keyframes:
            self._remember(keyframe)
        self.lost_share = 0.0
        last = keyframes[-1].index
        stamps = {}
        for keyframe in keyframes:
            for key in (X, V, B):
                stamps[key(keyframe.index)] = float(keyframe.index)
        for landmark in self._landmarks:
            stamps[L(landmark)] = float(self._observations[landmark][-1][0])
        stamps |= dict.fromkeys(model.shared(), float(last))
        self._smoother.update(bundle.graph, bundle.values, stamps)
        self._read(keyframes, last)

    def add(self, keyframes: list[Keyframe], predicted: State) -> None:
        """Add the last of `keyframes`, whose state is `predicted`, and bring all states in the window up to date."""
        keyframe = keyframes[-1]
        k = keyframe.index
        graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
        stamps = {key(k): float(k) for key in (X, V, B)}
        insert_state(values, k, predicted)
        graph.push_back(self.model.inertial(k - 1, k, keyframe.segment, keyframes[-2].state.bias))
        if keyframe.at_rest:
            graph.push_back(self.model.rest(k))
        for factor in keyframe.aiding:
            graph.push_back(factor)
        stamps |= dict.fromkeys(self.model.shared(), float(k))  # they never leave
        keyframe.state = predicted
        self._remember(keyframe)
        self._see_again(keyframe, graph, stamps)
        self._see_first(keyframes, graph, values, stamps)
        self._smoother.update(graph, values, stamps)
        self._read(keyframes, k)
        self._landmarks = {i for i in self._landmarks if self._observations[i][-1][0] > k - self._lag}
        self._observations = {i: o for i, o in self._observations.items() if o[-1][0] > k - self._lag}

    def joint(self, keys: list[int]) -> tuple[gtsam.Values, gtsam.JointMarginal]:
        """The estimate, and the joint covariance of some of its variables."""
        values = self._smoother.calculateEstimate()
        return values, gtsam.Marginals(self._smoother.getFactors(), values).jointMarginalCovariance(keys)

    @property
    def _lag(self) -> int:
        return self.model.settings.lag_keyframes

    def _remember(self, keyframe: Keyframe) -> None:
        for landmark, ray in zip(keyframe.view.ids, keyframe.view.rays, strict=True):
            self._observations.setdefault(int(landmark), []).append((keyframe.index, ray))

    def _see_again(self, keyframe: Keyframe, graph: gtsam.NonlinearFactorGraph, stamps: dict[int, float]) -> None:
        """Views of landmarks in the window; those far from the prediction have slid off their point."""
        settings = self.model.settings
        known = [n for n, i in enumerate(keyframe.view.ids) if int(i) in self._landmarks]
        if not known:
            self.lost_share = 0.0
            return
        points = np.array([self._points[int(i)] for i in keyframe.view.ids[known]])
        errors = self.model.errors_px(keyframe.state.matrix, points, keyframe.view.rays[known])
        # The prediction may be off as a whole, after a long time without tracks: judge against the crowd.
        limit = settings.max_slide_px + 2.0 * float(np.median(errors))
        self.lost_share = float(np.mean(errors > settings.max_slide_px))
        for n, error in zip(known, errors, strict=True):
            landmark = int(keyframe.view.ids[n])
            if error > limit:
                self._rejected.add(landmark)
                self._landmarks.discard(landmark)
                continue
            graph.push_back(self.model.projection(keyframe.index, landmark, keyframe.view.rays[n]))
            stamps[L(landmark)] = float(keyframe.index)

    def _see_first(
        self,
        keyframes: list[Keyframe],
        graph: gtsam.NonlinearFactorGraph,
        values: gtsam.Values,
        stamps: dict[int, float],
    ) -> None:
        """Tracks that have come to have parallax become landmarks, with all their views in the window."""
        last = keyframes[-1].index
        oldest = max(keyframes[0].index, last - self._lag + 1)
        track, index, rays = [], [], []
        for i in keyframes[-1].view.ids:
            landmark = int(i)
            if landmark in self._landmarks or landmark in self._rejected:
                continue
            views = [(k, ray) for k, ray in self._observations[landmark] if k >= oldest]
            if len(views) < self.model.settings.min_views:
                continue
            track += [landmark] * len(views)
            index += [k for k, _ in views]
            rays += [ray for _, ray in views]
        if not track:
            return
        poses = {k: keyframes[k - keyframes[0].index].state.matrix for k in set(index)}
        rows = np.array(track, dtype=np.int64)
        ids, points = self.model.triangulate(
            rows, np.array(rays), np.array([poses[k] for k in index]), self.model.settings.max_landmark_error_px
        )
        for landmark, point in zip(ids, points, strict=True):
            values.insert(L(int(landmark)), point)
            stamps[L(int(landmark))] = float(last)
            self._landmarks.add(int(landmark))
        for landmark, k, ray in zip(track, index, rays, strict=True):
            if landmark in self._landmarks:
                graph.push_back(self.model.projection(k, landmark, ray))

    def _read(self, keyframes: list[Keyframe], last: int) -> None:
        """Write the smoother's estimate into the key frames."""
        values = self._smoother.calculateEstimate()
        for keyframe in keyframes[-self._lag :]:
            if values.exists(X(keyframe.index)):
                keyframe.state = read_state(values, keyframe.index)
        self._points = {i: values.atPoint3(L(i)) for i in self._landmarks if values.exists(L(i))}
        self._landmarks = set(self._points)
