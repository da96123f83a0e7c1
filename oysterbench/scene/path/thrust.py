"""Thrusters: the share of full throttle that a path requires, against drag, inertia and buoyancy."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from oysterbench.core.geometry import Array
from oysterbench.core.streams import Streams
from oysterbench.recipe import SequenceRecipe
from oysterbench.scene.path.disturbance import HULL, current
from oysterbench.scene.path.motion import Path
from oysterbench.scene.waves import build_waves

BOLLARD_N = (88.0, 88.0, 69.0)
"""Largest forward, lateral and vertical thrust: 9, 9 and 7 kgf (Blue Robotics, data of the BlueROV2)."""

HEAVE_ADDED_KG, HEAVE_LINEAR, HEAVE_QUADRATIC = 14.57, 5.18, 36.99
"""Added mass and damping along the vertical axis, complementing those of `HULL` (Wu 2018)."""

TRIM_N = 2.0  # buoyancy to which an ROV is trimmed, so that it surfaces if power fails: 0.2 kgf
MOTOR_S = 0.15  # time constant of the propellers
STEP_S = 0.05


@dataclass(frozen=True)
class Throttle:
    """Share of full throttle over time: times (N,) s, shares (N,) from 0 to 1."""

    times_s: Array
    shares: Array

    def at(self, times_s: Array) -> Array:
        """Shares (M,) at times (M,) s."""
        return np.interp(times_s, self.times_s, self.shares)

    def turns(self, times_s: Array) -> Array:
        """Integral (M,) s of the share since the start: revolutions of a propeller that does one per second at full
        throttle."""
        steps = 0.5 * (self.shares[1:] + self.shares[:-1]) * np.diff(self.times_s)
        return np.asarray(np.interp(times_s, self.times_s, np.concatenate([[0.0], np.cumsum(steps)])))


def throttle(path: Path, recipe: SequenceRecipe, streams: Streams) -> Throttle:
    """Throttle that keeps a BlueROV2 on its path; streams: those of the sequence.

    Thrust is proportional to the square of the propellers' rate, which is proportional to the throttle:
    s^2 = |F / F_max|.
    """
    from scipy.signal import lfilter  # imported late: takes each worker half a second, and most do not need it

    times = np.arange(0.0, recipe.duration_s + STEP_S, STEP_S)
    force = thrust(path, recipe, streams, times)
    asked = np.minimum(np.linalg.norm(force / np.array(BOLLARD_N), axis=1), 1.0) ** 0.5
    share = 1.0 - np.exp(-STEP_S / MOTOR_S)
    shares, _ = lfilter([share], [1.0, share - 1.0], asked, zi=np.array([(1.0 - share) * asked[0]]))
    return Throttle(times, np.asarray(shares))


def thrust(path: Path, recipe: SequenceRecipe, streams: Streams, times: Array) -> Array:
    """Force (N, 3) N of the thrusters on the body, in the body frame, at times (N,) s, STEP_S apart.

    F = (m + m_a) (a - a_w) + (d_1 + d_2 |u|) u per axis of the body, less the trim along z, with u the velocity through
    the water, which moves with current and waves, and a_w the water's acceleration.
    """
    motion = path.at(times)
    water = np.zeros((len(times), 3))
    if recipe.site.current_m_s:
        mean, gusts = current(times, recipe.site, streams)
        water[:, :2] += mean + gusts
    if recipe.site.wave_height_m:
        waves = build_waves(recipe.site, recipe.reef.depth_m, streams)
        water += waves.velocity(motion.position, times)
    in_body = np.einsum("nji,nj->ni", motion.rotation, motion.velocity - water)
    pushed = np.einsum("nji,nj->ni", motion.rotation, motion.acceleration - np.gradient(water, STEP_S, axis=0))
    mass = HULL.mass_kg + np.array([*HULL.added_kg, HEAVE_ADDED_KG])
    linear = np.array([*HULL.linear, HEAVE_LINEAR])
    quadratic = np.array([*HULL.quadratic, HEAVE_QUADRATIC])
    force = mass * pushed + (linear + quadratic * np.abs(in_body)) * in_body
    force[:, 2] -= TRIM_N
    return np.asarray(force)
