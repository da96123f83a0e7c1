"""Conversion of covariances from the tangents of GTSAM's variables to filter errors and to the poses of a trajectory.

GTSAM expresses a pose error in the axes of the pose itself, rotation first: R = R^ Exp(a), p = p^ + R^ b. The filter
(`common.filter`) has right-invariant errors about odom's axes, a trajectory has x y z and rotations about odom's axes.
Positions are relative to the first pose, which is exact by definition.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import gtsam
import numpy as np
from gtsam.symbol_shorthand import B, V, X

from oysterbench.core.geometry import Array, invert
from oysterbench_baselines.common.filter import (
    ACCEL_BIAS,
    ATTITUDE,
    CORE,
    FLOOR,
    GYRO_BIAS,
    POSITION,
    VELOCITY,
    InertialNoise,
    InvariantFilter,
    cross,
)
from oysterbench_baselines.common.inertial import Segment
from oysterbench_baselines.gtsam_vi.bundle import Bundle
from oysterbench_baselines.gtsam_vi.calibration import MODELS
from oysterbench_baselines.gtsam_vi.graph import Model
from oysterbench_baselines.gtsam_vi.marginals import marginal_covariances
from oysterbench_baselines.gtsam_vi.states import Frame, Keyframe, State, read_state

VIEWS = gtsam.GenericProjectionFactorCal3_S2, *(factor for _, factor, *_ in MODELS.values())
"""Types of the factors of a landmark in an image."""


def filter_slopes(state: State, k: int, size: int = CORE) -> dict[int, Array]:
    """Derivatives of the filter's error (size,) with respect to GTSAM's tangents of the pose, velocity and biases of
    keyframe k, by key."""
    rotation, velocity, position = state.nav.attitude().matrix(), state.nav.velocity(), state.nav.position()
    change = {key: np.zeros((size, columns)) for key, columns in ((X(k), 6), (V(k), 3), (B(k), 6))}
    change[X(k)][ATTITUDE, :3] = rotation
    change[X(k)][VELOCITY, :3] = cross(velocity) @ rotation
    change[X(k)][POSITION, :3] = cross(position) @ rotation
    change[X(k)][POSITION, 3:] = rotation
    change[V(k)][VELOCITY] = np.eye(3)
    change[B(k)][ACCEL_BIAS, :3] = change[B(k)][GYRO_BIAS, 3:] = np.eye(3)
    return change


def joint_covariance(graph: gtsam.NonlinearFactorGraph, values: gtsam.Values, keys: list[int]) -> Array:
    """Joint covariance (N, N) of some variables of a graph, in the order of `keys`.

    All others are eliminated once, which leaves the information of these. GTSAM's joint marginals eliminate twice.
    Raises RuntimeError where the equations cannot be solved.
    """
    linear = graph.linearize(values)
    ordering = gtsam.Ordering.ColamdConstrainedLastGaussianFactorGraph(linear, keys)
    others, last = gtsam.Ordering(), gtsam.Ordering()
    for n in range(ordering.size() - len(keys)):
        others.push_back(ordering.at(n))
    for key in keys:
        last.push_back(key)
    information, _ = linear.eliminatePartialMultifrontal(others)[1].hessian(last)
    try:
        return np.asarray(np.linalg.inv(information), dtype=float)
    except np.linalg.LinAlgError as error:
        raise RuntimeError(str(error)) from None


def filter_covariance(covariance: Array, slopes: Mapping[int, Array]) -> Array | None:
    """Covariance (N, N) of the filter's error, from the joint covariance of the variables and the `slopes` by their
    tangents; None if the result is not a covariance."""
    slope = np.hstack(list(slopes.values()))
    found = slope @ covariance @ slope.T
    if not np.isfinite(found).all() or np.linalg.eigvalsh(found)[0] < -1e-9:
        return None
    return 0.5 * (found + found.T)


def set_state(to: InvariantFilter, state: State) -> None:
    """Set the filter to a state; its covariance is left unchanged."""
    to.rotation, to.velocity = state.nav.attitude().matrix(), np.array(state.nav.velocity())
    to.position = np.array(state.nav.position())
    to.gyro_bias, to.accel_bias = np.array(state.bias.gyroscope()), np.array(state.bias.accelerometer())


def propagate_back(filter: InvariantFilter, segment: Segment) -> None:
    """Propagate the filter's state and covariance back to the start of a segment.

    The backward transition is the forward one with time reversed, but noise always adds.
    """
    noise, filter.noise = filter.noise, InertialNoise(0.0, 0.0, 0.0, 0.0)
    for dt, gyro, accel in reversed(list(zip(segment.dt, segment.gyro, segment.accel, strict=True))):
        filter.propagate(-dt, gyro, accel)
    filter.noise = noise
    time = segment.duration
    grown = np.zeros(CORE)
    grown[ATTITUDE] = noise.gyro**2 * time
    grown[VELOCITY] = noise.accel**2 * time
    grown[POSITION] = noise.accel**2 * time**3 / 3
    filter.covariance[:CORE, :CORE] += np.diag(grown)
    filter.forget(segment)


def discounted(graph: gtsam.NonlinearFactorGraph, times: float, huber: float) -> gtsam.NonlinearFactorGraph:
    """Return the graph with the sigma of every landmark view multiplied by `times`.

    The errors of a landmark's views are correlated, as its patch drifts: together they say less than their number
    suggests. Treating them as white still gives nearly the best estimate, but its covariance is that of fewer views.
    """
    if times == 1.0:
        return graph
    less = gtsam.NonlinearFactorGraph()
    for k in range(graph.size()):
        factor = graph.at(k)
        if isinstance(factor, VIEWS):
            view: Any = factor
            noise = gtsam.noiseModel.Isotropic.Sigma(2, times * view.noiseModel().noise().sigma())
            loss = gtsam.noiseModel.mEstimator.Huber.Create(huber)
            factor = view.cloneWithNewNoiseModel(gtsam.noiseModel.Robust.Create(loss, noise))
        less.push_back(factor)
    return less


def pose_covariances(bundle: Bundle, keyframes: list[Keyframe], lever: Array, model: Model) -> list[Array]:
    """Covariances (6, 6) of the pose of a frame fixed to the IMU at `lever` (3,), at every keyframe of a stretch."""
    graph = discounted(
        bundle.graph, model.rig.correlation(model.settings.noise.correlation), model.settings.noise.huber
    )
    marginals = marginal_covariances(graph, bundle.values, [X(keyframe.index) for keyframe in keyframes])
    return about_odom(marginals, bundle.values, keyframes, lever)


def about_odom(
    marginals: Mapping[int, Array], values: gtsam.Values, keyframes: list[Keyframe], lever: Array
) -> list[Array]:
    """Covariances as in `pose_covariances`, from those (6, 6) of the pose tangents by key."""
    found = []
    for keyframe in keyframes:
        rotation = values.atPose3(X(keyframe.index)).rotation().matrix()
        change = np.zeros((6, 6))
        change[:3, 3:] = change[3:, :3] = rotation
        change[:3, :3] = -cross(rotation @ lever) @ rotation
        covariance = change @ marginals[X(keyframe.index)] @ change.T + FLOOR
        found.append(0.5 * (covariance + covariance.T))
    return found


def between_keyframes(known: list[Array], keyframes: list[Keyframe], frames: list[Frame]) -> list[Array]:
    """Covariance (6, 6) of every frame, interpolated in time between the keyframes on both sides."""
    found = []
    for frame in frames:
        before, after = known[frame.keyframe], known[min(frame.keyframe + 1, len(known) - 1)]
        time = keyframes[min(frame.keyframe + 1, len(known) - 1)].segment.duration
        share = min(frame.since.duration / time, 1.0) if time > 0 else 0.0
        found.append((1.0 - share) * before + share * after)
    return found


def covariances_until(
    bundle: Bundle, keyframes: list[Keyframe], stretch: list[Keyframe], noise: InertialNoise, model: Model
) -> dict[int, Array]:
    """Covariances (6, 6) of the pose of base_link, by index, at all keyframes up to the end of an adjusted stretch:
    those of the adjustment within it and, before it, propagated back along the inertial measurements."""
    imu = model.imu
    T_imu_base = invert(imu.T_base_imu)
    of_stretch = pose_covariances(bundle, stretch, T_imu_base[:3, 3], model)
    known = {keyframe.index: covariance for keyframe, covariance in zip(stretch, of_stretch, strict=True)}
    first = stretch[0].index
    state = read_state(bundle.values, first)
    filter = InvariantFilter(np.eye(3), noise, imu.gravity)
    set_state(filter, state)
    joint = joint_covariance(bundle.graph, bundle.values, [X(first), V(first), B(first)])
    covariance = filter_covariance(joint, filter_slopes(state, first))
    if covariance is not None:
        filter.covariance = covariance
    for k in range(first, 0, -1):
        if not keyframes[k].stationary:
            propagate_back(filter, keyframes[k].segment)
        known[k - 1] = filter.pose_covariance((filter.pose @ T_imu_base)[:3, 3]) + FLOOR
    return known
