"""Compass disturbances besides the iron that it was swung with: motors under load, and steel on the bottom."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from oysterbench.core.geometry import Array
from oysterbench.core.streams import Streams
from oysterbench.recipe import SiteRecipe

if TYPE_CHECKING:
    from oysterbench.scene.path import Motion

MU0_4PI = 1e-7  # T m/A, the magnetic constant over 4 pi
MOMENT_SPREAD = 0.5  # standard deviation of the logarithm of the moments
NEAREST_M = 0.2  # distance to a piece of iron within which it is no dipole


@dataclass(frozen=True)
class Dipoles:
    """Pieces of iron: positions (K, 3) m and magnetic moments (K, 3) A m^2, both in `map`."""

    places: Array
    moments: Array

    def field(self, positions: Array) -> Array:
        """Magnetic field (N, 3) T in `map` at positions (N, 3) m: sum over the dipoles of
        mu0 / 4 pi (3 (m.r) r - m) / d^3, with unit vector r and distance d from each (Jackson 1999, eq. 5.56)."""
        total = np.zeros((len(positions), 3))
        for place, moment in zip(self.places, self.moments, strict=True):
            offset = positions - place
            distance = np.maximum(np.linalg.norm(offset, axis=1), NEAREST_M)[:, None]
            unit = offset / distance
            total += MU0_4PI * (3 * (unit @ moment)[:, None] * unit - moment) / distance**3
        return total


def build_iron(
    site: SiteRecipe, size_m: float, ground_height: Callable[[Array, Array], Array], streams: Streams
) -> Dipoles:
    """Draw the iron on the bottom of a square reef: uniform positions, log-normal moments, random directions."""
    rng = streams.generator("site", "iron")
    x, y = rng.uniform(-size_m / 2, size_m / 2, (2, site.iron))
    directions = rng.standard_normal((site.iron, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    moments = site.iron_am2 * np.exp(MOMENT_SPREAD * rng.standard_normal(site.iron))
    return Dipoles(np.column_stack([x, y, ground_height(x, y)]), moments[:, None] * directions)


def motor_field(earth: Array, throttle_deg: float, shares: Array, motion: Motion, streams: Streams) -> Array:
    """Magnetic field (N, 3) T in `map` of motors at shares (N,) of full throttle, in a fixed direction in the vehicle's
    horizontal plane.

    It is proportional to the motor current, for which the throttle is taken, as in the compensation of autopilots
    (ArduPilot, COMPASS_MOT_X); at full throttle it turns the heading by throttle_deg at most: where it lies across the
    sum of both fields. earth (3,) T: the Earth's.
    """
    towards = streams.generator("magnetometer", "motors").uniform(0, 2 * np.pi)
    size = float(np.hypot(earth[0], earth[1])) * np.sin(np.radians(throttle_deg))
    along = np.array([np.cos(towards), np.sin(towards), 0.0])
    return np.asarray(size * shares[:, None] * (motion.rotation @ along))


def deviation(earth: Array, bending: Array) -> Array:
    """Angles (N,) rad, positive to the left, by which disturbing fields (N, 3) turn the horizontal direction of the
    Earth's field (3,); all in the same unit and in `map`."""
    level = earth[:2] + bending[:, :2]
    turned: Array = np.arctan2(earth[0] * level[:, 1] - earth[1] * level[:, 0], level @ earth[:2])
    return turned
