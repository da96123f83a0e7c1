"""A camera clock that is late: states when a picture was taken, inertial measurements up to its stamp.

A state is moved on over that time, some ms, by the rates of then: the inertial unit's samples up to the stamp are about
as good as those up to the picture, and every sample is used once.
"""

from __future__ import annotations

from typing import Any

import gtsam
import numpy as np

from oysterbench.core.geometry import Array
from oysterbench_baselines.common.filter import cross
from oysterbench_baselines.gtsam_vi.states import Rates, State


def moved_on(state: State, time: float, rates: Rates, gravity: float) -> State:
    """The state after some ms, the turn rate and the specific force being what the unit reads."""
    rate, velocity, accel = _rates(state, rates, gravity)
    # A tangent of GTSAM's navigation state: turn, way and gain in velocity, in the axes of the pose.
    step = np.concatenate([rate * time, (velocity + 0.5 * time * accel) * time, accel * time])
    return State(state.nav.retract(step), state.bias)


def _rates(state: State, rates: Rates, gravity: float) -> tuple[Array, Array, Array]:
    """Turn rate rad/s, velocity m/s and acceleration m/s^2, (3,) each in the axes of the pose."""
    to_body = state.nav.attitude().matrix().T
    force = rates.accel - state.bias.accelerometer()
    return rates.gyro - state.bias.gyroscope(), to_body @ state.nav.velocity(), force - gravity * to_body[:, 2]


def moved_on_slopes(state: State, time: float, rates: Rates, gravity: float) -> tuple[State, Array, Array]:
    """The state moved on; derivatives of its pose and velocity (9,) by those before (9, 9), and by the time (9,).

    All in GTSAM's tangents: rotation and position in the axes of the pose, velocity in odom's.
    """
    after = moved_on(state, time, rates, gravity)
    before, now = state.nav.attitude().matrix(), after.nav.attitude().matrix()
    rate, _, accel = _rates(state, rates, gravity)
    force = rates.accel - state.bias.accelerometer()
    slope = np.zeros((9, 9))
    slope[:3, :3] = slope[3:6, 3:6] = now.T @ before
    slope[6:, :3] = -before @ cross(force) * time
    slope[3:6, :3] = 0.5 * time * now.T @ slope[6:, :3]
    slope[3:6, 6:] = now.T * time
    slope[6:, 6:] = np.eye(3)
    return after, slope, np.concatenate([rate, now.T @ after.nav.velocity(), before @ accel])


def clocked(
    factor: gtsam.CombinedImuFactor, clock: int, rates: tuple[Rates, Rates], gravity: float
) -> gtsam.NonlinearFactor:
    """An inertial factor between states at stamps, as one between states when pictures were taken.

    clock: key of the time (1,) s from one to the other. rates: of its two key frames.
    """
    x_before, v_before, x_after, v_after, b_before, b_after = factor.keys()
    keys = [x_before, v_before, x_after, v_after, b_before, b_after, clock]
    ends = (x_before, v_before, b_before, rates[0]), (x_after, v_after, b_after, rates[1])
    noise: Any = factor.noiseModel()
    root: Array = noise.R()

    def error(_: gtsam.CustomFactor, values: gtsam.Values, jacobians: list[Array] | None) -> Array:
        time = float(values.atVector(clock)[0])
        states = [
            State(gtsam.NavState(values.atPose3(x), values.atVector(v)), values.atConstantBias(b))
            for x, v, b, _ in ends
        ]
        if jacobians is None:
            moved = [moved_on(state, time, end[3], gravity) for state, end in zip(states, ends, strict=True)]
            off: Array = root @ factor.evaluateError(*_arguments(moved))
            return off
        slopes = [moved_on_slopes(state, time, end[3], gravity) for state, end in zip(states, ends, strict=True)]
        parts = [np.zeros((15, width), order="F") for width in (6, 3, 6, 3, 6, 6)]
        found = factor.evaluateError(*_arguments([after for after, *_ in slopes]), *parts)
        by_time = np.zeros(15)
        for n, (_after, slope, of_time) in enumerate(slopes):
            at = root @ np.hstack(parts[2 * n : 2 * n + 2])
            jacobians[2 * n] = np.asfortranarray(at @ slope[:, :6])
            jacobians[2 * n + 1] = np.asfortranarray(at @ slope[:, 6:])
            by_time += at @ of_time
        jacobians[4], jacobians[5] = (np.asfortranarray(root @ part) for part in parts[4:])
        jacobians[6] = np.asfortranarray(by_time[:, None])
        weighted: Array = root @ found
        return weighted

    return gtsam.CustomFactor(gtsam.noiseModel.Unit.Create(15), keys, error)


def _arguments(states: list[State]) -> list[Any]:
    """Of two states, in the order in which GTSAM's factor takes them."""
    before, after = states
    poses = [part for state in states for part in (state.nav.pose(), state.nav.velocity())]
    return [*poses, before.bias, after.bias]
