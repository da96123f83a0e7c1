"""Water and light against closed forms and published checks."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import quad

from oysterbench.recipe import JERLOV_TYPES, LightRecipe, WaterRecipe
from oysterbench.render.light import WATER_INDEX, build_light, exposure
from oysterbench.render.water import JERLOV, build_water, forward_share, phase


def test_every_jerlov_type_of_the_recipe_has_coefficients() -> None:
    assert tuple(JERLOV) == JERLOV_TYPES


@pytest.mark.parametrize("kind", ["3C", "5C", "7C", "9C"])
def test_green_diffuse_attenuation_agrees_with_kirk(kind: str) -> None:
    (_, a, _), (_, b, _), (_, diffuse, _) = JERLOV[kind]
    assert np.sqrt(a**2 + 0.256 * a * b) == pytest.approx(diffuse, rel=0.25)  # Kirk 1984


def test_phase_function_integrates_to_one_and_to_its_forward_share() -> None:
    def over_cone(angle: float) -> float:
        return quad(lambda t: 2 * np.pi * phase(t) * np.sin(t), 0, angle, points=[0.1])[0]

    assert over_cone(np.pi) == pytest.approx(1.0, rel=1e-6)
    assert over_cone(0.3) == pytest.approx(forward_share(0.3), rel=1e-6)


def test_backscattered_share_is_petzolds() -> None:
    assert 1 - forward_share(np.pi / 2) == pytest.approx(0.0183, abs=0.001)


@pytest.mark.parametrize("kind", JERLOV_TYPES)
def test_direct_light_is_lost_faster_than_by_absorption_and_slower_than_by_the_beam(kind: str) -> None:
    water = build_water(WaterRecipe(jerlov=kind))
    a, b, _ = np.array(JERLOV[kind])
    assert np.all(water.direct[1:] > a[1:])
    assert np.all(water.direct[1:] < (a + b)[1:])
    assert np.all(water.diffuse > 0)


def test_image_formation_limits_are_the_surface_and_the_veil() -> None:
    water = build_water(WaterRecipe(jerlov="3C"))
    assert water.transmission(0.0) == pytest.approx(1.0)
    assert water.saturation(0.0) == pytest.approx(0.0)
    assert water.saturation(1e4) == pytest.approx(1.0)
    assert water.transmission(2.0) == pytest.approx(np.exp(-2.0 * water.direct))
    assert water.daylight(-1.0) == pytest.approx(1.0)


def test_sun_is_refracted_by_snells_law() -> None:
    light = build_light(LightRecipe(sun_elevation_deg=30.0, sun_azimuth_deg=90.0, sky_fraction=0.3))
    assert np.linalg.norm(light.sun_direction) == pytest.approx(1.0, abs=1e-6)
    assert light.sun_direction[1] == pytest.approx(np.cos(np.deg2rad(30.0)) / WATER_INDEX, abs=1e-6)
    assert light.sun_direction[0] == pytest.approx(0.0, abs=1e-6)
    assert light.sun + light.sky == pytest.approx(1.0)


@pytest.mark.parametrize("kind", JERLOV_TYPES)
def test_exposure_lifts_every_water_to_a_middle_grey(kind: str) -> None:
    gain = exposure(build_water(WaterRecipe(jerlov=kind)), 4.0)
    assert gain.shape == (3,)
    assert np.all(np.isfinite(gain))
    assert np.all(gain > 0)
