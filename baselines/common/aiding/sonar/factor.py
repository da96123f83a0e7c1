"""The factor of two fans on one chart: horizontal motion of the sonar between the pings before two keyframes.

A ping is up to one ping interval before its keyframe; inertial measurements say where the vehicle was then, given its
velocity, which is part of the factor.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from oysterbench.core.geometry import Array
from oysterbench_baselines.common.aiding.sensor import python_factor, symbol
from oysterbench_baselines.common.filter import cross
from oysterbench_baselines.common.inertial import Segment, integrate

if TYPE_CHECKING:
    import gtsam

    from oysterbench_baselines.gtsam_vi.states import State

SONAR_KEY = symbol("s")
"""Scale of what registration measures, less 1, and turn (rad) of the sonar's mount about the vertical; (2,)."""


@dataclass(frozen=True)
class Motion:
    """Displacement of the IMU over a time (s) up to now, apart from what its velocity now contributes.

    p_now - p_then = v_now t - g t^2 / 2 - R_then lag, with g downwards. rotation (3, 3): R_then_now; lag (3,) m;
    by_accel (3, 3): derivative of the lag by the accelerometer bias.
    """

    time: float
    rotation: Array
    lag: Array
    by_accel: Array

    @staticmethod
    def over(segments: list[Segment], gyro_bias: Array, accel_bias: Array) -> Motion:
        """Integrate inertial measurements, at biases (3,)."""
        whole = Segment.join(segments)
        if not len(whole.dt):
            return Motion(0.0, np.eye(3), np.zeros(3), np.zeros((3, 3)))
        found = integrate([whole], gyro_bias)
        time = float(found.time[-1])
        by_accel = found.position_rate[-1] - time * found.velocity_rate[-1]
        lag = time * found.velocity[-1] - found.position[-1] + by_accel @ accel_bias
        return Motion(time, found.rotation[-1], lag, by_accel)


@dataclass(frozen=True)
class Sighting:
    """A fan registered on a chart, as seen from a keyframe some time (s) later.

    place (3,): x, y (m) and heading (rad) of the sonar in the chart, with covariance (3, 3). arm (3,) m: the sonar at
    its ping, from the IMU at the keyframe, apart from what its velocity contributed, and axis (3,) of the sonar, both
    in the IMU frame at the keyframe. chart: its number; way: m, path length of the sonar until then.
    """

    place: Array
    covariance: Array
    time: float
    arm: Array
    axis: Array
    chart: int
    way: float

    @staticmethod
    def at(place: Array, covariance: Array, chart: int, way: float, since: Motion, T_imu_sonar: Array) -> Sighting:
        """since: the vehicle's motion from the ping to the keyframe."""
        arm = since.rotation.T @ (since.lag + T_imu_sonar[:3, 3])
        return Sighting(place, covariance, since.time, arm, since.rotation.T @ T_imu_sonar[:3, 0], chart, way)


@dataclass(frozen=True)
class Step:
    """Displacement from one sighting to a later one: measured (2,) m in the level axes of the first ping, and the
    upper triangular root (2, 2) of its information."""

    first: Sighting
    second: Sighting
    measured: Array
    root: Array

    @staticmethod
    def of(first: Sighting, second: Sighting, drift: float, turn_sigma: float) -> Step:
        """Build a step. drift: variance, m^2, of the chart's drift in between; turn_sigma: rad, of its rotation."""
        back = turned(-first.place[2])
        measured = back @ (second.place - first.place)[:2]
        aside = np.array([-measured[1], measured[0]])
        covariance = back @ (first.covariance + second.covariance)[:2, :2] @ back.T
        covariance += drift * np.eye(2) + turn_sigma**2 * np.outer(aside, aside)
        return Step(first, second, measured, np.linalg.cholesky(np.linalg.inv(covariance)).T)


def turned(angle: float) -> Array:
    """Rotation matrix (2, 2) of an angle, rad."""
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s], [s, c]])


def wrapped(angle: float) -> float:
    """Wrap an angle to within half a turn, rad."""
    return float((angle + np.pi) % (2 * np.pi) - np.pi)


def step_error(
    step: Step, first: gtsam.Pose3, v_first: Array, second: gtsam.Pose3, v_second: Array, calibration: Array
) -> tuple[Array, list[Array]]:
    """Error (2,), whitened, of a step, and its derivatives by poses (2, 6), velocities (2, 3) and calibration (2, 2).

    With s = p - v t + R arm the place of the sonar at its ping, level, and psi the heading of R axis,
    e = (1 + scale) Rz(-psi_1 - mount) (s_2 - s_1) - measured.
    """
    place, heading, by_pose, by_velocity, turn = _end(step.first, first, v_first)
    place_2, _, by_pose_2, by_velocity_2, _ = _end(step.second, second, v_second)
    scale, mount = calibration
    back = (1 + scale) * turned(-heading - mount)
    moved = back @ (place_2 - place)
    aside = np.array([moved[1], -moved[0]])  # its derivative by the heading
    slopes = [
        np.outer(aside, turn) - back @ by_pose,
        -back @ by_velocity,
        back @ by_pose_2,
        back @ by_velocity_2,
        np.column_stack([moved / (1 + scale), aside]),
    ]
    return step.root @ (moved - step.measured), [step.root @ slope for slope in slopes]


def sonar_at(sighting: Sighting, state: State) -> tuple[Array, float]:
    """Place (2,) m in odom, level, and heading (rad) of the sonar at the ping of a keyframe whose state is given."""
    place, heading, *_ = _end(sighting, state.nav.pose(), state.nav.velocity())
    return place, heading


def _end(sighting: Sighting, pose: gtsam.Pose3, velocity: Array) -> tuple[Array, float, Array, Array, Array]:
    """Place (2,) and heading of the sonar at its ping; derivatives of the place by pose (2, 6) and velocity (2, 3), and
    of the heading by pose (6,)."""
    rotation = pose.rotation().matrix()
    axis = rotation @ sighting.axis
    place = (pose.translation() - sighting.time * velocity + rotation @ sighting.arm)[:2]
    by_pose = np.hstack([-rotation @ cross(sighting.arm), rotation])[:2]
    by_axis = np.array([-axis[1], axis[0], 0.0]) / (axis[0] ** 2 + axis[1] ** 2)
    turn = np.concatenate([-by_axis @ rotation @ cross(sighting.axis), np.zeros(3)])
    return place, float(np.arctan2(axis[1], axis[0])), by_pose, -sighting.time * np.eye(3)[:2], turn


def step_factor(step: Step, first: int, second: int, **loss: float) -> gtsam.NonlinearFactor:
    """Factor of a step on poses and velocities of two keyframes and the calibration; loss: as of `python_factor`."""
    keys = [symbol("x", first), symbol("v", first), symbol("x", second), symbol("v", second), SONAR_KEY]
    return python_factor(keys, 1.0, 2, partial(step_error, step), **loss)
