"""The pressure sensor, held against hydrostatics and linear waves."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from oysterbench.core.geometry import GRAVITY
from oysterbench.core.streams import Streams
from oysterbench.recipe import SiteRecipe, load_split
from oysterbench.scene.path import build_path
from oysterbench.scene.waves import build_waves
from oysterbench.sensors.pressure import ATMOSPHERE, PressureRecipe, density, depth_of, measure, noise_variance, tide

TIMES = np.arange(0.0, 20.0, 0.05)
CALM = SiteRecipe(temperature_c=15.0, salinity_ppt=12.0)


def hills(x, y):
    return -4.0 + 0.2 * np.sin(x) * np.cos(0.7 * y)


@pytest.fixture(scope="module")
def path():
    return build_path(load_split("slam-mini").sequence[0], hills, hills, Streams(7))


def sensor(**changes):
    quiet = {"offset_m": 0.0, "noise_m": 0.0, "step_pa": 0.0}
    return PressureRecipe(**{**quiet, **changes})


def read(path, recipe, site=CALM, seed=1):
    return measure(path, recipe, site, build_waves(site, 4.0, Streams(seed)), TIMES, Streams(seed))


def test_density_is_that_of_the_check_values():
    # UNESCO Technical Papers in Marine Science 44 (1983), at 0 dbar.
    for temperature, salinity, wanted in (
        (5, 0, 999.96675),
        (5, 35, 1027.67547),
        (25, 0, 997.04796),
        (25, 35, 1023.34306),
    ):
        site = SiteRecipe(temperature_c=temperature, salinity_ppt=salinity)
        assert density(site) == pytest.approx(wanted, abs=1e-4)


def test_pressure_is_that_of_air_and_water_above_the_sensor_and_not_above_the_body(path):
    lever = np.array([0.2, -0.1, 0.15])
    motion = path.at(TIMES)
    z = motion.position[:, 2] + np.array([(r @ lever)[2] for r in motion.rotation])
    pressure = read(path, sensor(position_m=tuple(lever)))
    assert pressure == pytest.approx(ATMOSPHERE - density(CALM) * GRAVITY * z, abs=1e-6)
    assert depth_of(pressure, CALM) == pytest.approx(-z, abs=1e-9)
    assert np.ptp(-z - (-motion.position[:, 2])) > 1e-3  # the lever arm swings


def test_offset_stays_and_noise_does_not(path):
    still = read(path, sensor())
    offsets = [read(path, sensor(offset_m=0.02), seed=seed) - still for seed in range(200)]
    assert all(np.ptp(offset) < 1e-6 for offset in offsets)
    weight = density(CALM) * GRAVITY
    assert np.std([offset[0] for offset in offsets]) == pytest.approx(0.02 * weight, rel=0.15)
    recipe = sensor(noise_m=0.002, step_pa=40.0)
    noise = np.concatenate([read(path, recipe, seed=seed) - still for seed in range(20)])
    assert noise.var() == pytest.approx(noise_variance(recipe, CALM), rel=0.05)
    assert noise.mean() == pytest.approx(0.0, abs=3.0)


def test_readings_come_in_steps_and_stop_at_the_depth_the_sensor_bears(path):
    readings = read(path, PressureRecipe(step_pa=20.0))
    assert readings / 20.0 == pytest.approx(np.rint(readings / 20.0), abs=1e-9)
    assert np.abs(readings - read(path, PressureRecipe(step_pa=0.0))).max() <= 10.0 + 1e-6
    assert depth_of(read(path, sensor(max_depth_m=2.0)), CALM) == pytest.approx(2.0)


def test_the_tide_presses_with_its_height_and_returns_with_its_period(path):
    site = dataclasses.replace(CALM, tide_m=0.4, tide_period_h=0.02)
    felt = depth_of(read(path, sensor(), site), CALM) - depth_of(read(path, sensor()), CALM)
    assert felt == pytest.approx(tide(site, TIMES, Streams(1)))
    day = tide(site, np.arange(0.0, 144.0, 0.5), Streams(1))
    assert (day.max(), day.min()) == (pytest.approx(0.4, abs=1e-3), pytest.approx(-0.4, abs=1e-3))
    assert day[:144] == pytest.approx(day[144:])
    starts = [tide(site, np.zeros(1), Streams(seed))[0] for seed in range(50)]
    assert min(starts) < -0.2
    assert max(starts) > 0.2


def test_waves_press_less_the_deeper_the_sensor_is(path):
    site = dataclasses.replace(CALM, wave_height_m=0.5, wave_period_s=2.5)
    waves = build_waves(site, 4.0, Streams(1))
    felt = depth_of(read(path, sensor(), site), CALM) - depth_of(read(path, sensor()), CALM)
    assert felt == pytest.approx(waves.head(path.at(TIMES).position, TIMES), abs=1e-9)
    surface = waves.elevation(path.at(TIMES).position, TIMES)
    assert 0.1 * surface.std() < felt.std() < 0.7 * surface.std()


def test_above_the_water_there_is_only_air(path):
    site = dataclasses.replace(CALM, tide_m=10.0, tide_period_h=0.01)
    assert read(path, sensor(), site).min() == ATMOSPHERE


def test_noise_does_not_depend_on_the_site(path):
    wavy = dataclasses.replace(CALM, wave_height_m=0.5, tide_m=1.0)
    noise = [read(path, sensor(noise_m=0.01, offset_m=0.1), s) - read(path, sensor(), s) for s in (CALM, wavy)]
    assert noise[0] == pytest.approx(noise[1], abs=1e-6)
