"""Waves, held against linear wave theory."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import brentq
from scipy.signal import welch

from oysterbench.core.geometry import GRAVITY
from oysterbench.core.streams import Streams
from oysterbench.recipe import SiteRecipe
from oysterbench.scene.waves import CUT, build_waves, depth_factors, dispersion

DEPTH = 6.0


@pytest.fixture(scope="module")
def waves():
    return build_waves(SiteRecipe(wave_height_m=0.8, wave_period_s=4.0, wave_to_deg=30.0), DEPTH, Streams(3))


def at(x, y, z, n):
    return np.tile([float(x), float(y), float(z)], (n, 1))


def test_wavenumbers_solve_the_dispersion_relation_in_shallow_and_deep_water():
    for depth in (0.5, 3.0, 60.0):
        omega = 2 * np.pi / np.array([0.3, 2.0, 8.0, 30.0])
        roots = [brentq(lambda k, w=w, h=depth: GRAVITY * k * np.tanh(k * h) - w**2, 1e-6, 1e3) for w in omega]
        assert dispersion(omega, depth) == pytest.approx(np.array(roots), rel=1e-9)


def test_the_surface_has_the_height_and_the_spectrum_asked_for(waves):
    times = np.arange(0.0, 6 * 3600.0, 0.25)
    surface = waves.elevation(at(0, 0, 0, len(times)), times)
    assert 4 * surface.std() == pytest.approx(0.8, rel=0.01)
    frequency, density = welch(surface, 4.0, nperseg=512)
    peak, width = 1 / 4.0, frequency[1]
    asked = 5 / 16 * 0.8**2 * peak**4 / np.maximum(frequency, width) ** 5
    asked *= np.exp(-1.25 * (peak / np.maximum(frequency, width)) ** 4)
    for low, high in ((0.15, 0.25), (0.25, 0.35), (0.35, 0.6), (0.6, CUT * peak)):
        band = (frequency >= low) & (frequency < high)
        assert density[band].sum() == pytest.approx(asked[band].sum(), rel=0.15)


def test_water_moves_as_the_derivative_of_its_displacement_and_keeps_its_volume(waves):
    point, step = np.array([[2.0, -1.0, -2.5]]), 1e-4
    now = np.array([77.3])
    rate = (waves.displacement(point, now + step) - waves.displacement(point, now - step)) / (2 * step)
    assert rate == pytest.approx(waves.velocity(point, now), abs=1e-7)
    divergence = sum(
        (waves.velocity(point + step * axis, now) - waves.velocity(point - step * axis, now)) @ axis / (2 * step)
        for axis in np.eye(3)
    )
    assert divergence == pytest.approx(0.0, abs=1e-7)


def test_pressure_drives_the_water_as_euler_says(waves):
    point, step, now = np.array([[0.5, 0.3, -3.0]]), 1e-4, np.array([12.0])
    acceleration = (waves.velocity(point, now + step) - waves.velocity(point, now - step)) / (2 * step)
    slope = [(waves.head(point + step * a, now) - waves.head(point - step * a, now)) / (2 * step) for a in np.eye(3)]
    assert acceleration == pytest.approx(-GRAVITY * np.array(slope).T, abs=1e-6)


def test_no_water_goes_through_the_bottom_and_the_surface_presses_as_it_stands(waves):
    times = np.arange(0.0, 60.0, 0.5)
    n = len(times)
    assert waves.velocity(at(1, 2, -DEPTH, n), times)[:, 2] == pytest.approx(0.0, abs=1e-12)
    assert waves.head(at(1, 2, 0, n), times) == pytest.approx(waves.elevation(at(1, 2, 0, n), times), abs=1e-12)
    assert waves.displacement(at(1, 2, 0, n), times)[:, 2] == pytest.approx(waves.elevation(at(1, 2, 0, n), times))


def test_pressure_decays_with_depth_by_the_ratio_of_hyperbolic_cosines():
    z = np.array([0.0, -1.0, -4.0, -6.0])
    _, _, pressing = depth_factors(0.7, z, 6.0)
    assert pressing == pytest.approx(np.cosh(0.7 * (z + 6.0)) / np.cosh(0.7 * 6.0))
    assert all(np.isfinite(factor).all() for factor in depth_factors(1e4, z, 6.0))


def test_waves_go_where_they_are_said_to_go(waves):
    mean = waves.wavenumber.sum(axis=0)
    assert np.degrees(np.arctan2(mean[1], mean[0])) == pytest.approx(30.0, abs=15.0)
    # A crest seen at one place is seen later farther along: theta falls with time, grows along the wavenumber.
    ahead = at(0.05 * np.cos(np.pi / 6), 0.05 * np.sin(np.pi / 6), 0, 200)
    times = np.arange(200) * 0.3
    here, there = waves.elevation(at(0, 0, 0, 200), times), waves.elevation(ahead, times)
    rate = (waves.elevation(at(0, 0, 0, 200), times + 1e-3) - here) / 1e-3
    assert np.corrcoef(there - here, rate)[0, 1] < -0.8


def test_a_calm_site_has_no_waves():
    calm = build_waves(SiteRecipe(), 3.0, Streams(1))
    assert np.array_equal(calm.displacement(at(0, 0, -1, 5), np.arange(5.0)), np.zeros((5, 3)))
    assert np.array_equal(calm.head(at(0, 0, -1, 5), np.arange(5.0)), np.zeros(5))
