"""Itineraries: places to visit one after the other, and the smooth path through them within the vehicle's limits."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import BSpline, make_interp_spline
from scipy.ndimage import gaussian_filter1d

from oysterbench.core.geometry import Array

KNOT_S = 0.1
"""Spacing of the splines' knots: 20 times shorter than the shortest period of the vehicle's own motion."""

SMOOTHING_S = 0.5
"""Standard deviation in time of the Gaussian that rounds off corners: the delay of thrusters and hull. As a mean over
time it makes nothing faster, and shifts nothing farther than 0.4 of it times the change of velocity."""

DEGREE = 5  # of the splines
REACH = 4.0  # truncation of the Gaussian, in standard deviations


@dataclass(frozen=True)
class NominalPath:
    """A nominal path at N times: x, y m in `map`, altitude m over the bottom, heading rad (from east,
    counter-clockwise, unwrapped) and the degree (0 to 1) to which the bow points along the path, each (N,)."""

    x: Array
    y: Array
    altitude: Array
    heading: Array
    along: Array


@dataclass(frozen=True)
class Pace:
    """How the vehicle travels: altitude m over the bottom, speed m/s through x, y and altitude, rate of turn rad/s."""

    altitude: float
    speed: float
    turn_rate: float


class Itinerary:
    """States in the order in which they are visited, each at the earliest time that speed and rate of turn allow.

    A state (5,) is x m, y m, altitude m, heading rad, and 1 if the bow points along the path or 0 if it points at
    something.
    """

    def __init__(self, start: Array, pace: Pace) -> None:
        """Start at a state (5,)."""
        self.pace = pace
        self.elapsed = 0.0  # s
        self.state = np.array(start, dtype=float)
        self._states = [self.state[None]]
        self._durations: list[Array] = []

    def through(self, states: Array, speed: float | None = None) -> None:
        """Visit states (K, 5); each heading is reached by the shorter turn, and half a turn is made to the left."""
        states = np.array(states, dtype=float)
        before = np.vstack([self.state, states[:-1]])
        turns = np.pi - np.mod(np.pi - (states[:, 3] - before[:, 3]), 2 * np.pi)
        # The last bits of half a turn differ between processors; its direction must not.
        turns = np.where(turns < 1e-6 - np.pi, turns + 2 * np.pi, turns)
        states[:, 3] = self.state[3] + np.cumsum(turns)
        away = np.linalg.norm(states[:, :3] - before[:, :3], axis=1)
        self._append(states, np.maximum(away / (speed or self.pace.speed), np.abs(turns) / self.pace.turn_rate))

    def line(self, place: Array, altitude: float) -> None:
        """Turn on the spot to the course of a straight line and follow it to its end point, x and y (2,) m."""
        away = place - self.state[:2]
        if np.hypot(*away) > 1e-6:
            self.turn(float(np.arctan2(away[1], away[0])), along=True)
        self.through(np.array([[*place, altitude, *self.state[3:]]]))

    def turn(self, heading: float, along: bool = False) -> None:
        """Turn on the spot to a heading, rad."""
        self.through(np.array([[*self.state[:3], heading, float(along)]]))

    def wait(self, seconds: float) -> None:
        """Hover for some seconds."""
        self._append(self.state[None].copy(), np.array([seconds]))

    def _append(self, states: Array, durations: Array) -> None:
        moves = durations > 1e-9
        self.state = states[-1]
        if moves.any():
            self._states.append(states[moves])
            self._durations.append(durations[moves])
            self.elapsed += float(durations.sum())

    def nominal_path(self, clock: Array) -> NominalPath:
        """Smoothed path at clock (N,), seconds at full pace, non-decreasing from 0; it hovers at its end."""
        states = np.concatenate(self._states)
        times = np.concatenate([[0.0], np.cumsum(np.concatenate([[], *self._durations]))])
        return NominalPath(*smooth(times, states, float(clock[-1]))(clock).T)


def smooth(times: Array, states: Array, end: float) -> BSpline:
    """Spline over 0 to `end` s through the states (M, K) at times (M,) s, interpolated linearly and then smoothed in
    time with a Gaussian.

    Before its first state the path is extended backwards along its first leg, so that smoothing leaves its start.
    """
    lead = int(np.ceil(REACH * SMOOTHING_S / KNOT_S))
    knots = max(int(np.ceil(end / KNOT_S)) + 2, DEGREE + 1)  # at rest, no time passes along the path
    steps = np.arange(-lead, knots + lead)
    grid = steps * KNOT_S
    values = np.column_stack([np.interp(grid, times, column) for column in states.T])
    if len(times) > 1:
        slope = (states[1] - states[0]) / (times[1] - times[0])
        values += np.minimum(grid, 0.0)[:, None] * slope
    values = gaussian_filter1d(values, SMOOTHING_S / KNOT_S, axis=0, mode="nearest", truncate=REACH)
    inner = steps >= 0
    return make_interp_spline(grid[inner][: -lead or None], values[inner][: -lead or None], k=DEGREE)


def ramp(times: Array, ramp_s: float) -> Array:
    """Smootherstep from 0 to 1 over ramp_s (Perlin 2002): its first and second derivatives vanish at both ends."""
    grown = np.clip(times / ramp_s, 0.0, 1.0)
    return grown**3 * (10 + grown * (6 * grown - 15))


def clock(times: Array, ramp_s: float) -> Array:
    """Integral (N,) s of the ramp over time: seconds at full pace. The path starts at rest, without acceleration."""
    grown = np.clip(times / ramp_s, 0.0, 1.0)
    return ramp_s * (grown**6 - 3 * grown**5 + 2.5 * grown**4) + np.maximum(times - ramp_s, 0.0)
