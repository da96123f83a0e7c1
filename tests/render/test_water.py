"""Water and light against closed forms, tables and published checks."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import quad

from oysterbench.recipe import JERLOV_TYPES, WATER_TYPES, LightRecipe, WaterRecipe
from oysterbench.render.light import build_light, exposure
from oysterbench.render.radiance import WATER_INDEX
from oysterbench.render.spectra import (
    JERLOV,
    RED_TABLE_OFFSET,
    TABLE_WAVELENGTHS,
    WAVELENGTHS,
    jerlov_constituents,
)
from oysterbench.render.water import Water, build_water, forward_share, phase

TABLE_ROWS = [int(np.flatnonzero(wavelength == WAVELENGTHS)[0]) for wavelength in TABLE_WAVELENGTHS]


@pytest.fixture(scope="module")
def waters() -> dict[str, Water]:
    return {kind: build_water(WaterRecipe(type=kind)) for kind in WATER_TYPES}


def test_every_jerlov_type_of_the_recipe_has_coefficients() -> None:
    assert tuple(JERLOV) == JERLOV_TYPES


@pytest.mark.parametrize("kind", JERLOV_TYPES)
def test_spectra_pass_through_the_table(kind: str) -> None:
    a, b, _ = np.array(JERLOV[kind])
    a[0] -= RED_TABLE_OFFSET
    water = jerlov_constituents(kind)
    assert water.absorption()[TABLE_ROWS] == pytest.approx(a, rel=0.11)
    assert water.scatter()[TABLE_ROWS] == pytest.approx(b, rel=0.03)


def test_phase_function_integrates_to_one_and_to_its_forward_share() -> None:
    def over_cone(angle: float) -> float:
        return quad(lambda t: 2 * np.pi * phase(t) * np.sin(t), 0, angle, points=[0.1])[0]

    assert over_cone(np.pi) == pytest.approx(1.0, rel=1e-6)
    assert over_cone(0.3) == pytest.approx(forward_share(0.3), rel=1e-6)


def test_backscattered_share_is_petzolds() -> None:
    assert 1 - forward_share(np.pi / 2) == pytest.approx(0.0183, abs=0.001)


@pytest.mark.parametrize("kind", WATER_TYPES)
def test_image_formation_limits_are_the_surface_and_the_veil(waters: dict[str, Water], kind: str) -> None:
    water = waters[kind]
    assert water.direct[:, 0] == pytest.approx(1.0)
    assert water.glow[:, 0] == pytest.approx(0.0)
    assert water.saturation[:, 0] == pytest.approx(0.0)
    assert water.daylight[0] == pytest.approx(1.0, rel=1e-4)
    for table in (water.direct, water.direct + water.glow, 1.0 - water.saturation):
        assert np.all(np.diff(table, axis=1) <= 1e-6)
        assert np.all(table >= 0)
    assert np.all(np.diff(water.daylight, axis=0) < 0)
    assert np.all(water.glow >= 0)
    assert np.all(water.veil >= 0)
    if water.ranges[-1] < 100:
        assert np.all(water.saturation[:, -1] > 0.999)


@pytest.mark.parametrize("kind", ["I", "II", "3C", "7C", "chesapeake-clear"])
def test_red_light_is_attenuated_less_per_metre_the_farther_it_has_come(waters: dict[str, Water], kind: str) -> None:
    water = waters[kind]
    near = -np.log(water.arriving(1.0, 0.5)[0]) / 0.5
    far = -np.log(water.arriving(1.0, 5.0)[0] / water.arriving(1.0, 4.5)[0]) / 0.5
    assert far < 0.99 * near


def test_exposure_lifts_every_water_to_a_middle_grey(waters: dict[str, Water]) -> None:
    for water in waters.values():
        gain = exposure(water, 4.0)
        assert gain.shape == (3,)
        assert np.all(np.isfinite(gain))
        assert np.all(gain > 0)


def test_sun_is_refracted_by_snells_law() -> None:
    light = build_light(LightRecipe(sun_elevation_deg=30.0, sun_azimuth_deg=90.0, sky_fraction=0.3))
    assert np.linalg.norm(light.sun_direction) == pytest.approx(1.0, abs=1e-6)
    assert light.sun_direction[1] == pytest.approx(np.cos(np.deg2rad(30.0)) / WATER_INDEX, abs=1e-6)
    assert light.sun_direction[0] == pytest.approx(0.0, abs=1e-6)
    assert light.sun + light.sky == pytest.approx(1.0)
