"""The magnetometer, held against the field that it turns in."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from oysterbench.core.streams import Streams
from oysterbench.recipe import SiteRecipe, load_split
from oysterbench.scene.path import build_path
from oysterbench.sensors.magnetometer import MagnetometerRecipe, earth_field, measure, noise_variance

TIMES = np.arange(0.0, 20.0, 0.02)
SITE = SiteRecipe()


def hills(x, y):
    return -4.0 + 0.2 * np.sin(x) * np.cos(0.7 * y)


@pytest.fixture(scope="module")
def path():
    return build_path(load_split("slam-mini").sequence[0], hills, hills, Streams(7))


def read(path, seed=1, **changes):
    return measure(path, MagnetometerRecipe(**{"noise_ut": 0.0, **changes}), SITE, TIMES, Streams(seed))


def test_the_field_points_north_down_and_west_of_true_north_over_virginia():
    east, north, up = earth_field(SITE)
    assert np.linalg.norm([east, north, up]) == pytest.approx(50.5e-6)
    assert np.degrees(np.arcsin(-up / 50.5e-6)) == pytest.approx(65.0)
    assert np.degrees(np.arctan2(east, north)) == pytest.approx(-10.8)
    assert earth_field(SiteRecipe(inclination_deg=-90.0))[2] == pytest.approx(50.5e-6)


def test_turned_back_by_the_attitude_it_is_the_field_of_the_earth(path):
    mount = (10.0, -5.0, 90.0)
    turn = path.at(TIMES).rotation @ Rotation.from_euler("xyz", mount, degrees=True).as_matrix()
    fields = np.array([r @ b for r, b in zip(turn, read(path, rpy_deg=mount), strict=True)])
    assert fields == pytest.approx(np.tile(earth_field(SITE), (len(TIMES), 1)), abs=1e-15)


def test_a_level_compass_gives_the_heading(path):
    motion = path.at(TIMES)
    field = read(path)
    level = np.array(
        [
            Rotation.from_euler("ZYX", [0, *Rotation.from_matrix(r).as_euler("ZYX")[1:]]).apply(b)
            for r, b in zip(motion.rotation, field, strict=True)
        ]
    )
    yaw = np.arctan2(motion.rotation[:, 1, 0], motion.rotation[:, 0, 0])
    # Magnetic north lies at 90 deg - declination from east; seen from the body, the vehicle's yaw less.
    magnetic = np.radians(90.0 - SITE.declination_deg)
    difference = np.arctan2(level[:, 1], level[:, 0]) - (magnetic - yaw)
    assert np.angle(np.exp(1j * difference)) == pytest.approx(0.0, abs=1e-9)


def test_hard_iron_shifts_and_soft_iron_bends_as_a_fit_of_an_ellipsoid_finds(path):
    soft = ((1.1, 0.05, 0.0), (0.02, 0.9, -0.03), (0.0, 0.04, 1.05))
    hard = (12.0, -30.0, 4.0)
    clean, bent = read(path), read(path, soft_iron=soft, hard_iron_ut=hard)
    design = np.column_stack([clean * 1e6, np.ones(len(clean))])
    found = np.linalg.lstsq(design, bent * 1e6)[0].T
    assert found[:, :3] == pytest.approx(np.array(soft), abs=1e-9)
    assert found[:, 3] == pytest.approx(hard, abs=1e-7)


def test_noise_and_steps_have_the_variance_that_is_told(path):
    recipe = {"noise_ut": 0.3, "step_ut": 0.5}
    noise = np.concatenate([read(path, seed, **recipe) - read(path) for seed in range(10)])
    assert noise.var() == pytest.approx(noise_variance(MagnetometerRecipe(**recipe)), rel=0.03)
    assert np.corrcoef(noise.T) == pytest.approx(np.eye(3), abs=0.03)
    counts = read(path, **recipe) / 0.5e-6
    assert counts == pytest.approx(np.rint(counts), abs=1e-6)
