"""A picture is laid on another by their oysters, and only where they tell."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from oysterbench.mapping import MapSettings
from oysterbench.mapping.projection import Patch
from oysterbench.mapping.registration import register

SETTINGS = MapSettings()
SHIFT = np.array([0.09, -0.06, 0.01])


def reef(seed, n=60, edge_m=1.0):
    """Oysters a few centimetres from one another, nearer than the path errs."""
    generator = np.random.default_rng(seed)
    places = np.column_stack([generator.uniform(0.0, edge_m, (n, 2)), generator.normal(0.0, 0.01, n)])
    return places, np.exp(generator.normal(np.log(4e-3), 0.4, n))


def patches(places, areas, sigma_m=0.05, noise_m=0.004, seed=9):
    noisy = places + np.random.default_rng(seed).normal(0.0, noise_m, places.shape)
    return [
        Patch(0, k, at[None], at, 100, area, False, (sigma_m**2 + 1e-4) * np.eye(3), sigma_m, pose_sigma_m=sigma_m)
        for k, (at, area) in enumerate(zip(noisy, areas, strict=True), start=1)
    ]


def earlier(places, areas, sigma_m=0.05):
    return patches(places, areas, sigma_m, seed=10)


def turned(places, degrees):
    return places @ Rotation.from_euler("z", degrees, degrees=True).as_matrix().T


@pytest.mark.parametrize("seed", range(5))
def test_a_picture_that_is_off_by_more_than_oysters_are_apart_is_laid_to_millimetres(seed):
    places, areas = reef(seed)
    found = register(patches(places - SHIFT, areas), earlier(places, areas), SETTINGS)
    assert found is not None
    assert np.allclose(found.shift, SHIFT, atol=0.004)
    assert found.sigma_m < 0.004
    assert found.pairs > 40


@pytest.mark.parametrize("seed", range(5))
def test_of_other_ground_it_is_not(seed):
    (places, areas), (others, sizes) = reef(seed), reef(seed + 50)
    assert register(patches(places, areas), earlier(others, sizes), SETTINGS) is None


@pytest.mark.parametrize("degrees", [-3.0, 1.0, 3.0])
def test_it_is_turned_too(degrees):
    places, areas = reef(4)
    found = register(patches(turned(places, -degrees) - SHIFT, areas), earlier(places, areas), SETTINGS)
    assert np.degrees(found.turn_rad) == pytest.approx(degrees, abs=0.2)
    assert abs(found.turn_rad - np.radians(degrees)) < 3.0 * found.sigma_rad
    there = found.about + found.shift
    assert np.linalg.norm((turned((found.about + SHIFT)[None], degrees)[0] - there)[:2]) < 3.0 * found.sigma_m


def test_half_of_what_it_shows_may_be_new():
    places, areas = reef(3)
    known = places[:, 0] < 0.5
    found = register(patches(places - SHIFT, areas), earlier(places[known], areas[known]), SETTINGS)
    assert np.allclose(found.shift, SHIFT, atol=0.005)


def test_few_oysters_tell_nothing():
    places, areas = reef(1, n=3)
    assert register(patches(places, areas), earlier(places, areas), SETTINGS) is None


def test_it_is_not_looked_for_farther_than_poses_may_err():
    places, areas = reef(2)
    sure = patches(places - SHIFT, areas, sigma_m=0.01)
    assert register(sure, earlier(places, areas, sigma_m=0.01), SETTINGS) is None


def test_a_turned_oyster_has_its_uncertainty_along_its_own_ray():
    one = replace(patches(*reef(0))[0], covariance=np.diag([4.0, 1.0, 1.0]))
    move = np.eye(4)
    move[:3, :3] = Rotation.from_euler("z", 90, degrees=True).as_matrix()
    assert np.allclose(one.placed(move).covariance, np.diag([1.0, 4.0, 1.0]))


def test_laid_oysters_are_as_sure_as_the_shift_but_for_their_depth():
    one = replace(patches(*reef(0))[0], sigma_m=0.06)
    move = np.eye(4)
    move[:3, 3] = SHIFT
    laid = one.laid(move, 0.002)
    assert np.allclose(laid.centre, one.centre + SHIFT)
    assert np.allclose(laid.points, one.points + SHIFT)
    assert laid.sigma_m == pytest.approx(np.sqrt(0.06**2 - 0.05**2 + 0.002**2))
    assert np.allclose(laid.covariance, one.covariance + (0.002**2 - 0.05**2) * np.eye(3))
    assert one.laid(np.eye(4), one.pose_sigma_m).sigma_m == one.sigma_m
