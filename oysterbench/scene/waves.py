"""Waves at the site as a sum of small sines: surface elevation, motion of the water below, and dynamic pressure."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from oysterbench.core.geometry import GRAVITY, Array
from oysterbench.core.streams import Streams
from oysterbench.recipe import SiteRecipe

COMPONENTS = 64
"""Number of sines in the sum; as their frequencies are random within their bands, the sum does not repeat itself."""

CUT = 4.0
"""Highest frequency, relative to that of the peak: 99.5 % of the spectrum's energy lies below it."""

NEWTON_STEPS = 8
"""Newton steps on the dispersion relation: from Eckart's approximation, five converge to the last bits at any depth."""


@dataclass(frozen=True)
class Waves:
    """Linear (Airy) waves over a bottom at `depth_m`, each component with phase theta = k . x - omega t + phase.

    amplitude (M,) m, omega (M,) rad/s, wavenumber (M, 2) rad/m along x and y of `map`, phase (M,) rad; no components
    in a calm (M = 0). Positions are (N, 3) m in `map`, times (N,) s from the start of the sequence. Formulas: Dean &
    Dalrymple 1991, chapters 3 and 4. They hold between bottom and mean surface; heights beyond are clamped to these.
    """

    depth_m: float
    amplitude: Array
    omega: Array
    wavenumber: Array
    phase: Array

    def elevation(self, position: Array, times_s: Array) -> Array:
        """Height (N,) m of the surface above z = 0, at the positions' x, y."""
        total = np.zeros(len(times_s))
        for amplitude, theta, _ in self._components(position, times_s):
            total += amplitude * np.cos(theta)
        return total

    def velocity(self, position: Array, times_s: Array) -> Array:
        """Velocity (N, 3) m/s of the water."""
        total = np.zeros((len(times_s), 3))
        for index, (amplitude, theta, (along, upright, _)) in enumerate(self._components(position, times_s)):
            speed = amplitude * self.omega[index]
            total[:, :2] += (speed * along * np.cos(theta))[:, None] * self._heading(index)
            total[:, 2] += speed * upright * np.sin(theta)
        return total

    def displacement(self, position: Array, times_s: Array) -> Array:
        """Displacement (N, 3) m of the water whose rest positions are given: the integral of its velocity over time."""
        total = np.zeros((len(times_s), 3))
        for index, (amplitude, theta, (along, upright, _)) in enumerate(self._components(position, times_s)):
            total[:, :2] -= (amplitude * along * np.sin(theta))[:, None] * self._heading(index)
            total[:, 2] += amplitude * upright * np.cos(theta)
        return total

    def head(self, position: Array, times_s: Array) -> Array:
        """Dynamic pressure (N,) as head in metres of water: divided by density * GRAVITY, positive below a crest."""
        total = np.zeros(len(times_s))
        for amplitude, theta, (_, _, pressing) in self._components(position, times_s):
            total += amplitude * pressing * np.cos(theta)
        return total

    def _heading(self, index: int) -> Array:
        return np.asarray(self.wavenumber[index] / np.linalg.norm(self.wavenumber[index]))

    def _components(self, position: Array, times_s: Array) -> Iterator[tuple[float, Array, tuple[Array, Array, Array]]]:
        """Yield amplitude, theta (N,) and the three depth factors (N,) of each component in turn, so that hours of data
        fit in memory."""
        z = np.clip(position[:, 2], -self.depth_m, 0.0)
        for amplitude, omega, k, phase in zip(self.amplitude, self.omega, self.wavenumber, self.phase, strict=True):
            theta = position[:, :2] @ k - omega * times_s + phase
            yield amplitude, theta, depth_factors(float(np.linalg.norm(k)), z, self.depth_m)


def build_waves(site: SiteRecipe, depth_m: float, streams: Streams) -> Waves:
    """Build the waves of a site over a bottom at depth_m, from the stream "site", "waves": the same for all users.

    Pierson-Moskowitz spectrum by significant height and peak period (Bretschneider 1959), whose energy below omega is
    Hs^2 / 16 exp(-1.25 (omega_p / omega)^4): each component has an equal share of it, from a band of its own.
    Directions spread as cos^2 about the mean direction (ITTC 2002).
    """
    n = COMPONENTS if site.wave_height_m else 0
    rng = streams.generator("site", "waves")
    share = (np.arange(n) + rng.random(n)) / COMPONENTS * np.exp(-1.25 / CUT**4)
    omega = 2 * np.pi / site.wave_period_s * (1.25 / -np.log(share)) ** 0.25
    # If the angle has a density of cos^2, its sine s has a density of sqrt(1 - s^2).
    heading = np.radians(site.wave_to_deg) + np.arcsin(2 * rng.beta(1.5, 1.5, n) - 1)
    wavenumber = dispersion(omega, depth_m)[:, None] * np.column_stack([np.cos(heading), np.sin(heading)])
    amplitude = np.full(n, site.wave_height_m / np.sqrt(8 * COMPONENTS))
    return Waves(depth_m, amplitude, omega, wavenumber, rng.uniform(0, 2 * np.pi, n))


def dispersion(omega: Array, depth_m: float) -> Array:
    """Solve omega^2 = g k tanh(k h) for the wavenumbers k (M,) rad/m by Newton's method; omega (M,) rad/s."""
    deep = omega**2 / GRAVITY
    k = deep / np.sqrt(np.tanh(deep * depth_m))  # Eckart 1952, within 5 %
    for _ in range(NEWTON_STEPS):
        tanh = np.tanh(k * depth_m)
        k = k - (k * tanh - deep) / (tanh + k * depth_m * (1 - tanh**2))
    return k


def depth_factors(k: float, z: Array, depth_m: float) -> tuple[Array, Array, Array]:
    """cosh k(z+h) / sinh kh, sinh k(z+h) / sinh kh and cosh k(z+h) / cosh kh at z (N,) m, without overflow."""
    down, back = np.exp(k * z), np.exp(-k * (z + 2 * depth_m))
    bottom = np.exp(-2 * k * depth_m)
    return (down + back) / (1 - bottom), (down - back) / (1 - bottom), (down + back) / (1 + bottom)
