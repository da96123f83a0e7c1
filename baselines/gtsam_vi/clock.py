"""A camera clock that is late: states when a picture was taken, inertial measurements up to its stamp.

A state is moved on over that time, some ms, by the rates of then: the inertial unit's samples up to the stamp are about
as good as those up to the picture, and every sample is used once.
"""

from __future__ import annotations

import gtsam
import numpy as np
from scipy.spatial.transform import Rotation

from oysterbench.core.geometry import Array
from oysterbench_baselines.common.filter import cross
from oysterbench_baselines.gtsam_vi.states import Rates, State


def moved_on(state: State, time: float, rates: Rates, gravity: float) -> State:
    """The state after some ms, the turn rate and the specific force being what the unit reads."""
    if time == 0.0:
        return state
    rotation = state.nav.attitude().matrix()
    turn = Rotation.from_rotvec((rates.gyro - state.bias.gyroscope()) * time).as_matrix()
    accel = rotation @ (rates.accel - state.bias.accelerometer()) + np.array([0.0, 0.0, -gravity])
    velocity = np.array(state.nav.velocity())
    position = state.nav.position() + velocity * time + 0.5 * accel * time**2
    pose = gtsam.Pose3(gtsam.Rot3(rotation @ turn), position)
    return State(gtsam.NavState(pose, velocity + accel * time), state.bias)


def moved_on_slopes(state: State, time: float, rates: Rates, gravity: float) -> tuple[State, Array, Array]:
    """The state moved on; derivatives of its pose and velocity (9,) by those before (9, 9), and by the time (9,).

    All in GTSAM's tangents: rotation and position in the axes of the pose, velocity in odom's.
    """
    after = moved_on(state, time, rates, gravity)
    before, now = state.nav.attitude().matrix(), after.nav.attitude().matrix()
    rate, force = rates.gyro - state.bias.gyroscope(), rates.accel - state.bias.accelerometer()
    turned = now.T @ before
    slope = np.zeros((9, 9))
    slope[:3, :3] = slope[3:6, 3:6] = turned
    slope[3:6, 6:] = now.T * time
    slope[6:, :3] = -before @ cross(force) * time
    slope[3:6, :3] = 0.5 * time * now.T @ slope[6:, :3]
    slope[6:, 6:] = np.eye(3)
    by_time = np.concatenate([rate, now.T @ after.nav.velocity(), before @ force + np.array([0.0, 0.0, -gravity])])
    return after, slope, by_time


def clocked(
    factor: gtsam.CombinedImuFactor, clock: int, rates: tuple[Rates, Rates], gravity: float
) -> gtsam.NonlinearFactor:
    """An inertial factor between states at stamps, as one between states when pictures were taken: `clock` is the key
    of the time (1,) s from one to the other; rates: of its two key frames."""
    x_before, v_before, x_after, v_after, b_before, b_after = factor.keys()
    keys = [x_before, v_before, x_after, v_after, b_before, b_after, clock]

    def error(_: gtsam.CustomFactor, values: gtsam.Values, jacobians: list[Array] | None) -> Array:
        time, moved = float(values.atVector(clock)[0]), gtsam.Values()
        slopes = list[tuple[Array, Array]]()
        for x, v, b, reads in ((x_before, v_before, b_before, rates[0]), (x_after, v_after, b_after, rates[1])):
            state = State(gtsam.NavState(values.atPose3(x), values.atVector(v)), values.atConstantBias(b))
            if jacobians is None:
                after = moved_on(state, time, reads, gravity)
            else:
                after, slope, by_time = moved_on_slopes(state, time, reads, gravity)
                slopes.append((slope, by_time))
            moved.insert(x, after.nav.pose())
            moved.insert(v, after.nav.velocity())
            moved.insert(b, state.bias)
        if jacobians is None:
            return np.asarray(factor.whitenedError(moved), dtype=float)
        linear, right = factor.linearize(moved).jacobian()
        of_clock = np.zeros((len(right), 1))
        for n, (slope, by_time) in enumerate(slopes):
            at = linear[:, 9 * n : 9 * n + 9]
            jacobians[2 * n] = np.asfortranarray(at @ slope[:, :6])
            jacobians[2 * n + 1] = np.asfortranarray(at @ slope[:, 6:])
            of_clock[:, 0] += at @ by_time
        jacobians[4], jacobians[5] = np.asfortranarray(linear[:, 18:24]), np.asfortranarray(linear[:, 24:])
        jacobians[6] = np.asfortranarray(of_clock)
        return -right

    return gtsam.CustomFactor(gtsam.noiseModel.Unit.Create(15), keys, error)
