"""A camera clock that is late: states refer to when an image was taken, inertial measurements run up to its stamp.

A state is propagated over that time, a few ms, at the rates measured then: the IMU samples up to the stamp are about as
good as those up to the exposure, and every sample is used once.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import gtsam
import numpy as np

from oysterbench.core.geometry import Array
from oysterbench_baselines.common.filter import cross
from oysterbench_baselines.gtsam_vi.states import Rates, State


def moved_on(state: State, time: float, rates: Rates, gravity: float) -> State:
    """Propagate a state over a few ms (time: s), at the angular rate and specific force that the IMU reads."""
    return _moved(state, time, _motion(state, rates, gravity))


class _Motion(NamedTuple):
    """Motion of a state: R_odom_imu (3, 3); and, (3,) each in the axes of the pose, angular rate rad/s, velocity m/s,
    specific force and acceleration m/s^2."""

    rotation: Array
    rate: Array
    velocity: Array
    force: Array
    accel: Array


def _motion(state: State, rates: Rates, gravity: float) -> _Motion:
    rotation = state.nav.attitude().matrix()
    force = rates.accel - state.bias.accelerometer()
    rate, velocity = rates.gyro - state.bias.gyroscope(), rotation.T @ state.nav.velocity()
    return _Motion(rotation, rate, velocity, force, force - gravity * rotation[2])


def _moved(state: State, time: float, motion: _Motion) -> State:
    # Tangent of GTSAM's navigation state: rotation, displacement and velocity change, in the axes of the pose.
    step = np.empty(9)
    step[:3], step[6:] = motion.rate * time, motion.accel * time
    step[3:6] = (motion.velocity + 0.5 * time * motion.accel) * time
    return State(state.nav.retract(step), state.bias)


def moved_on_slopes(state: State, time: float, rates: Rates, gravity: float) -> tuple[State, Array, Array]:
    """Propagate a state; return it, and the derivatives of its pose and velocity (9,) with respect to those before
    (9, 9) and to the time (9,).

    All in GTSAM's tangents: rotation and position in the axes of the pose, velocity in odom's.
    """
    motion = _motion(state, rates, gravity)
    after = _moved(state, time, motion)
    to_now = after.nav.attitude().matrix().T
    slope, by_time = np.zeros((9, 9)), np.empty(9)
    slope[:3, :3] = slope[3:6, 3:6] = to_now @ motion.rotation
    slope[6:, :3] = -motion.rotation @ cross(motion.force) * time
    slope[3:6, :3] = 0.5 * time * to_now @ slope[6:, :3]
    slope[3:6, 6:] = to_now * time
    slope[6, 6] = slope[7, 7] = slope[8, 8] = 1.0
    by_time[:3], by_time[3:6], by_time[6:] = motion.rate, to_now @ after.nav.velocity(), motion.rotation @ motion.accel
    return after, slope, by_time


COLUMNS = [slice(start, start + width) for start, width in ((0, 6), (6, 3), (9, 6), (15, 3), (18, 6), (24, 6))]
"""Jacobian columns of poses, velocities and biases, in the order in which GTSAM's factor takes them."""


def clocked(
    factor: gtsam.CombinedImuFactor, clock: int, rates: tuple[Rates, Rates], gravity: float
) -> gtsam.NonlinearFactor:
    """Convert an inertial factor between states at stamps to one between states at which the images were taken.

    clock: key of the time (1,) s from exposure to stamp. rates: IMU readings at its two keyframes.
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
        whole = np.zeros((15, 30), order="F")
        parts = [whole[:, columns] for columns in COLUMNS]
        found = factor.evaluateError(*_arguments([after for after, *_ in slopes]), *parts)
        whole = root @ whole
        by_time = np.zeros(15)
        for n, (_after, slope, of_time) in enumerate(slopes):
            at = whole[:, 9 * n : 9 * n + 9]
            by_state = np.asfortranarray(at @ slope)
            jacobians[2 * n], jacobians[2 * n + 1] = by_state[:, :6], by_state[:, 6:]
            by_time += at @ of_time
        jacobians[4], jacobians[5] = (np.asfortranarray(whole[:, columns]) for columns in COLUMNS[4:])
        jacobians[6] = np.asfortranarray(by_time[:, None])
        weighted: Array = root @ found
        return weighted

    return gtsam.CustomFactor(gtsam.noiseModel.Unit.Create(15), keys, error)


def _arguments(states: list[State]) -> list[Any]:
    """Arguments of GTSAM's factor for two states, in its order."""
    before, after = states
    poses = [part for state in states for part in (state.nav.pose(), state.nav.velocity())]
    return [*poses, before.bias, after.bias]
