"""The factor graph: states and their keys, factors, landmarks from rays, and bundle adjustment of a stretch of it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import gtsam
import numpy as np
from gtsam.symbol_shorthand import B, L, V, X
from numpy.typing import NDArray

from oysterbench.core.geometry import Array, invert
from oysterbench.sequence.types import CameraCalibration, ImuCalibration
from oysterbench_baselines.common.inertial import Segment
from oysterbench_baselines.gtsam_vi.frontend import homogeneous
from oysterbench_baselines.gtsam_vi.inertial import preintegrate, preintegration_params
from oysterbench_baselines.gtsam_vi.settings import Settings
from oysterbench_baselines.gtsam_vi.states import Keyframe, State, insert_state, read_state

LEAST = np.array([1e-4] * 3 + [1e-4] * 3)
"""rad and m, 1 sigma: what the start is held with where it is exact by definition."""


class Model:
    """Noise models, calibrations and the factors made of them. right: a second camera, which sees the same.

    starts: by the key frame at which a graph begins, covariances of its pose (6, 6) and velocity (3, 3) in odom's axes;
    where there are none, nothing is known but the gauge.
    """

    def __init__(
        self,
        camera: CameraCalibration,
        imu: ImuCalibration,
        settings: Settings,
        right: CameraCalibration | None = None,
    ) -> None:
        self.settings = settings
        self.imu = imu
        self.focal = float(camera.matrix[0, 0] + camera.matrix[1, 1]) / 2
        cameras = [camera] if right is None else [camera, right]
        self.T_imu_cams = np.array([invert(imu.T_base_imu) @ c.T_base_cam for c in cameras])
        self.T_imu_cam = self.T_imu_cams[0]
        self.params = preintegration_params(imu, settings)
        # Rays at depth 1 are pixels of a camera with unit focal length; the front end has dealt with distortion.
        self._unit_camera = gtsam.Cal3_S2()
        self._sensors = [gtsam.Pose3(T_imu_cam) for T_imu_cam in self.T_imu_cams]
        self.starts: dict[int, tuple[Array, Array]] = {}
        self._rest = gtsam.noiseModel.Isotropic.Sigma(3, settings.rest_speed)
        # A file may say that the unit has no turn-on bias; a little is left, for what its model leaves out.
        self.gyro_turn_on = max(imu.gyro_turn_on, 1e-4)
        self.accel_turn_on = max(imu.accel_turn_on, 1e-3)

    def pixel(self, spread: float = 1.0) -> gtsam.noiseModel.Base:
        """Of a ray at depth 1, its sigma `spread` times the usual one."""
        settings = self.settings
        noise = gtsam.noiseModel.Isotropic.Sigma(2, spread * settings.pixel_sigma_px / self.focal)
        return gtsam.noiseModel.Robust.Create(gtsam.noiseModel.mEstimator.Huber.Create(settings.huber), noise)

    def alike(self, times: float) -> float:
        """How many times their sigmas corners count for in a reported covariance, `times` being that of one camera: a
        second one takes over what the patches of the first have drifted."""
        return times * float(np.sqrt(len(self.T_imu_cams))) if times > 1.0 else 1.0

    def projection(
        self, keyframe: int, landmark: int, ray: Array, camera: int, noise: gtsam.noiseModel.Base
    ) -> gtsam.NonlinearFactor:
        """A landmark seen along `ray` (2,) at depth 1. Behind the camera it has no gradient, and raises nothing."""
        return gtsam.GenericProjectionFactorCal3_S2(
            ray, noise, X(keyframe), L(landmark), self._unit_camera, False, False, self._sensors[camera]
        )

    def inertial(
        self, before: int, after: int, segment: Segment, bias: gtsam.imuBias.ConstantBias
    ) -> gtsam.NonlinearFactor:
        """Preintegrated measurements between two key frames."""
        measurements = preintegrate(segment, bias, self.params)
        return gtsam.CombinedImuFactor(X(before), V(before), X(after), V(after), B(before), B(after), measurements)

    def step(
        self, keyframe: Keyframe, before: State, state: State, bias: gtsam.imuBias.ConstantBias
    ) -> list[gtsam.NonlinearFactor]:
        """All that ties a key frame to the one before it, given the states of both."""
        k, settings = keyframe.index, self.settings
        if keyframe.trusted:
            return [self.inertial(k - 1, k, keyframe.segment, bias), *keyframe.aiding]
        time = max(keyframe.segment.duration, settings.keyframe_min_s)
        moved = np.repeat([settings.unknown_rate, settings.unknown_speed], 3) * time
        turn_on = np.array([self.accel_turn_on] * 3 + [self.gyro_turn_on] * 3)
        diagonal = gtsam.noiseModel.Diagonal.Sigmas
        return [
            gtsam.BetweenFactorPose3(X(k - 1), X(k), before.nav.pose().between(state.nav.pose()), diagonal(moved)),
            gtsam.PriorFactorVector(V(k), state.nav.velocity(), gtsam.noiseModel.Isotropic.Sigma(3, 2.0)),
            gtsam.BetweenFactorConstantBias(B(k - 1), B(k), gtsam.imuBias.ConstantBias(), diagonal(turn_on)),
        ]

    def rest(self, keyframe: int) -> gtsam.NonlinearFactor:
        """No velocity."""
        return gtsam.PriorFactorVector(V(keyframe), np.zeros(3), self._rest)

    def shared(self) -> Mapping[int, Array]:
        """Variables that are in every graph, by key, with their values at first: here none."""
        return {}

    def shared_priors(self) -> list[gtsam.NonlinearFactor]:
        """What is known of them beforehand."""
        return []

    def ground(
        self, keyframes: list[Keyframe], states: list[State], ids: NDArray[np.int64], points: Array
    ) -> list[gtsam.NonlinearFactor]:
        """Factors between key frames and landmarks (L,) at points (L, 3) that other sensors have met: here none."""
        return []

    def start_priors(self, keyframe: int, state: State) -> list[gtsam.NonlinearFactor]:
        """What is known of the state at which a graph begins; of the first of all, that it is the origin and ahead."""
        rotation = state.nav.attitude().matrix()
        of_pose, of_velocity = self.starts.get(
            keyframe, (np.diag([0.0] * 3 + [0.5**2] * 2 + [0.0]), np.eye(3) * 2.0**2)
        )
        # GTSAM states rotation before translation, both in the axes of the pose itself.
        turn = np.zeros((6, 6))
        turn[:3, 3:] = turn[3:, :3] = rotation.T
        pose = turn @ of_pose @ turn.T + np.diag(LEAST**2)
        turn_on = np.array([self.accel_turn_on] * 3 + [self.gyro_turn_on] * 3)
        return [
            gtsam.PriorFactorPose3(X(keyframe), state.nav.pose(), gtsam.noiseModel.Gaussian.Covariance(pose)),
            gtsam.PriorFactorVector(
                V(keyframe), state.nav.velocity(), gtsam.noiseModel.Gaussian.Covariance(of_velocity)
            ),
            gtsam.PriorFactorConstantBias(
                B(keyframe), gtsam.imuBias.ConstantBias(), gtsam.noiseModel.Diagonal.Sigmas(turn_on)
            ),
        ]

    def triangulate(
        self,
        track: NDArray[np.int64],
        rays: Array,
        T_odom_imu: Array,
        max_error_px: float,
        camera: NDArray[np.intp] | None = None,
    ) -> tuple[NDArray[np.int64], Array]:
        """Ids (L,) and points (L, 3) of the tracks that make good landmarks.

        track (M,), rays (M, 2), T_odom_imu (M, 4, 4) and camera (M,), the first by default: one row a view. The point
        minimises the distances from its rays, weighted by inverse depth; it must have parallax, lie before every view
        and project near every ray.
        """
        settings = self.settings
        order = np.argsort(track, kind="stable")
        T_imu_cams = self.T_imu_cam if camera is None else self.T_imu_cams[camera[order]]
        track, rays, cameras = track[order], rays[order], T_odom_imu[order] @ T_imu_cams
        if len(track) == 0:
            return track, np.empty((0, 3))
        ids, starts, row = np.unique(track, return_index=True, return_inverse=True)
        directions = homogeneous(rays)
        directions /= np.linalg.norm(directions, axis=1, keepdims=True)
        directions = np.einsum("mij,mj->mi", cameras[:, :3, :3], directions)
        centres = cameras[:, :3, 3]
        across = np.eye(3) - directions[:, :, None] * directions[:, None, :]
        weight = np.ones(len(track))
        for _ in range(2):
            information = np.add.reduceat(across * weight[:, None, None], starts) + np.eye(3) * 1e-9
            right = np.add.reduceat((across @ centres[:, :, None])[..., 0] * weight[:, None], starts)
            points = np.linalg.solve(information, right[:, :, None])[..., 0]
            weight = 1.0 / np.maximum(np.einsum("mi,mi->m", points[row] - centres, directions), 0.1) ** 2
        local = np.einsum("mji,mj->mi", cameras[:, :3, :3], points[row] - centres)
        depth = local[:, 2]
        error = np.linalg.norm(local[:, :2] / np.maximum(depth, 1e-6)[:, None] - rays, axis=1) * self.focal
        angle = np.degrees(np.arccos(np.clip(np.einsum("mi,mi->m", directions, directions[starts][row]), -1, 1)))
        good = np.maximum.reduceat(angle, starts) >= settings.min_ray_angle_deg
        good &= np.minimum.reduceat(depth, starts) > settings.min_depth_m
        good &= np.maximum.reduceat(depth, starts) < settings.max_depth_m
        good &= np.maximum.reduceat(error, starts) < max_error_px
        return ids[good], points[good]

    def errors_px(self, T_odom_imu: Array, points: Array, rays: Array, camera: int | NDArray[np.intp] = 0) -> Array:
        """Reprojection errors (N,) px of points (N, 3) seen along rays (N, 2) from poses (4, 4) or (N, 4, 4) by a
        camera, or one each (N,)."""
        cameras = invert(T_odom_imu @ self.T_imu_cams[camera])
        local = np.einsum("...ij,...j->...i", cameras[..., :3, :3], points) + cameras[..., :3, 3]
        error = np.linalg.norm(local[:, :2] / np.maximum(local[:, 2:], 1e-6) - rays, axis=1) * self.focal
        return np.where(local[:, 2] > 0, error, np.inf)


@dataclass(frozen=True)
class Bundle:
    """An adjusted stretch: the graph, its values, the ids of its landmarks (L,), reprojection errors (M,) px."""

    graph: gtsam.NonlinearFactorGraph
    values: gtsam.Values
    landmarks: NDArray[np.int64]
    errors_px: Array


def adjust(
    model: Model, keyframes: list[Keyframe], states: list[State], gates_px: tuple[float, ...], min_views: int = 1
) -> Bundle:
    """Visual-inertial bundle adjustment of consecutive key frames from given states.

    Landmarks are triangulated anew and adjusted once for each gate on their reprojection error: wide first, while the
    states are rough. min_views: key frames that must have seen a landmark.
    """
    sights = [k.view.sights() for k in keyframes]
    row = np.concatenate([np.full(len(ids), n) for n, (ids, _, _) in enumerate(sights)])
    track, rays, camera = (np.concatenate(part) for part in zip(*sights, strict=True))
    seen_often = np.isin(track, _seen_in([k.view.ids for k in keyframes], min_views))
    row, track, rays, camera = row[seen_often], track[seen_often], rays[seen_often], camera[seen_often]
    noises = [model.pixel(k.view.spread) for k in keyframes]
    first = keyframes[0].index
    for gate in gates_px:
        poses = np.array([state.matrix for state in states])
        ids, points = model.triangulate(track, rays, poses[row], gate, camera)
        graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
        for factor in model.start_priors(first, states[0]):
            graph.push_back(factor)
        for factor in model.shared_priors():
            graph.push_back(factor)
        for key, value in model.shared().items():
            values.insert(key, value)
        for keyframe, state in zip(keyframes, states, strict=True):
            insert_state(values, keyframe.index, state)
            if keyframe.index > first:
                # Integrated about one bias for all: the average, whose corrections are smallest.
                before = states[keyframe.index - first - 1]
                for factor in model.step(keyframe, before, state, states[-1].bias):
                    graph.push_back(factor)
            if keyframe.at_rest:
                graph.push_back(model.rest(keyframe.index))
        for landmark, point in zip(ids, points, strict=True):
            values.insert(L(int(landmark)), point)
        seen = np.flatnonzero(np.isin(track, ids))
        for m in seen:
            graph.push_back(
                model.projection(first + int(row[m]), int(track[m]), rays[m], int(camera[m]), noises[row[m]])
            )
        for factor in model.ground(keyframes, states, ids, points):
            graph.push_back(factor)
        values = _optimise(graph, values, model.settings.smoothing_iterations)
        states = [read_state(values, k.index) for k in keyframes]
    poses = np.array([state.matrix for state in states])
    points = np.array([values.atPoint3(L(int(i))) for i in ids]).reshape(-1, 3)
    errors = model.errors_px(poses[row[seen]], points[np.searchsorted(ids, track[seen])], rays[seen], camera[seen])
    return Bundle(graph, values, ids, errors)


def _seen_in(ids: list[NDArray[np.int64]], least: int) -> NDArray[np.int64]:
    """Ids that are in so many of the lists."""
    found, counts = np.unique(np.concatenate(ids), return_counts=True)
    return found[counts >= least]


def nested_dissection(graph: gtsam.NonlinearFactorGraph) -> gtsam.Ordering:
    """An order of elimination by METIS (Karypis & Kumar 1998), which cuts a path of many passes across all of them.

    A third of the memory that COLAMD's takes. METIS writes beyond its arrays where a variable shares no factor with any
    other (a calibration that nothing measures), so these are kept from it, and come last.
    """
    linked, known = gtsam.NonlinearFactorGraph(), set[int]()
    for n in range(graph.size()):
        factor = graph.at(n)
        keys = set(factor.keys())
        if len(keys) > 1:
            linked.push_back(factor)
            known |= keys
    ordering = gtsam.Ordering.MetisNonlinearFactorGraph(linked) if known else gtsam.Ordering()
    for key in graph.keyVector():
        if key not in known:
            ordering.push_back(key)
    return ordering


def _optimise(graph: gtsam.NonlinearFactorGraph, values: gtsam.Values, iterations: int) -> gtsam.Values:
    params = gtsam.LevenbergMarquardtParams()
    params.setMaxIterations(iterations)
    params.setRelativeErrorTol(1e-4)
    params.setOrdering(nested_dissection(graph))
    return gtsam.LevenbergMarquardtOptimizer(graph, values, params).optimize()
