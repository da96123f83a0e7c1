"""Plumes of silt against the physics that they are made of."""

from __future__ import annotations

import dataclasses
import itertools

import numpy as np
import pytest
from scipy.interpolate import make_interp_spline

from oysterbench.core.streams import Streams
from oysterbench.recipe import SequenceRecipe
from oysterbench.recipe.turbidity import PlumesRecipe
from oysterbench.scene.path import Path
from oysterbench.scene.plumes import BURST_PUFFS, RISE_S, Plumes, Puffs, bed_stress, build_plumes
from oysterbench.scene.waves import build_waves
from tests.helpers.reefs import small_reef

BOTTOM = -3.0


def flat(x, y):
    return np.full(np.shape(x), BOTTOM)


def hovering(altitude: float, seconds: float = 30.0, heave: float = 0.05) -> Path:
    """A vehicle that bobs up and down on one spot, with a period of 2 s."""
    times = np.arange(0.0, seconds + 2.0, 0.1)
    position = np.zeros((len(times), 3))
    position[:, 2] = BOTTOM + altitude + heave * np.sin(np.pi * times)
    return Path(make_interp_spline(times, position, k=5), make_interp_spline(times, 0 * position, k=5), seconds)


def muddy(current: float = 0.0, **keys) -> SequenceRecipe:
    recipe = small_reef({"bottom": "mud"}, water={"plumes": PlumesRecipe(attenuation=10.0, **keys)})
    return dataclasses.replace(recipe, duration_s=30.0, site=dataclasses.replace(recipe.site, current_m_s=current))


def one_puff(current: float = 0.0, height: float = 0.3, **keys) -> Plumes:
    """A single puff of 1 m^2 that rises at 0 s."""
    recipe = muddy(current, **keys)
    times = np.array([0.0, 1000.0])
    drift = np.array([[0.0, 0.0], [1000.0 * current, 0.0]])
    place = np.array([[0.0, 0.0, BOTTOM + height]])
    waves = build_waves(recipe.site, 3.0, Streams(1))
    born, spread, floor, amount = np.zeros(1), np.array([0.2]), np.array([BOTTOM]), np.ones(1)
    return Plumes(recipe.water.plumes, born, place, spread, floor, amount, times, drift, waves)


def mass(puffs: Puffs) -> float:
    """Attenuation integrated over the water above the bottom, m^2."""
    step = 0.08
    centre = puffs.centre[0]
    x, y = (np.arange(-2.4, 2.4, step) + c for c in centre[:2])
    z = BOTTOM + step * (np.arange(40) + 0.5)
    points = np.stack(np.meshgrid(x, y, z, indexing="ij"), -1).reshape(-1, 3)
    return float(puffs.attenuation(points).sum() * step**3)


@pytest.mark.parametrize("age", [RISE_S, 20.0, 90.0])
def test_silt_is_conserved_but_for_what_settles(age: float) -> None:
    plumes = one_puff(settling_mm_s=1.0, diffusivity_m2_s=5e-4)
    assert mass(plumes.at(age)) == pytest.approx(plumes.at(age).amount[0], rel=0.01)
    ages = np.linspace(RISE_S, age, 60)
    lost = 0.0
    for a, b in itertools.pairwise(ages):
        puffs = plumes.at((a + b) / 2)
        just_above = puffs.attenuation(np.array([[0.0, 0.0, BOTTOM]]))[0] * 2 * np.pi * puffs.spread[0] ** 2
        lost += 1e-3 * just_above * (b - a)
    gone = plumes.at(RISE_S).amount[0] - plumes.at(age).amount[0]
    assert gone == pytest.approx(lost, rel=0.03, abs=1e-6)


def test_silt_drifts_with_the_current_spreads_and_sinks() -> None:
    plumes = one_puff(current=0.1, settling_mm_s=1.0, diffusivity_m2_s=5e-4)
    puffs = plumes.at(50.0)
    assert puffs.centre[0] == pytest.approx([5.0, 0.0, BOTTOM + 0.25], abs=1e-6)
    assert puffs.spread[0] == pytest.approx(np.sqrt(0.04 + 2 * 5e-4 * 50))
    assert plumes.at(400.0).amount.size == 0, "it is forgotten"
    assert plumes.at(-1.0).amount.size == 0


def test_thrusters_raise_silt_only_where_their_jets_reach_the_bottom() -> None:
    low, high = (build_plumes(muddy(), hovering(h), flat, Streams(2)) for h in (0.5, 1.6))
    assert low is not None
    assert high is not None
    assert len(low.born) > 10
    assert len(high.born) == 0


def test_a_hovering_vehicle_makes_no_thicker_water_than_the_recipe_says() -> None:
    plumes = build_plumes(muddy(), hovering(0.4, heave=0.1), flat, Streams(2))
    assert plumes is not None
    puffs = plumes.at(30.0)
    thickest = puffs.attenuation(puffs.centre).max()
    assert 4.0 < thickest < 15.0


def test_stress_of_a_jet_falls_with_the_cube_of_the_height() -> None:
    force = np.array([[0.0, 0.0, 5.0]])
    near, far = (bed_stress(force, np.array([h + 0.1]))[0] for h in (0.5, 1.0))
    assert near / far == pytest.approx(8.0)
    assert near == pytest.approx(0.5 * 0.01 * 0.076 / 0.5 * 6.2**2 * 4 / np.pi * 5.0 / 0.25)
    assert bed_stress(-force, np.array([0.5]))[0] == 0.0, "thrust down blows up"


def test_bursts_come_as_often_as_asked() -> None:
    recipe = muddy(current=0.2, bursts_per_100m2_min=30.0)
    recipe = dataclasses.replace(recipe, reef=dataclasses.replace(recipe.reef, size_m=20.0))
    plumes = build_plumes(recipe, hovering(1.6), flat, Streams(3))
    assert plumes is not None
    expected = 30.0 * (20.0 + 2 * 10.0) ** 2 / 100 * (30.0 + 240.0) / 60
    assert len(plumes.born) / BURST_PUFFS == pytest.approx(expected, abs=4 * np.sqrt(expected))


def test_the_same_recipe_makes_the_same_plumes() -> None:
    one, two = (build_plumes(muddy(), hovering(0.5), flat, Streams(2)) for _ in range(2))
    assert one is not None
    assert two is not None
    assert np.array_equal(one.at(20.0).centre, two.at(20.0).centre)


def test_no_plumes_without_the_key() -> None:
    assert build_plumes(small_reef(), hovering(0.5), flat, Streams(2)) is None
