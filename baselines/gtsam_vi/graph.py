"""The factor graph: factors of motion and priors, and bundle adjustment of a stretch of key frames."""

from __future__ import annotations

from copy import copy
from dataclasses import dataclass

import gtsam
import numpy as np
from gtsam.symbol_shorthand import B, L, V, X
from numpy.typing import NDArray

from oysterbench.core.geometry import Array
from oysterbench.sequence.types import CameraCalibration, ImuCalibration
from oysterbench_baselines.common.aiding import Aiding
from oysterbench_baselines.gtsam_vi.calibration import CLOCK, LAST, CameraUncertainty
from oysterbench_baselines.gtsam_vi.cameras import CameraRig
from oysterbench_baselines.gtsam_vi.clock import clocked, moved_on
from oysterbench_baselines.gtsam_vi.preintegration import inertial_factor, preintegration_params
from oysterbench_baselines.gtsam_vi.settings import GtsamViSettings
from oysterbench_baselines.gtsam_vi.states import Keyframe, State, insert_state, read_state

LEAST = np.array([1e-4] * 3 + [1e-4] * 3)
"""rad and m, 1 sigma: what the start is held with where it is exact by definition."""


class Model:
    """Calibrations, noise models and the factors made of them. aiding: the sensors beside cameras and inertial unit.

    uncertainty: of the cameras, which are then calibrated online.
    initial_covariances: by the key frame at which a graph begins, of its pose (6, 6) and velocity (3, 3) in odom's
    axes; where there are none, nothing is known but the gauge.
    """

    def __init__(
        self,
        cameras: list[CameraCalibration],
        imu: ImuCalibration,
        settings: GtsamViSettings,
        aiding: Aiding | None = None,
        uncertainty: CameraUncertainty | None = None,
    ) -> None:
        self.settings = settings
        self.imu = imu
        self.rig = CameraRig(cameras, imu, uncertainty)
        self.aiding = aiding or Aiding()
        self.params = preintegration_params(imu, settings.noise)
        self.initial_covariances: dict[int, tuple[Array, Array]] = {}
        # A file may say that the unit has no turn-on bias; a little is left, for what its model leaves out.
        self.gyro_turn_on = max(imu.gyro_turn_on, 1e-4)
        self.accel_turn_on = max(imu.accel_turn_on, 1e-3)

    def inertial(
        self, previous: Keyframe, keyframe: Keyframe, bias: gtsam.imuBias.ConstantBias
    ) -> gtsam.NonlinearFactor:
        """What the inertial measurements between two key frames say of their states."""
        factor = inertial_factor(keyframe.index - 1, keyframe.index, keyframe.segment, bias, self.params)
        if not self.rig.clock_is_free:
            return factor
        after = keyframe.rates
        assert after is not None
        return clocked(factor, CLOCK, (previous.rates or after, after), self.imu.gravity)

    def at_stamp(self, keyframe: Keyframe, state: State) -> State:
        """The state at a key frame's stamp from that when its picture was taken."""
        rates = keyframe.rates
        return state if rates is None else moved_on(state, self.rig.clock_s, rates, self.imu.gravity)

    def when_taken(self, keyframe: Keyframe, state: State) -> State:
        """The other way round."""
        rates = keyframe.rates
        return state if rates is None else moved_on(state, -self.rig.clock_s, rates, self.imu.gravity)

    def motion(
        self,
        previous: Keyframe,
        keyframe: Keyframe,
        before: State,
        state: State,
        bias: gtsam.imuBias.ConstantBias,
    ) -> list[gtsam.NonlinearFactor]:
        """All that ties a key frame to the one before it, given the states of both."""
        k, settings = keyframe.index, self.settings
        if keyframe.trusted:
            drag = [self.drag(keyframe)] if keyframe.blind else []
            return [self.inertial(previous, keyframe, bias), *drag, *keyframe.aiding]
        time = max(keyframe.segment.duration, settings.keyframes.min_s)
        moved = np.repeat([settings.recovery.unknown_rate, settings.recovery.unknown_speed], 3) * time
        turn_on = np.array([self.accel_turn_on] * 3 + [self.gyro_turn_on] * 3)
        diagonal = gtsam.noiseModel.Diagonal.Sigmas
        return [
            gtsam.BetweenFactorPose3(X(k - 1), X(k), before.nav.pose().between(state.nav.pose()), diagonal(moved)),
            gtsam.PriorFactorVector(V(k), state.nav.velocity(), gtsam.noiseModel.Isotropic.Sigma(3, 2.0)),
            gtsam.BetweenFactorConstantBias(B(k - 1), B(k), gtsam.imuBias.ConstantBias(), diagonal(turn_on)),
        ]

    def zero_velocity(self, keyframe: int) -> gtsam.NonlinearFactor:
        """Zero-velocity update."""
        return gtsam.PriorFactorVector(
            V(keyframe), np.zeros(3), gtsam.noiseModel.Isotropic.Sigma(3, self.settings.zero_velocity.sigma)
        )

    def drag(self, keyframe: Keyframe) -> gtsam.NonlinearFactor:
        """Of a key frame that sees next to nothing: no vehicle is fast for long in water, whatever the inertial unit
        says. Over `memory_s` together as much as one measurement of speed zero."""
        limits, time = self.settings.recovery, max(keyframe.segment.duration, self.settings.keyframes.min_s)
        sigma = limits.unknown_speed * float(np.sqrt(max(limits.memory_s / time, 1.0)))
        return gtsam.PriorFactorVector(V(keyframe.index), np.zeros(3), gtsam.noiseModel.Isotropic.Sigma(3, sigma))

    def calibration_priors(self) -> list[gtsam.NonlinearFactor]:
        """What is known beforehand of the calibrations of cameras and aiding sensors."""
        diagonal = gtsam.noiseModel.Diagonal.Sigmas
        aiding = [gtsam.PriorFactorVector(c.key, c.value, diagonal(c.sigmas)) for c in self.aiding.calibrations()]
        return [*self.rig.prior(self.settings.noise), *aiding]

    def calibration_keys(self) -> list[int]:
        """Of all calibrations that are variables."""
        return [*self.rig.keys(), *(calibration.key for calibration in self.aiding.calibrations())]

    def start_priors(self, keyframe: int, state: State) -> list[gtsam.NonlinearFactor]:
        """What is known of the state at which a graph begins; of the first of all, that it is the origin and ahead."""
        rotation = state.nav.attitude().matrix()
        of_pose, of_velocity = self.initial_covariances.get(
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
    rig, settings = copy(model.rig), model.settings
    rows = [k.observations.rows() for k in keyframes]
    row = np.concatenate([np.full(len(ids), n) for n, (ids, _, _) in enumerate(rows)])
    track, rays, camera = (np.concatenate(part) for part in zip(*rows, strict=True))
    seen_often = np.isin(track, _seen_in([k.observations.ids for k in keyframes], min_views))
    row, track, rays, camera = row[seen_often], track[seen_often], rays[seen_often], camera[seen_often]
    noises = [rig.pixel_noise(settings.noise, k.observations.inflation) for k in keyframes]
    first = keyframes[0].index
    for gate in gates_px:
        poses = np.array([state.matrix for state in states])
        ids, points = rig.triangulate(track, rays, poses[row], gate, settings.landmarks, camera)
        graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
        for factor in model.start_priors(first, states[0]):
            graph.push_back(factor)
        for factor in model.calibration_priors():
            graph.push_back(factor)
        for calibration in model.aiding.calibrations():
            values.insert(calibration.key, calibration.value)
        rig.insert(values)
        for n, (keyframe, state) in enumerate(zip(keyframes, states, strict=True)):
            insert_state(values, keyframe.index, state)
            if n:
                # Integrated about one bias for all: the average, whose corrections are smallest.
                for factor in model.motion(keyframes[n - 1], keyframe, states[n - 1], state, states[-1].bias):
                    graph.push_back(factor)
            if keyframe.stationary:
                graph.push_back(model.zero_velocity(keyframe.index))
        for landmark, point in zip(ids, points, strict=True):
            values.insert(L(int(landmark)), point)
        seen = np.flatnonzero(np.isin(track, ids))
        views = (first + row[seen]).tolist(), track[seen].tolist(), rays[seen], camera[seen]
        for factor in rig.projection_factors(*views, [noises[n] for n in row[seen]]):
            graph.push_back(factor)
        for factor in model.aiding.stretch_factors(keyframes, states, ids, points):
            graph.push_back(factor)
        values = _optimise(graph, values, settings.smoothing.iterations)
        states = [read_state(values, k.index) for k in keyframes]
        rig.read(values)
    poses = np.array([state.matrix for state in states])
    points = np.array([values.atPoint3(L(int(i))) for i in ids]).reshape(-1, 3)
    errors = rig.errors_px(poses[row[seen]], points[np.searchsorted(ids, track[seen])], rays[seen], camera[seen])
    return Bundle(graph, values, ids, errors)


def _seen_in(ids: list[NDArray[np.int64]], least: int) -> NDArray[np.int64]:
    """Ids that are in so many of the lists."""
    found, counts = np.unique(np.concatenate(ids), return_counts=True)
    return found[counts >= least]


def nested_dissection(graph: gtsam.NonlinearFactorGraph) -> gtsam.Ordering:
    """An order of elimination by METIS (Karypis & Kumar 1998), which cuts a path of many passes across all of them.

    A third of the memory that COLAMD's takes. METIS writes beyond its arrays where a variable shares no factor with any
    other (a calibration that nothing measures), so these are kept from it, and come last. So do the cameras, which all
    landmarks share.
    """
    linked, known = gtsam.SymbolicFactorGraph(), set[int]()
    for n in range(graph.size()):
        keys = {key for key in graph.at(n).keys() if key >> 56 not in LAST}  # noqa: SIM118 (no dictionary)
        if len(keys) > 1:
            linked.push_back(gtsam.SymbolicFactor.FromKeys(sorted(keys)))
            known |= keys
    ordering = gtsam.Ordering.MetisSymbolicFactorGraph(linked) if known else gtsam.Ordering()
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
