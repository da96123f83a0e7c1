"""What is estimated, and when: states, the keyframes that have one each, and the frames between them."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from functools import cached_property

import gtsam
import numpy as np
from gtsam.symbol_shorthand import B, V, X
from scipy.spatial.transform import Rotation

from oysterbench.core.geometry import Array, transform
from oysterbench.methods import Health
from oysterbench_baselines.common.filter import InvariantFilter
from oysterbench_baselines.common.inertial import Segment, integrate, relative_rotation
from oysterbench_baselines.gtsam_vi.closed_form import ClosedForm
from oysterbench_baselines.gtsam_vi.frontend import Observations
from oysterbench_baselines.gtsam_vi.preintegration import preintegrate


@dataclass(frozen=True)
class State:
    """Pose and velocity of the IMU in odom, and its biases."""

    nav: gtsam.NavState
    bias: gtsam.imuBias.ConstantBias

    @property
    def matrix(self) -> Array:
        """T_odom_imu (4, 4)."""
        return self.nav.pose().matrix()


@dataclass(frozen=True)
class Rates:
    """IMU readings at an instant: gyro rad/s and accel m/s^2, (3,) each."""

    gyro: Array
    accel: Array


NOTHING = Observations(np.empty(0, dtype=np.int64), np.empty((0, 2)))

RATES_S = 0.1  # over which readings are averaged: several revolutions of a thruster that shakes the IMU


@dataclass
class Keyframe:
    """A keyframe: stamp, observations, inertial measurements since the last keyframe, latest estimate; and factors of
    other sensors, on its state, that of the keyframe before it and shared variables, or of loops, on its state and an
    earlier one.

    lost: whether the estimator was lost on the way to it. astray: whether that is where it got lost, so that the state
    before it is doubtful. measured: whether another sensor measured its velocity. blind: whether none did, and it saw
    next to nothing.
    """

    index: int
    stamp_ns: int
    observations: Observations
    segment: Segment
    stationary: bool
    state: State | None = None
    aiding: list[gtsam.NonlinearFactor] = field(default_factory=list)
    lost: bool = False
    astray: bool = False
    measured: bool = False
    blind: bool = False

    def distrust_sight(self) -> None:
        """Drop its observations, which fit nothing seen later, and the rest that they seemed to show: it is then as
        blind as one that saw nothing."""
        self.observations, self.blind, self.stationary = NOTHING, not self.measured, False

    @cached_property
    def rates(self) -> Rates | None:
        """IMU readings at its stamp; None where there are none before it."""
        segment = self.segment
        ago = np.cumsum(segment.dt[::-1])[::-1] - segment.dt
        latest = ago < RATES_S
        if not latest.any():
            return None
        return Rates(segment.gyro[latest].mean(axis=0), segment.accel[latest].mean(axis=0))

    @property
    def estimate(self) -> State:
        """Its state, which exists from the start of the window on."""
        assert self.state is not None
        return self.state


@dataclass(frozen=True)
class Known:
    """What is known of a frame: T_odom_imu (4, 4), the covariance (6, 6) of base_link's pose as in a `Trajectory`, if
    there is one, and how the pose was obtained."""

    pose: Array
    covariance: Array | None
    health: Health


@dataclass
class Frame:
    """A frame: the keyframe before it (or itself), the measurements since, the correction of odom by loops known then;
    pose, covariance and health (see `Known`) as they are known by now; and online, as they were known at the frame, but
    before the first start at that start."""

    stamp_ns: int
    keyframe: int
    since: Segment
    pose: Array | None = None
    covariance: Array | None = None
    correction: Array | None = None  # T_corrected_odom (4, 4), a rotation about z and a translation
    health: Health = Health.COASTING
    online: Known | None = None

    @property
    def known(self) -> Known:
        """What is known of it by now; its pose exists from the start of the window on."""
        assert self.pose is not None
        return Known(self.pose, self.covariance, self.health)


def make_state(rotation: Array, position: Array, velocity: Array, gyro_bias: Array, accel_bias: Array) -> State:
    """State from a rotation (3, 3), position, velocity and biases (3,)."""
    nav = gtsam.NavState(gtsam.Pose3(transform(rotation, position)), velocity)
    return State(nav, gtsam.imuBias.ConstantBias(accel_bias, gyro_bias))


def state_of(filter: InvariantFilter) -> State:
    """The state of a filter."""
    return make_state(filter.rotation, filter.position, filter.velocity, filter.gyro_bias, filter.accel_bias)


def insert_state(values: gtsam.Values, index: int, state: State) -> None:
    """Insert a state into values under its keys."""
    values.insert(X(index), state.nav.pose())
    values.insert(V(index), state.nav.velocity())
    values.insert(B(index), state.bias)


def read_state(values: gtsam.Values, index: int) -> State:
    """Read the state of keyframe `index` from values."""
    return State(gtsam.NavState(values.atPose3(X(index)), values.atVector(V(index))), values.atConstantBias(B(index)))


def states_of(start: ClosedForm, anchor: State | None) -> list[State]:
    """States of a start; with an anchor, shifted and turned about z so that the first has its position and heading."""
    turn, shift = np.eye(3), np.zeros(3)
    if anchor is not None:
        now, wanted = start.rotations[0][:, 0], anchor.matrix[:3, 0]
        angle = np.arctan2(wanted[1], wanted[0]) - np.arctan2(now[1], now[0])
        turn, shift = Rotation.from_euler("z", angle).as_matrix(), anchor.matrix[:3, 3]
    return [
        make_state(turn @ rotation, turn @ position + shift, turn @ velocity, start.gyro_bias, start.accel_bias)
        for rotation, position, velocity in zip(start.rotations, start.positions, start.velocities, strict=True)
    ]


def predict_stationary(state: State) -> State:
    """State with the same pose, at rest."""
    return State(gtsam.NavState(state.nav.pose(), np.zeros(3)), state.bias)


def coast(state: State, segment: Segment, memory_s: float) -> State:
    """State after inertial measurements of which only the turns are believed: it moves on ever more slowly.

    memory_s: in which the velocity falls by 1 - 1/e: the last known velocity is a good guess for some seconds, and none
    after that; kept up, its error would grow with time without bound.
    """
    left = float(np.exp(-segment.duration / memory_s))
    position = state.nav.position() + state.nav.velocity() * memory_s * (1.0 - left)
    rotation = state.nav.attitude().matrix() @ relative_rotation(segment, state.bias.gyroscope())
    pose = gtsam.Pose3(transform(rotation, position))
    return State(gtsam.NavState(pose, state.nav.velocity() * left), state.bias)


def coast_through(state: State, keyframes: list[Keyframe], memory_s: float) -> State:
    """Coast from the state before the first keyframe through all of them; return the state of the last."""
    for keyframe in keyframes:
        state = keyframe.state = coast(state, keyframe.segment, memory_s)
    return state


def time_missing(segments: Iterable[Segment]) -> float:
    """Time, s, for which inertial measurements are missing from consecutive segments.

    Of several gaps, it is the root of the sum of squares, as they are independent. A gap may have been cut at frames:
    what it had lasted before a segment is subtracted, so that all parts together count as the whole.
    """
    gaps = [(segment.gap_s, max(segment.gap_s - segment.duration, 0.0)) for segment in segments if segment.has_gap]
    return float(np.sqrt(sum(since**2 - before**2 for since, before in gaps)))


def forward(state: State, segment: Segment, params: gtsam.PreintegrationCombinedParams) -> State:
    """Propagate a state over a segment."""
    return State(preintegrate(segment, state.bias, params).predict(state.nav, state.bias), state.bias)


def backward(state: State, segment: Segment, gravity: float) -> State:
    """Propagate a state from the end of a segment back to its start."""
    bias = state.bias
    part = integrate([segment], bias.gyroscope())
    time = part.time[-1]
    down = np.array([0.0, 0.0, -gravity])
    rotation = state.nav.attitude().matrix() @ part.rotation[-1].T
    gained = part.velocity[-1] - part.velocity_rate[-1] @ bias.accelerometer()
    moved = part.position[-1] - part.position_rate[-1] @ bias.accelerometer()
    velocity = state.nav.velocity() - down * time - rotation @ gained
    position = state.nav.position() - velocity * time - 0.5 * down * time**2 - rotation @ moved
    return make_state(rotation, position, velocity, bias.gyroscope(), bias.accelerometer())
