"""Vibration, held against the spectrum that was asked for."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import welch
from scipy.stats import kstest

from oysterbench.core.streams import Streams
from oysterbench.sensors.vibration import VibrationRecipe, folded, vibrate

PSD = ((2.0, 1e-4, 0.0, 2e-3), (20.0, 3e-3, 1e-3, 2e-3), (30.0, 3e-3, 1e-3, 5e-4), (70.0, 1e-5, 0.0, 0.0))
"""Hz and density per axis: rising and falling edges, a plateau, and an end."""


def spectrum(samples, rate_hz, seconds):
    """Hz, and one-sided density of samples (N, 3), by Welch's method on windows of so many seconds."""
    return welch(samples, rate_hz, nperseg=int(seconds * rate_hz), axis=0)


def asked(frequency):
    table = np.asarray(PSD)
    return np.column_stack([np.interp(frequency, table[:, 0], row, left=0, right=0) for row in table[:, 1:].T])


def test_white_vibration_has_its_level_at_all_frequencies():
    level = np.array([0.02, 0.1, 0.5])
    samples = vibrate(400_000, 200.0, VibrationRecipe(on="accel", kind="white", level=tuple(level)), Streams(1))
    assert samples.std(axis=0) == pytest.approx(level, rel=0.01)
    frequency, density = spectrum(samples, 200.0, 1.0)
    inside = slice(2, -2)
    assert density[inside] / (level**2 / 100.0) == pytest.approx(np.ones((len(frequency) - 4, 3)), rel=0.15)


def test_a_sine_has_its_amplitude_at_its_frequency_and_nothing_elsewhere():
    level = np.array([0.3, 0.0, 0.05])
    recipe = VibrationRecipe(on="gyro", kind="sine", level=tuple(level), frequency_hz=17.25)
    samples = vibrate(8000, 100.0, recipe, Streams(1))
    lines = np.abs(np.fft.rfft(samples, axis=0)) * 2 / len(samples)
    at = round(17.25 * len(samples) / 100.0)
    assert lines[at] == pytest.approx(level, abs=1e-12)
    assert np.delete(lines, at, axis=0).max() < 1e-12


def test_a_sine_runs_on_from_any_sample_to_the_next():
    recipe = VibrationRecipe(on="gyro", kind="sine", level=(1.0, 1.0, 1.0), frequency_hz=0.37)
    samples = vibrate(50_000, 120.0, recipe, Streams(2))
    # Any three neighbours of a sine obey x_(k+1) + x_(k-1) = 2 cos(w dt) x_k; a restart anywhere would not.
    turn = 2 * np.cos(2 * np.pi * 0.37 / 120.0)
    assert np.abs(samples[2:] + samples[:-2] - turn * samples[1:-1]).max() < 1e-10
    phases = vibrate(1, 120.0, recipe, Streams(2))[0]
    assert len(np.unique(phases)) == 3


@pytest.mark.parametrize("rate_hz", [150.0, 200.0, 1000.0])
def test_a_shaped_vibration_has_the_spectrum_asked_for_at_any_rate(rate_hz):
    samples = vibrate(int(1200 * rate_hz), rate_hz, VibrationRecipe(on="accel", kind="psd", psd=PSD), Streams(3))
    frequency, density = spectrum(samples, rate_hz, 2.0)
    wanted = asked(frequency)
    for low, high in ((4.0, 10.0), (10.0, 18.0), (21.0, 29.0), (31.0, 45.0), (45.0, 68.0)):
        band = (frequency >= low) & (frequency < high)
        assert density[band].sum(axis=0) == pytest.approx(wanted[band].sum(axis=0), rel=0.05, abs=1e-7)
        inside = wanted[band] > 1e-4
        assert density[band][inside] / wanted[band][inside] == pytest.approx(np.ones(inside.sum()), rel=0.25)
    silent = (frequency < 1.0) | (frequency > 72.0)
    assert density[silent].max() < 0.01 * wanted.max()
    power = np.trapezoid(np.asarray(PSD)[:, 1:], np.asarray(PSD)[:, 0], axis=0)
    assert samples.var(axis=0) == pytest.approx(power, rel=0.03)


def test_what_lies_above_half_the_rate_is_folded_back_and_keeps_its_power():
    samples = vibrate(120_000, 50.0, VibrationRecipe(on="accel", kind="psd", psd=PSD), Streams(3))
    power = np.trapezoid(np.asarray(PSD)[:, 1:], np.asarray(PSD)[:, 0], axis=0)
    assert samples.var(axis=0) == pytest.approx(power, rel=0.03)
    frequency = np.array([0.0, 10.0, 25.0])
    by_hand = asked(frequency) + asked(50 - frequency) + asked(50 + frequency) + asked(100 - frequency)
    assert folded(frequency, 50.0, np.asarray(PSD)) == pytest.approx(by_hand)


def test_a_shaped_vibration_is_gaussian_and_its_end_does_not_continue_in_its_beginning():
    low = ((0.05, 1.0, 1.0, 1.0), (0.2, 1.0, 1.0, 1.0))
    recipe = VibrationRecipe(on="gyro", kind="psd", psd=low)
    ends = np.concatenate([vibrate(400, 10.0, recipe, Streams(seed))[[0, -1]] for seed in range(300)], axis=1)
    assert np.corrcoef(ends)[0, 1] == pytest.approx(0.0, abs=0.12)
    assert kstest(ends[0] / np.sqrt(0.15), "norm").pvalue > 0.01


def test_axes_and_vibrations_are_independent():
    recipe = VibrationRecipe(on="accel", kind="psd", psd=tuple((row[0], 1.0, 1.0, 1.0) for row in PSD))
    first, second = (vibrate(60_000, 200.0, recipe, Streams(1).at("vibration", index)) for index in (0, 1))
    together = np.corrcoef(np.column_stack([first, second]).T)
    assert together == pytest.approx(np.eye(6), abs=0.03)
