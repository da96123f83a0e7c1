"""Vibration: what thrusters and pumps shake a unit with, from the first sample of a sequence to its last."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from oysterbench.core.errors import RecipeError
from oysterbench.core.geometry import Array
from oysterbench.core.streams import Streams
from oysterbench.recipe.keys import choice, number

if TYPE_CHECKING:
    from oysterbench.scene.path.thrust import Throttle

VIBRATION_KINDS = ("white", "sine", "psd", "thrusters")
VIBRATION_TARGETS = ("accel", "gyro")


@dataclass(frozen=True, kw_only=True)
class VibrationRecipe:
    """What thrusters and pumps add to a reading, through the whole sequence without restarts."""

    on: str = choice(VIBRATION_TARGETS)
    kind: str = choice(VIBRATION_KINDS)
    level: tuple[float, float, float] = number(0, 1000, (0.0, 0.0, 0.0))
    """Per axis, m/s^2 or rad/s: standard deviation of a sample (white), or amplitude (sine; thrusters at full
    throttle: 0.1 to 3 m/s^2; ArduPilot calls up to 15 m/s^2 acceptable of multicopters)."""
    frequency_hz: float = number(0, 2000, 1.0)
    """Of a sine, or of the propellers at full throttle (T200: 3500 rpm = 58 Hz, and three times that for its blades);
    above half the unit's rate it aliases, as does a psd."""
    psd: tuple[tuple[float, float, float, float], ...] = number(0, 1e6, ())
    """Rows of frequency (Hz, increasing) and one-sided power spectral density per axis, (m/s^2)^2/Hz or (rad/s)^2/Hz;
    linear between the rows, nothing outside them."""

    def check(self, where: str) -> None:
        """Raise RecipeError on what no single key can say."""
        if self.kind != "psd":
            if self.psd:
                raise RecipeError(
                    f"{where}: key 'imu.vibration.psd': expected none for kind = {self.kind!r}; give level"
                )
            return
        frequencies = [row[0] for row in self.psd]
        if len(frequencies) < 2 or any(high <= low for low, high in pairwise(frequencies)):
            raise RecipeError(
                f"{where}: key 'imu.vibration.psd': expected at least two rows of increasing frequency, "
                f"got frequencies {frequencies}"
            )


def vibrate(
    n: int, rate_hz: float, recipe: VibrationRecipe, streams: Streams, throttle: Throttle | None = None
) -> Array:
    """(n, 3) m/s^2 or rad/s at times k / rate_hz: white, a sine with a phase of its own per axis, of a spectrum, or of
    the propellers.

    Those turn as fast as the throttle is open, and what an unbalanced one shakes with grows with the square of that.
    """
    if recipe.kind == "thrusters":
        if throttle is None:
            return np.zeros((n, 3))
        times = np.arange(n) / rate_hz
        phase = streams.generator("phase").uniform(0, 2 * np.pi, 3)
        shaken = np.sin(2 * np.pi * recipe.frequency_hz * throttle.turns(times)[:, None] + phase)
        return np.asarray(recipe.level) * throttle.at(times)[:, None] ** 2 * shaken
    if recipe.kind == "white":
        return np.asarray(recipe.level) * streams.generator("white").standard_normal((n, 3))
    if recipe.kind == "sine":
        phase = streams.generator("phase").uniform(0, 2 * np.pi, 3)
        turns = recipe.frequency_hz * np.arange(n) / rate_hz
        return np.asarray(recipe.level) * np.sin(2 * np.pi * turns[:, None] + phase)
    return shaped(n, rate_hz, np.asarray(recipe.psd), streams.generator("spectrum"))


def shaped(n: int, rate_hz: float, psd: Array, rng: np.random.Generator) -> Array:
    """(n, 3) samples of a stationary Gaussian process of the one-sided densities psd: rows (K, 4) of Hz, x, y, z.

    Spectral synthesis with Gaussian amplitudes, thus random phases (Percival 1992): the whole sequence at once,
    so that nothing in it begins anew, and its densities are exact. It is drawn at least twice as long as it is used,
    since the end of what is drawn meets its beginning.
    """
    from scipy.fft import irfft, next_fast_len

    length = next_fast_len(2 * n, real=True)
    density = folded(np.arange(length // 2 + 1, dtype=float) * (rate_hz / length), rate_hz, psd)
    density[0] = 0.0  # what does not oscillate is the bias
    # Of a line, twice its squared modulus over (length * rate) is the density; real and imaginary part share it.
    amplitude = np.sqrt(density * (length * rate_hz / 4))
    lines = rng.standard_normal((*amplitude.shape, 2)) * amplitude[..., None]
    return np.ascontiguousarray(irfft(lines[..., 0] + 1j * lines[..., 1], length, axis=0)[:n])


def folded(frequency: Array, rate_hz: float, psd: Array) -> Array:
    """(M, 3) density at frequencies (M,) up to half the rate, of the process with the density psd once it is sampled.

    What lies above half the rate comes back below it, as by a unit without a filter.
    """
    at = psd[:, 0]
    total = np.zeros((len(frequency), 3))
    for multiple in range(int(at[-1] / rate_hz) + 2):
        images = (frequency,) if multiple == 0 else (multiple * rate_hz - frequency, multiple * rate_hz + frequency)
        for image in images:
            total += np.column_stack([np.interp(image, at, row, left=0.0, right=0.0) for row in psd[:, 1:].T])
    return total
