"""Fish, in schools or alone: each keeps its place relative to a leader on a course, with small motions of its own."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from oysterbench.core.geometry import Array
from oysterbench.scene.life.course import Course
from oysterbench.scene.life.fish import PHASES, STRIDE
from oysterbench.scene.life.ground import Ground
from oysterbench.scene.life.states import State, Vehicle, turned

STEP_S = 0.1  # step of the finite differences that give the fish their heading
WANDER_LENGTHS = 0.35  # amplitude of a fish's own motion about its place in the school, in body lengths
WANDER_SPEED = 0.25  # and largest speed of that motion, relative to the school's
WANDER_PERIODS_S = (2.0, 6.0)
ROLL_S = 0.25  # roll over rate of turn
STEEPEST = 0.45  # steepest climb, vertical over horizontal speed
FLIGHT_M, FLIGHT_REACH_M = 0.45, 0.7  # push away from the vehicle's centre, and distance over which it decays
SURFACE_M = 0.12  # smallest depth


@dataclass(frozen=True)
class School:
    """School of M fish. places (M, 3): ahead of the leader, to its left and above it, m. lengths (M,) m. height_m: of
    the leader over the ground's bound. wander (3, M, 3): amplitude (m), rate (rad/s) and phase along each axis. beat
    (M,): phase of the tail beat, 0 to 1.
    """

    kind: str
    colours: Array
    course: Course
    places: Array
    lengths: Array
    height_m: float
    wander: Array
    beat: Array
    ground: Ground
    vehicle: Vehicle
    class_name: str = "fish"

    @property
    def ids(self) -> NDArray[np.int64]:
        return np.arange(len(self.lengths))

    def at(self, time_s: float) -> State:
        moments = time_s + STEP_S * np.array([-1.0, 0.0, 1.0])
        before, now, after = self.positions(moments)
        velocity = (after - before) / (2 * STEP_S)
        level = np.linalg.norm(velocity[:, :2], axis=1)
        climb = np.clip(velocity[:, 2], -STEEPEST * level, STEEPEST * level)
        a, b = (now - before)[:, :2], (after - now)[:, :2]
        rate = np.arctan2(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0], (a * b).sum(axis=1)) / STEP_S
        rotations = turned(np.column_stack([velocity[:, :2], climb]), np.clip(-ROLL_S * rate, -0.6, 0.6))
        way = self.course.way(np.array([time_s]))
        beats = way / (STRIDE * self.lengths) + self.beat
        forms = np.floor(PHASES * (beats % 1.0)).astype(np.int64) % PHASES
        return State(forms, now, rotations, self.lengths[:, None] * np.ones(3))

    def positions(self, times_s: Array) -> Array:
        """Positions (T, M, 3) m at times (T,)."""
        ahead, left, up = self.places.T
        way = self.course.way(times_s)[:, None] + ahead
        heading = self.course.heading(way)
        points = np.empty((len(times_s), len(self.lengths), 3))
        points[..., :2] = self.course.at(way)
        points[..., 0] -= left * heading[..., 1]
        points[..., 1] += left * heading[..., 0]
        amplitude, rate, phase = self.wander
        drift = amplitude * np.sin(rate * times_s[:, None, None] + phase)
        points[..., :2] += drift[..., :2]
        points[..., 2] = self.height_m + up + drift[..., 2]
        points = give_way(points, self.vehicle(times_s)[0], self.ground)
        return points


def give_way(points: Array, vehicle: Array, ground: Ground) -> Array:
    """Return points (T, M, 3), given with z over the ground's bound, with z in `map`, pushed away from the vehicle
    (T, 3) and kept in the water above the ground."""
    points = points.copy()
    points[..., 2] += ground.bound(points[..., 0], points[..., 1])
    apart = points - vehicle[:, None]
    distance = np.linalg.norm(apart, axis=-1, keepdims=True)
    push = FLIGHT_M * np.exp(-((distance / FLIGHT_REACH_M) ** 2)) / np.maximum(distance, 1e-3)
    points += push * apart
    floor = ground.bound(points[..., 0], points[..., 1])
    points[..., 2] = np.clip(points[..., 2], np.minimum(floor, -SURFACE_M), -SURFACE_M)
    return points


def school_places(count: int, half_axes: tuple[float, float, float], generator: np.random.Generator) -> Array:
    """Draw places (N, 3) in an ellipsoid, each the candidate farthest from those before (Mitchell's best candidate)."""
    axes = np.array(half_axes)
    places = np.zeros((count, 3))
    for k in range(count):
        tries = generator.standard_normal((10, 3))
        tries *= (generator.random((10, 1)) ** (1 / 3)) / np.linalg.norm(tries, axis=1, keepdims=True) * axes
        apart = np.linalg.norm((tries[:, None] - places[None, :k]), axis=2).min(axis=1, initial=np.inf)
        places[k] = tries[np.argmax(np.round(apart, 9))]
    return places


def draw_wander(count: int, lengths: Array, speed: float, generator: np.random.Generator) -> Array:
    """Draw amplitude (m), rate (rad/s) and phase of each fish's own motion, (3, N, 3); speed: the school's, m/s."""
    period = generator.uniform(*WANDER_PERIODS_S, (count, 3))
    rate = 2 * np.pi / period
    amplitude = np.minimum(WANDER_LENGTHS * lengths[:, None], WANDER_SPEED * speed / rate)
    return np.stack([amplitude * [1.0, 1.0, 0.6], rate, generator.uniform(0, 2 * np.pi, (count, 3))])
