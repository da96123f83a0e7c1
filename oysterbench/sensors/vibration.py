"""Vibration of an IMU by thrusters and pumps, continuous from the first sample of a sequence to the last."""

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
    """Vibration by thrusters and pumps that adds to a reading, continuous over the whole sequence."""

    on: str = choice(VIBRATION_TARGETS)
    kind: str = choice(VIBRATION_KINDS)
    level: tuple[float, float, float] = number(0, 1000, (0.0, 0.0, 0.0))
    """Per axis, m/s^2 or rad/s: standard deviation of a sample (white), or amplitude (sine; thrusters at full
    throttle: 0.1 to 3 m/s^2; ArduPilot calls up to 15 m/s^2 acceptable for multicopters)."""
    frequency_hz: float = number(0, 2000, 1.0)
    """Frequency of the sine, or of the propellers at full throttle (T200: 3500 rpm = 58 Hz, and three times that for
    its blades); above half the IMU's rate it aliases, as does a psd."""
    psd: tuple[tuple[float, float, float, float], ...] = number(0, 1e6, ())
    """Rows of frequency (Hz, increasing) and one-sided power spectral density per axis, (m/s^2)^2/Hz or (rad/s)^2/Hz;
    linear between the rows, nothing outside them."""

    def check(self, where: str) -> None:
        """Check what no single key can express. Raises RecipeError, which starts with `where`."""
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
    """Vibration (n, 3), m/s^2 or rad/s, at times k / rate_hz: white noise, a sine with its own phase per axis, noise
    with a spectrum, or propellers.

    Propellers turn in proportion to the throttle, and the force of an unbalanced one grows with its square.
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
    """Samples (n, 3) of a stationary Gaussian process with one-sided densities psd: rows (K, 4) of Hz, x, y, z.

    Spectral synthesis with Gaussian amplitudes, thus random phases (Percival 1992), of the whole sequence at once, so
    that there are no restarts and the densities are exact. At least twice the needed length is drawn, because the
    synthesised signal is periodic.
    """
    from scipy.fft import irfft, next_fast_len

    length = next_fast_len(2 * n, real=True)
    density = folded(np.arange(length // 2 + 1, dtype=float) * (rate_hz / length), rate_hz, psd)
    density[0] = 0.0  # what does not oscillate is the bias
    # The density is twice a line's squared modulus over (length * rate), shared by the real and imaginary parts.
    amplitude = np.sqrt(density * (length * rate_hz / 4))
    lines = rng.standard_normal((*amplitude.shape, 2)) * amplitude[..., None]
    return np.ascontiguousarray(irfft(lines[..., 0] + 1j * lines[..., 1], length, axis=0)[:n])


def folded(frequency: Array, rate_hz: float, psd: Array) -> Array:
    """Density (M, 3), at frequencies (M,) up to half the rate, of the process with density psd once it is sampled.

    What lies above half the rate aliases below it, as in an IMU without an anti-aliasing filter.
    """
    at = psd[:, 0]
    total = np.zeros((len(frequency), 3))
    for multiple in range(int(at[-1] / rate_hz) + 2):
        images = (frequency,) if multiple == 0 else (multiple * rate_hz - frequency, multiple * rate_hz + frequency)
        for image in images:
            total += np.column_stack([np.interp(image, at, row, left=0.0, right=0.0) for row in psd[:, 1:].T])
    return total
