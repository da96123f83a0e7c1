"""Vibration: what thrusters and pumps shake a unit with, from the first sample of a sequence to its last."""

from __future__ import annotations

import numpy as np
from scipy.fft import irfft, next_fast_len

from oysterbench.core.geometry import Array
from oysterbench.core.streams import Streams
from oysterbench.recipe import VibrationRecipe


def vibrate(n: int, rate_hz: float, recipe: VibrationRecipe, streams: Streams) -> Array:
    """(n, 3) m/s^2 or rad/s at times k / rate_hz: white, a sine with a phase of its own per axis, or of a spectrum."""
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
    length = next_fast_len(2 * n, real=True)
    density = folded(np.arange(length // 2 + 1) * (rate_hz / length), rate_hz, psd)
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
