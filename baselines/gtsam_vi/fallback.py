"""The path by inertial measurements alone, where the estimator has never started, or is lost to the end."""

from __future__ import annotations

from itertools import pairwise

import gtsam
import numpy as np

from oysterbench.core.errors import MethodError
from oysterbench.core.geometry import Array, invert
from oysterbench.sequence.types import ImuCalibration
from oysterbench_baselines.common.alignment import StartSettings, start_filter
from oysterbench_baselines.common.filter import ATTITUDE, FLOOR, VELOCITY, InertialNoise, InvariantFilter, cross
from oysterbench_baselines.common.inertial import Segment
from oysterbench_baselines.gtsam_vi.closed_form import level_rotation
from oysterbench_baselines.gtsam_vi.settings import ZeroVelocitySettings
from oysterbench_baselines.gtsam_vi.states import Frame, Keyframe, backward, forward, predict_stationary, state_of


def dead_reckon(
    keyframes: list[Keyframe],
    frames: list[Frame],
    imu: ImuCalibration,
    noise: InertialNoise,
    rest: ZeroVelocitySettings,
) -> None:
    """Fill in the states of all keyframes, and the poses of all frames with their covariances.

    A filter that starts level, as `dead_reckoning` has it, held by keyframes at rest.
    """
    filter = _started(keyframes, imu, noise)
    frames_of: dict[int, list[Frame]] = {}
    for frame in frames:
        frames_of.setdefault(frame.keyframe, []).append(frame)
    done = 0  # inertial measurements of the next keyframe's segment that frames before it have used
    for keyframe in keyframes:
        filter.propagate_all(keyframe.segment.after(done))
        if keyframe.stationary:
            _hold(filter, rest.sigma)
        keyframe.state, done = state_of(filter), 0
        for frame in frames_of.get(keyframe.index, ()):
            filter.propagate_all(frame.since.after(done))
            done = len(frame.since.dt)
            place = (filter.pose @ invert(imu.T_base_imu))[:3, 3]
            frame.pose, frame.covariance = filter.pose, filter.pose_covariance(place) + FLOOR


def go_on(keyframes: list[Keyframe], params: gtsam.PreintegrationCombinedParams) -> None:
    """Fill in the states that keyframes lack, on from the one before, the first of which has one."""
    for before, keyframe in pairwise(keyframes):
        if keyframe.state is None:
            keyframe.state = (
                predict_stationary(before.estimate)
                if keyframe.stationary
                else forward(before.estimate, keyframe.segment, params)
            )


def go_back(keyframes: list[Keyframe], index: int, gravity: float) -> None:
    """Fill in the states that keyframes before `index` lack, back to the first one or to the last that has one."""
    for k in range(index - 1, -1, -1):
        if keyframes[k].state is not None:
            break
        after = keyframes[k + 1]
        keyframes[k].state = (
            predict_stationary(after.estimate) if after.stationary else backward(after.estimate, after.segment, gravity)
        )


def _started(keyframes: list[Keyframe], imu: ImuCalibration, noise: InertialNoise) -> InvariantFilter:
    """A filter at the first keyframe."""
    first, settings = Segment.join([keyframe.segment for keyframe in keyframes]), StartSettings()
    stamps_ns = np.round(1e9 * (np.cumsum(first.dt) - first.dt)).astype(np.int64)
    if len(stamps_ns) < 2:
        return InvariantFilter(np.eye(3), noise, imu.gravity)
    try:
        filter, _ = start_filter(stamps_ns, first.gyro, first.accel, imu, noise, settings)
    except MethodError:  # nose up or down: any yaw is as good as another
        up: Array = first.accel[stamps_ns < 1e9 * settings.level_s].mean(axis=0)
        filter = InvariantFilter(level_rotation(up), noise, imu.gravity)
        filter.covariance[ATTITUDE, ATTITUDE] = np.diag([settings.moving_accel / imu.gravity] * 2 + [0.0]) ** 2
    if not keyframes[1].stationary:  # by its inertial unit, a vehicle in steady motion is at rest
        filter.covariance[VELOCITY, VELOCITY] = np.eye(3) * settings.moving_speed**2
    return filter


def _hold(filter: InvariantFilter, sigma: float) -> None:
    """Correct a filter by zero velocity."""
    slope = np.zeros((3, len(filter.covariance)))
    slope[:, ATTITUDE], slope[:, VELOCITY] = -cross(filter.velocity), np.eye(3)
    filter.update(-filter.velocity, slope, np.eye(3) * sigma**2)
