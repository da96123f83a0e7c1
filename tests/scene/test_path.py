"""Paths: smooth, exact in their derivatives, and clear of the reef."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from oysterbench.core.errors import RecipeError
from oysterbench.core.streams import Streams
from oysterbench.recipe import load_split
from oysterbench.scene.path import build_path

RECIPE = load_split("slam-mini").sequence[0]


def flat(x, y):
    return np.full(np.shape(x), -4.0)


@pytest.fixture(scope="module")
def path():
    return build_path(RECIPE, flat, flat, Streams(7))


def test_velocity_and_acceleration_are_derivatives_of_position(path):
    times, step = np.linspace(0.1, 19.9, 397), 1e-5
    before, here, after = path.at(times - step), path.at(times), path.at(times + step)
    assert np.allclose((after.position - before.position) / (2 * step), here.velocity, atol=1e-8)
    assert np.allclose((after.velocity - before.velocity) / (2 * step), here.acceleration, atol=1e-7)


def test_body_rates_are_derivatives_of_attitude(path):
    times, step = np.linspace(0.1, 19.9, 397), 1e-5
    before, here, after = path.at(times - step), path.at(times), path.at(times + step)
    turn = np.einsum("nji,njk->nik", before.rotation, after.rotation)
    assert np.allclose(Rotation.from_matrix(turn).as_rotvec() / (2 * step), here.rate, atol=1e-8)
    assert np.allclose((after.rate - before.rate) / (2 * step), here.rate_dot, atol=1e-7)


def test_acceleration_and_angular_acceleration_are_continuous(path):
    motion = path.at(np.arange(0.0, 20.0, 1e-3))
    assert np.abs(np.diff(motion.acceleration, axis=0)).max() < 0.01
    assert np.abs(np.diff(motion.rate_dot, axis=0)).max() < 0.01


def test_the_vehicle_starts_at_rest_and_reaches_its_speed(path):
    speed = np.linalg.norm(path.at(np.arange(0.0, 20.0, 0.01)).velocity, axis=1)
    assert speed[0] < 1e-3
    assert np.mean(speed[500:]) == pytest.approx(RECIPE.path.speed_m_s, rel=0.2)


def test_the_path_keeps_its_altitude_over_a_slope():
    def slope(x, y):
        return -4.0 + 0.3 * np.asarray(x)

    path = build_path(RECIPE, slope, slope, Streams(7))
    position = path.position(np.arange(0.0, 20.0, 0.1))
    altitude = position[:, 2] - slope(position[:, 0], position[:, 1])
    assert np.abs(altitude - RECIPE.path.altitude_m).max() < 0.35


def test_another_seed_gives_another_path_and_the_same_seed_the_same(path):
    times = np.linspace(0.0, 20.0, 50)
    assert np.array_equal(build_path(RECIPE, flat, flat, Streams(7)).position(times), path.position(times))
    assert not np.allclose(build_path(RECIPE, flat, flat, Streams(8)).position(times), path.position(times))


def test_a_path_through_a_rock_is_refused_by_name():
    def rocks(x, y):
        return np.full(np.shape(x), -3.1)

    with pytest.raises(RecipeError, match=r"path\.altitude_m.*above the reef.*clearance_m = 0\.3"):
        build_path(RECIPE, flat, rocks, Streams(7))


def test_a_path_through_the_surface_is_refused_by_name():
    high = dataclasses.replace(RECIPE, path=dataclasses.replace(RECIPE.path, altitude_m=3.99))
    with pytest.raises(RecipeError, match="breaks the surface"):
        build_path(high, flat, flat, Streams(7))
