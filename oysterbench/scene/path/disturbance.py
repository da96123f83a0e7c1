"""Unplanned and added motion of the vehicle: its own sway, an opening manoeuvre, waves, current, drag and inertia."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import make_interp_spline
from scipy.ndimage import gaussian_filter1d

from oysterbench.core.geometry import GRAVITY, Array
from oysterbench.core.streams import Streams
from oysterbench.recipe import PathRecipe, SiteRecipe
from oysterbench.scene.path.itinerary import KNOT_S, ramp

SWAY_PERIODS_S = (2.2, 3.4, 5.3)
"""Periods of a station-keeping ROV's motion; the shorter ones carry most of the acceleration."""

EXCITATION_PERIODS_S = (2.0, 2.9, 4.1)
EXCITATION_S, EXCITATION_EDGE_S = 8.0, 2.0  # length of the opening manoeuvre, and of its soft start and end
EXCITATION_M, EXCITATION_RAD = 0.08, np.radians(6.0)  # amplitudes

GUST_PERIODS_S = (13.0, 29.0, 61.0)
GUST_SHARE = 0.2
"""Largest variation per axis, relative to the mean current. Tidal streams near the bottom have a turbulence of about
0.1."""

SLOWEST_SHARE = 0.5  # lowest speed through the water, relative to the path's, assumed by crab() in a following current
CRAB_SMOOTHING_S = 1.0  # smoothing by the helm, which follows gusts with a delay


STOP_EVERY_S, STOP_S = 75.0, (2.0, 6.0)  # mean interval between stops to look at something, and their duration
PACE_PERIODS_S, PACE_SHARE = (9.0, 19.0, 43.0), 0.4  # of the speed, which no pilot holds steady; largest variation
HEADING_S, HEADING_RAD = (3.0, 9.0), np.radians(5.0)  # between corrections, and standard deviation of the drift undone
ALTITUDE_S, ALTITUDE_M = (6.0, 15.0), 0.08
CORRECTION_S, STICK_S = 0.9, 0.3  # length of a correction, and smoothing by the thrusters
"""Together with a nominal speed of 0.2 m/s and turns of up to 12 deg/s, these reproduce the speeds and rates of turn of
divers and towed rigs: medians of 0.09 to 0.23 m/s and 4 to 7 deg/s, 95 % below 0.16 to 0.34 m/s and 12 to 17 deg/s
(from the reference trajectories of Rahman et al. 2022, SVIn2)."""


@dataclass(frozen=True)
class HandFlown:
    """Deviations due to a human pilot: pace (N,), a factor on the speed; heading (N,) rad and altitude (N,) m, added to
    the nominal ones."""

    pace: Array
    heading: Array
    altitude: Array

    def clock(self, steady_s: Array) -> Array:
        """Seconds (N,) at full pace, from those (N,) at a steady pace."""
        if np.all(self.pace == 1.0):
            return steady_s
        return np.concatenate([steady_s[:1], steady_s[0] + np.cumsum(self.pace[1:] * np.diff(steady_s))])


@dataclass(frozen=True)
class Hull:
    """Lumped coefficients of a BlueROV2: surge first, sway second."""

    mass_kg: float = 11.5
    added_kg: tuple[float, float] = (5.5, 12.7)
    linear: tuple[float, float] = (4.03, 6.22)  # N/(m/s)
    quadratic: tuple[float, float] = (18.18, 21.66)  # N/(m/s)^2


HULL = Hull()
"""Wu 2018, `6-DoF modelling and control of a remotely operated vehicle`, tables of added mass and damping."""

LEAN_LIMIT_RAD = np.radians(35.0)
LEAN_SMOOTHING_S = 0.5  # a quarter of the hull's pitch and roll period


def sines(times: Array, periods_s: tuple[float, ...], rng: np.random.Generator) -> Array:
    """Sum (N,) of sines of approximately the given periods, with random phases and weights that sum to one."""
    total = np.zeros(len(times))
    weights = rng.dirichlet(np.full(len(periods_s), 4.0))
    for weight, period in zip(weights, periods_s, strict=True):
        period = period * rng.uniform(0.85, 1.15)
        phase = rng.uniform(0, 2 * np.pi)
        total += weight * np.sin(2 * np.pi * times / period + phase)
    return total


def sway(times: Array, begun: Array, plan: PathRecipe, streams: Streams) -> Array:
    """Displacement (N, 6) x, y, z m and yaw, pitch, roll rad of a hovering vehicle, scaled by begun (N, 1), 0 to 1."""
    motion = np.column_stack([sines(times, SWAY_PERIODS_S, streams.generator("path", "sway", k)) for k in range(6)])
    motion *= begun
    return np.hstack([plan.sway_m * motion[:, :3], np.radians(plan.tilt_deg) * motion[:, 3:]])


def excitation(times: Array, plan: PathRecipe, streams: Streams) -> Array:
    """Displacement (N, 6) x, y, z m and yaw, pitch, roll rad of the opening manoeuvre, from rest and to rest.

    Rotations and translations about all axes over a few seconds make scale, gravity and biases observable for a filter
    initialised from images and IMU samples alone (Martinelli 2014).
    """
    motion = np.zeros((len(times), 6))
    if plan.excitation:
        window = ramp(times, EXCITATION_EDGE_S) * ramp(EXCITATION_S - times, EXCITATION_EDGE_S)
        for axis in range(6):
            size = EXCITATION_M if axis < 3 else EXCITATION_RAD
            rng = streams.generator("path", "excitation", axis)
            motion[:, axis] = plan.excitation * size * window * sines(times, EXCITATION_PERIODS_S, rng)
    return motion


def hand_flown(times: Array, plan: PathRecipe, streams: Streams) -> HandFlown:
    """Stops, drifts and corrections at times (N,) s, from time 0 on, scaled by `plan.hand_flown`.

    Heading and altitude drift at a constant rate until the drift is noticed and then corrected within CORRECTION_S; the
    speed wanders, and the vehicle stops occasionally.
    """
    n, size = len(times), plan.hand_flown
    if not size:
        return HandFlown(np.ones(n), np.zeros(n), np.zeros(n))
    pace = 1.0 + PACE_SHARE * size * (sines(times, PACE_PERIODS_S, streams.generator("path", "hand", "pace")) - 0.5)
    rng = streams.generator("path", "hand", "stops")
    at = np.cumsum(rng.exponential(STOP_EVERY_S, int(times[-1] / STOP_EVERY_S * 3) + 8))
    for start, length in zip(at, rng.uniform(*STOP_S, len(at)), strict=True):
        inside = (times > start) & (times < start + length)
        pace[inside] *= max(1.0 - size, 0.0)
    pace = gaussian_filter1d(np.clip(pace, 0.0, 1.0), 2 * STICK_S / KNOT_S, mode="nearest")
    heading = size * HEADING_RAD * drift(times, HEADING_S, streams.generator("path", "hand", "heading"))
    altitude = size * ALTITUDE_M * drift(times, ALTITUDE_S, streams.generator("path", "hand", "altitude"))
    return HandFlown(pace, heading, altitude)


def drift(times: Array, every_s: tuple[float, float], rng: np.random.Generator) -> Array:
    """Sawtooth (N,) from time 0 on: linear drifts to normally distributed values of unit variance, each undone within
    CORRECTION_S; every_s: shortest and longest drift."""
    count = int(max(times[-1], 0.0) / every_s[0]) + 2
    noticed = np.cumsum(rng.uniform(*every_s, count))
    corners = np.column_stack([noticed, noticed + CORRECTION_S])
    values = np.column_stack([rng.standard_normal(count), np.zeros(count)])
    teeth = np.interp(times, np.concatenate([[0.0], corners.ravel()]), np.concatenate([[0.0], values.ravel()]))
    return np.asarray(gaussian_filter1d(teeth, STICK_S / KNOT_S, mode="nearest"))


def current(times: Array, site: SiteRecipe, streams: Streams) -> tuple[Array, Array]:
    """Mean current (2,) and its variation (N, 2) at times (N,) s, in m/s along x and y of `map`."""
    to = np.radians(site.current_to_deg)
    mean = site.current_m_s * np.array([np.cos(to), np.sin(to)])
    gusts = [sines(times, GUST_PERIODS_S, streams.generator("path", "gusts", axis)) for axis in range(2)]
    return mean, GUST_SHARE * site.current_m_s * np.column_stack(gusts)


def crab(heading: Array, water: Array, speed: float) -> Array:
    """Crab angles (N,) rad, positive to the left, by which the bow is turned to keep the track along `heading` (N,).

    water (N, 2) m/s: the current. The velocity through the water is the track's velocity minus the current; in a
    following current the angle is bounded by assuming at least SLOWEST_SHARE of the speed.
    """
    ahead = water[:, 0] * np.cos(heading) + water[:, 1] * np.sin(heading)
    left = -water[:, 0] * np.sin(heading) + water[:, 1] * np.cos(heading)
    angle = np.arctan2(-left, np.maximum(speed - ahead, SLOWEST_SHARE * speed))
    return gaussian_filter1d(angle, CRAB_SMOOTHING_S / KNOT_S, mode="nearest")


def lean(times: Array, track: Array, yaw: Array, water: Array, share: float) -> tuple[Array, Array]:
    """Pitch and roll (N,) rad of a hull whose thrust acts below its centre of drag and weight.

    track (N, 2) m: x and y; yaw (N,) rad; water (N, 2) m/s. Thrust balances drag and inertia, F = (m + m_a) a + (d_1 +
    d_2 |u|) u per axis, with u the velocity through the water; the moment of its lever is balanced by the weight over
    the righting arm, tan(angle) = share * F / (m g), where `share` is lever over righting arm. The bow therefore goes
    down when the vehicle accelerates or moves ahead, and the hull leans into its turns.
    """
    spline = make_interp_spline(times, track, k=5)
    cos, sin = np.cos(yaw), np.sin(yaw)

    def in_body(vector: Array) -> Array:
        return np.column_stack([vector[:, 0] * cos + vector[:, 1] * sin, -vector[:, 0] * sin + vector[:, 1] * cos])

    through = in_body(spline.derivative(1)(times) - water)
    inertia = (HULL.mass_kg + np.array(HULL.added_kg)) * in_body(spline.derivative(2)(times))
    force = inertia + (np.array(HULL.linear) + np.array(HULL.quadratic) * np.abs(through)) * through
    angle = np.arctan(share * force / (HULL.mass_kg * GRAVITY))
    angle = LEAN_LIMIT_RAD * np.tanh(angle / LEAN_LIMIT_RAD)
    angle = gaussian_filter1d(angle, LEAN_SMOOTHING_S / KNOT_S, axis=0, mode="nearest")
    return angle[:, 0], -angle[:, 1]  # about y, bow down positive; about x, right side down positive
