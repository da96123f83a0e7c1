"""Sound in water against published tables and formulas of others."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.optimize import brentq

from oysterbench.recipe import BOTTOMS, CLASSES, SiteRecipe
from oysterbench.sensors import acoustics

WATERS = {"cold river": (10.0, 12.0), "warm river": (25.0, 12.0), "warm sea": (25.0, 35.0)}
TABLE_DB_M = {
    "cold river": {115: 0.016, 750: 0.192, 1200: 0.465, 2100: 1.39},
    "warm river": {115: 0.017, 750: 0.154, 1200: 0.323, 2100: 0.889},
    "warm sea": {115: 0.045, 750: 0.237, 1200: 0.408, 2100: 0.975},
}


def site(name: str) -> SiteRecipe:
    temperature, salinity = WATERS[name]
    return SiteRecipe(temperature_c=temperature, salinity_ppt=salinity)


def mackenzie(t, s, d):
    """Speed of sound (Mackenzie 1981)."""
    return (
        1448.96 + 4.591 * t - 5.304e-2 * t**2 + 2.374e-4 * t**3 + 1.340 * (s - 35) + 1.630e-2 * d + 1.675e-7 * d**2
    ) - (1.025e-2 * t * (s - 35) + 7.139e-13 * t * d**3)


def ainslie_mccolm(t, s, ph, d, f):
    """Absorption in dB/km (Ainslie & McColm 1998), within some 10 % of Francois and Garrison."""
    boric = 0.78 * np.sqrt(s / 35) * np.exp(t / 26)
    sulphate = 42 * np.exp(t / 17)
    return (
        0.106 * boric * f**2 / (f**2 + boric**2) * np.exp((ph - 8) / 0.56)
        + 0.52 * (1 + t / 43) * (s / 35) * sulphate * f**2 / (f**2 + sulphate**2) * np.exp(-d / 6000)
        + 0.00049 * f**2 * np.exp(-(t / 27 + d / 17000))
    )


@pytest.mark.parametrize(("name", "speed"), [("cold river", 1461.5), ("warm river", 1509.3), ("warm sea", 1534.4)])
def test_sound_is_as_fast_as_published(name, speed):
    assert acoustics.sound_speed(site(name), 0.0) == pytest.approx(speed, abs=0.06)
    assert acoustics.sound_speed(site(name), 50.0) == pytest.approx(mackenzie(*WATERS[name], 50.0), abs=0.2)


@pytest.mark.parametrize("name", WATERS)
def test_absorption_agrees_with_the_table_within_2_percent(name):
    for frequency, expected in TABLE_DB_M[name].items():
        rounding = 0.5 * 10.0 ** -(3 if expected < 1 else 2)  # of the table's own digits
        assert acoustics.absorption(site(name), 0.0, frequency) == pytest.approx(expected, rel=0.02, abs=rounding)


@pytest.mark.parametrize("frequency", [1, 10, 50, 115, 400, 1000])
def test_absorption_is_that_of_another_formula_within_its_accuracy(frequency):
    sea = SiteRecipe(temperature_c=12.0, salinity_ppt=34.0, ph=8.0)
    other = ainslie_mccolm(12.0, 34.0, 8.0, 20.0, frequency) / 1000
    assert acoustics.absorption(sea, 20.0, frequency) == pytest.approx(other, rel=0.1)


@pytest.mark.parametrize("width_deg", [0.5, 2.0, 20.0, 90.0])
def test_a_beam_has_its_width_at_half_power_and_its_aperture(width_deg):
    width = np.radians(width_deg)
    half = brentq(lambda angle: acoustics.beam_pattern(angle, width) - 0.5, 0.0, acoustics.first_null(width))
    assert 2 * half == pytest.approx(width, rel=1e-5)
    null = acoustics.first_null(width)
    lobe = quad(lambda angle: float(acoustics.beam_pattern(angle, width)) * np.cos(angle), -null, null)[0]
    assert acoustics.aperture(width) == pytest.approx(lobe, rel=1e-6)


def test_the_first_sidelobe_is_13_db_down():
    width = np.radians(2.0)
    angles = np.linspace(acoustics.first_null(width), 2 * acoustics.first_null(width), 2000)
    assert 10 * np.log10(acoustics.beam_pattern(angles, width).max()) == pytest.approx(-13.26, abs=0.02)


def test_every_class_but_water_sends_something_back():
    for bottom in BOTTOMS:
        mu = acoustics.backscatter(bottom)
        assert mu.shape == (len(CLASSES),)
        assert mu[0] == 0
        assert np.all((mu[1:] > 0) & (mu[1:] < 1))


def test_a_patch_obeys_the_sonar_equation():
    """A patch dA at the angle theta sends back mu cos^2(theta) dA r^-4 10^(-2 a r / 10)."""
    r, theta, mu, loss, area = 7.0, 1.1, 0.02, 0.3, 1e-4
    solid_angle = area * np.cos(theta) / r**2
    power = acoustics.echo_strength(np.array([r, np.inf]), np.cos(theta), mu, loss) * solid_angle
    assert power[0] == pytest.approx(mu * np.cos(theta) ** 2 * area * r**-4 * 10 ** (-2 * loss * r / 10))
    assert power[1] == 0


def test_more_bandwidth_resolves_more():
    assert acoustics.range_resolution(1500.0, 200.0) == pytest.approx(0.00375)
