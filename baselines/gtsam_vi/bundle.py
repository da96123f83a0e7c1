"""Bundle adjustment of a stretch of keyframes: their observations, the factor graph, and its optimum."""

from __future__ import annotations

from collections.abc import Collection
from copy import copy
from dataclasses import dataclass

import gtsam
import numpy as np
from gtsam.symbol_shorthand import L
from numpy.typing import NDArray

from oysterbench.core.geometry import Array
from oysterbench_baselines.gtsam_vi.cameras import CameraRig
from oysterbench_baselines.gtsam_vi.graph import Model, nested_dissection
from oysterbench_baselines.gtsam_vi.settings import LandmarkSettings
from oysterbench_baselines.gtsam_vi.states import Keyframe, State, insert_state, read_state


@dataclass(frozen=True)
class Bundle:
    """A bundle-adjusted stretch of keyframes: graph, values, landmark ids (L,), reprojection errors (M,) px."""

    graph: gtsam.NonlinearFactorGraph
    values: gtsam.Values
    landmarks: NDArray[np.int64]
    errors_px: Array


@dataclass(frozen=True)
class Views:
    """Observations of keyframes, one row per ray: index of the keyframe in the list (M,), track (M,), ray (M, 2) at
    depth 1, and camera (M,)."""

    row: NDArray[np.intp]
    track: NDArray[np.int64]
    rays: Array
    camera: NDArray[np.intp]

    @classmethod
    def of(cls, keyframes: list[Keyframe], min_views: int = 1) -> Views:
        """Collect the observations of the tracks that at least `min_views` keyframes have seen."""
        rows = [k.observations.rows() for k in keyframes]
        row = np.concatenate([np.full(len(ids), n) for n, (ids, _, _) in enumerate(rows)])
        track, rays, camera = (np.concatenate(part) for part in zip(*rows, strict=True))
        views = cls(row, track, rays, camera)
        return views.of_tracks(_seen_in([k.observations.ids for k in keyframes], min_views))

    def of_tracks(self, tracks: NDArray[np.int64]) -> Views:
        """Select the observations of these tracks (N,)."""
        own = np.isin(self.track, tracks)
        return Views(self.row[own], self.track[own], self.rays[own], self.camera[own])

    def triangulate(
        self, rig: CameraRig, poses: Array, gate_px: float, settings: LandmarkSettings
    ) -> tuple[NDArray[np.int64], Array]:
        """Triangulate the tracks from keyframe poses (K, 4, 4) into landmark ids (L,) and points (L, 3)."""
        return rig.triangulate(self.track, self.rays, poses[self.row], gate_px, settings, self.camera)

    def errors_px(self, rig: CameraRig, poses: Array, ids: NDArray[np.int64], points: Array) -> Array:
        """Reprojection errors (M,) px; every track must be one of the landmarks `ids` (L,), which are sorted."""
        return rig.errors_px(poses[self.row], points[np.searchsorted(ids, self.track)], self.rays, self.camera)


def motion_factors(
    model: Model, keyframes: list[Keyframe], states: list[State], part: range
) -> list[gtsam.NonlinearFactor]:
    """Factors that tie the keyframes of a part to their predecessors; for the first part, the priors as well."""
    factors: list[gtsam.NonlinearFactor] = []
    if part.start == 0:
        factors += [*model.start_priors(keyframes[0].index, states[0]), *model.calibration_priors()]
    for n in part:
        if n:
            # All are preintegrated about one bias, that of the last state.
            factors += model.motion(keyframes[n - 1], keyframes[n], states[n - 1], states[n], states[-1].bias)
        if keyframes[n].stationary and not keyframes[n].blind:
            factors.append(model.zero_velocity(keyframes[n].index))
    return factors


def add_views(
    graph: gtsam.NonlinearFactorGraph,
    model: Model,
    rig: CameraRig,
    keyframes: list[Keyframe],
    views: Views,
    times: float = 1.0,
) -> None:
    """Add the projection factors of views to a graph, with their sigma multiplied by `times`."""
    noise = model.settings.noise
    noises = [rig.pixel_noise(noise, times * k.observations.inflation) for k in keyframes]
    indices = (keyframes[0].index + views.row).tolist()
    of_rows = [noises[n] for n in views.row]
    for factor in rig.projection_factors(indices, views.track.tolist(), views.rays, views.camera, of_rows):
        graph.push_back(factor)


def values_of(
    model: Model,
    rig: CameraRig,
    keyframes: list[Keyframe],
    states: list[State],
    ids: NDArray[np.int64],
    points: Array,
) -> gtsam.Values:
    """Values of all variables: calibrations, keyframe states, and landmarks (L,) at points (L, 3)."""
    values = gtsam.Values()
    for calibration in model.aiding.calibrations():
        values.insert(calibration.key, calibration.value)
    rig.insert(values)
    for keyframe, state in zip(keyframes, states, strict=True):
        insert_state(values, keyframe.index, state)
    for landmark, point in zip(ids, points, strict=True):
        values.insert(L(int(landmark)), point)
    return values


def points_of(values: gtsam.Values, ids: Collection[int] | NDArray[np.int64]) -> Array:
    """Positions (L, 3) of landmarks (L,)."""
    return np.array([values.atPoint3(L(int(i))) for i in ids]).reshape(-1, 3)


def adjust(
    model: Model, keyframes: list[Keyframe], states: list[State], gates_px: tuple[float, ...], min_views: int = 1
) -> Bundle:
    """Run a visual-inertial bundle adjustment of consecutive keyframes, starting from given states.

    Landmarks are triangulated anew and adjusted once for each gate on their reprojection error: wide first, while the
    states are rough. min_views: keyframes that must have seen a landmark.
    """
    rig, settings = copy(model.rig), model.settings
    views = Views.of(keyframes, min_views)
    for gate in gates_px:
        poses = np.array([state.matrix for state in states])
        ids, points = views.triangulate(rig, poses, gate, settings.landmarks)
        graph = gtsam.NonlinearFactorGraph()
        values = values_of(model, rig, keyframes, states, ids, points)
        for factor in motion_factors(model, keyframes, states, range(len(keyframes))):
            graph.push_back(factor)
        seen = views.of_tracks(ids)
        add_views(graph, model, rig, keyframes, seen)
        for factor in model.aiding.stretch_factors(keyframes, states, ids, points):
            graph.push_back(factor)
        values = _optimise(graph, values, settings.smoothing.iterations)
        states = [read_state(values, k.index) for k in keyframes]
        rig.read(values)
    poses = np.array([state.matrix for state in states])
    return Bundle(graph, values, ids, seen.errors_px(rig, poses, ids, points_of(values, ids)))


def _seen_in(ids: list[NDArray[np.int64]], least: int) -> NDArray[np.int64]:
    """Ids that occur in at least `least` of the lists."""
    found, counts = np.unique(np.concatenate(ids), return_counts=True)
    return found[counts >= least]


def _optimise(graph: gtsam.NonlinearFactorGraph, values: gtsam.Values, iterations: int) -> gtsam.Values:
    params = gtsam.LevenbergMarquardtParams()
    params.setMaxIterations(iterations)
    params.setRelativeErrorTol(1e-4)
    params.setOrdering(nested_dissection(graph))
    return gtsam.LevenbergMarquardtOptimizer(graph, values, params).optimize()
