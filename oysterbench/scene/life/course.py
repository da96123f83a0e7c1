"""Courses of animals: closed loops over the reef, followed at a varying speed and passing a given place at a given
time."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicSpline

from oysterbench.core.geometry import Array

POINTS = 240  # of a loop
BULGES = (0.22, 0.10)  # relative variation of its radius, with two and three waves around it


@dataclass(frozen=True)
class Course:
    """A loop and the motion along it: x, y (m) as a spline over the path length s (m), and s(t) = start + speed * (t +
    swing / rhythm * sin(rhythm t + phase)), less its value at 0, with a speed of 1 - swing to 1 + swing times the mean.
    """

    track: CubicSpline
    start_m: float
    speed_m_s: float
    swing: float
    rhythm: float  # rad/s
    phase: float

    def way(self, times_s: Array) -> Array:
        """Path length (N,) m at times (N,) s."""
        wave = np.sin(self.rhythm * times_s + self.phase) - np.sin(self.phase)
        return np.asarray(self.start_m + self.speed_m_s * (times_s + self.swing / self.rhythm * wave))

    def at(self, way: Array) -> Array:
        """x, y (..., 2) m at path lengths (...,) m."""
        return np.asarray(self.track(way))

    def heading(self, way: Array) -> Array:
        """Unit direction (..., 2) at path lengths (...,) m."""
        direction = self.track(way, 1)
        return np.asarray(direction / np.linalg.norm(direction, axis=-1, keepdims=True))


def build_course(
    place: Array,
    time_s: float,
    radius_m: float,
    speed_m_s: float,
    swing: float,
    period_s: float,
    half_m: float,
    generator: np.random.Generator,
) -> Course:
    """Draw a loop of about radius_m that passes `place` (2,) at time_s, inside the square from -half_m to half_m.

    place must lie in that square. swing and period_s: relative amplitude and period of the speed's variation.
    """
    angle = np.linspace(0, 2 * np.pi, POINTS + 1)
    phases = generator.uniform(0, 2 * np.pi, 2)
    radius = radius_m * (1 + BULGES[0] * np.sin(2 * angle + phases[0]) + BULGES[1] * np.sin(3 * angle + phases[1]))
    loop = radius[:, None] * np.column_stack([np.cos(angle), np.sin(angle)])
    if generator.random() < 0.5:
        loop = loop[::-1]
    turn = generator.uniform(0, 2 * np.pi)
    loop = loop @ np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]])
    loop = loop - loop[0] + place
    loop += np.clip(0.0, (-half_m - loop).max(axis=0), (half_m - loop).min(axis=0))
    loop[-1] = loop[0]
    way = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(loop, axis=0), axis=1))])
    track = CubicSpline(way, loop, bc_type="periodic")
    rhythm, phase = 2 * np.pi / period_s, generator.uniform(0, 2 * np.pi)
    course = Course(track, 0.0, speed_m_s, swing, rhythm, phase)
    return Course(track, -float(course.way(np.array([time_s]))[0]), speed_m_s, swing, rhythm, phase)
