"""Water and light against closed forms, tables and published checks."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import quad

from oysterbench.core.errors import RecipeError
from oysterbench.recipe import JERLOV_TYPES, WATER_TYPES, LightRecipe, WaterRecipe, load_split, parse_split
from oysterbench.render.light import build_light, exposure
from oysterbench.render.radiance import WATER_INDEX, Daylight, solve_daylight
from oysterbench.render.spectra import (
    JERLOV,
    RED_TABLE_OFFSET,
    TABLE_WAVELENGTHS,
    WAVELENGTHS,
    camera_response,
    camera_weights,
    diffuse_attenuation,
    jerlov_constituents,
    molecular_scattering,
    secchi_depth,
    water_constituents,
)
from oysterbench.render.water import ASYMMETRY, IMAGE_CONE_RAD, Water, build_water, forward_share, phase

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
    assert water.forward_scatter[:, 0] == pytest.approx(0.0)
    assert water.saturation[:, 0] == pytest.approx(0.0)
    assert water.daylight[0] == pytest.approx(1.0, rel=1e-4)
    for table in (water.direct, water.direct + water.forward_scatter, 1.0 - water.saturation):
        assert np.all(np.diff(table, axis=1) <= 1e-6)
        assert np.all(table >= 0)
    assert np.all(np.diff(water.daylight, axis=0) < 0)
    assert np.all(water.forward_scatter >= 0)
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


def solved_attenuation(a: np.ndarray, b: np.ndarray, depth_m: np.ndarray) -> np.ndarray:
    """Kd (L,), 1/m, from the surface to depth_m (L,)."""
    fields = [solve_daylight(*pair, ASYMMETRY, Daylight()) for pair in zip(a, b, strict=True)]
    return np.array([-np.log(f.irradiance(np.array([z]))[0]) / z for f, z in zip(fields, depth_m, strict=True)])


def test_daylight_weakens_about_as_jerlovs_table_says(capsys: pytest.CaptureFixture[str]) -> None:
    """Kd over the upper 10 m within a third; the table's a and b come from another model than its Kd."""
    lines = ["Kd over the table's, at 650, 550, 450 nm"]
    for kind, row in JERLOV.items():
        water = jerlov_constituents(kind)
        a, b = water.absorption()[TABLE_ROWS], water.scatter()[TABLE_ROWS]
        ratio = solved_attenuation(a, b, np.full(3, 10.0)) / row[2]
        lines.append(f"{kind:5s} " + " ".join(f"{r:.2f}" for r in ratio))
        assert np.all(ratio > 0.6)
        assert np.all(ratio < 1.2)
    with capsys.disabled():
        print("\n  " + "\n  ".join(lines))


@pytest.mark.parametrize("kind", ["IB", "1C", "3C", "5C", "7C", "9C", "chesapeake-turbid"])
def test_daylight_weakens_as_kirks_monte_carlo_runs_say(kind: str) -> None:
    """Over the layer down to 1 % of the light, for which Kirk fitted his formula."""
    water = water_constituents(WaterRecipe(type=kind))
    a, b = water.absorption()[TABLE_ROWS], water.scatter()[TABLE_ROWS]
    kirk = diffuse_attenuation(a, b, Daylight().sun_cosine)
    assert solved_attenuation(a, b, np.log(100) / kirk) == pytest.approx(kirk, rel=0.2)


def test_radiance_in_water_that_only_absorbs_is_the_sky_through_beer() -> None:
    field = solve_daylight(0.3, 1e-12, 0.92, Daylight(sun_cosine=0.9, sky=1.0))
    looking_up = field.radiance(np.array([0.0, 2.0]), np.array([0.95]))[:, 0]
    assert looking_up[0] == pytest.approx(WATER_INDEX**2 / np.pi, rel=0.05)  # the sky, gathered into Snell's cone
    assert looking_up[1] / looking_up[0] == pytest.approx(np.exp(-2.0 * 0.3 / 0.95), rel=0.01)
    assert field.irradiance(np.array([0.0])) == pytest.approx(1.0, abs=1e-9)


def test_daylight_is_conserved_where_nothing_absorbs() -> None:
    """Net irradiance does not change with depth when the water only scatters (almost)."""
    field = solve_daylight(1e-6, 1.0, 0.92, Daylight())
    depths = np.array([0.5, 1.0, 3.0])
    down = field.irradiance(depths)
    up = np.maximum(-field.cosines, 0.0) * field.weights
    rising = 2 * np.pi * np.array([field.radiance(np.array([d]), field.cosines)[0] @ up for d in depths])
    assert np.ptp(down - rising) < 1e-4


@pytest.mark.parametrize("kind", WATER_TYPES)
def test_water_is_brighter_upwards_than_downwards(waters: dict[str, Water], kind: str) -> None:
    down, level, up = (waters[kind].veiling(3.0, 1e6, cosine) for cosine in (-0.9, 0.0, 0.9))
    assert np.all(down < level)
    assert np.all(level < up)


def test_types_are_ordered_by_how_far_one_sees_in_green(waters: dict[str, Water]) -> None:
    """Along the coastal types and on into the bay; III scatters more than 1C, so that one slider cannot order all."""
    for order in (JERLOV_TYPES[:5], (*JERLOV_TYPES[5:], *WATER_TYPES[10:13])):
        arriving = [waters[kind].arriving(1.0, 2.0)[1] for kind in order if kind not in ("chesapeake-clear",)]
        assert np.all(np.diff(arriving) < 0)


@pytest.mark.parametrize(
    ("kind", "secchi"), [("chesapeake-clear", 2.0), ("chesapeake-mid", 1.2), ("chesapeake-turbid", 0.65)]
)
def test_bay_waters_have_their_secchi_depth(kind: str, secchi: float) -> None:
    water = water_constituents(WaterRecipe(type=kind))
    assert secchi_depth(water) == pytest.approx(secchi, rel=1e-6)
    # The same disc by contrast: 8.7 / (c + Kd) at the best seen wavelength (Preisendorfer 1986: 8 to 9.6).
    a, b = water.absorption()[TABLE_ROWS[1]], water.scatter()[TABLE_ROWS[1]]
    assert 8.7 / (a + b + diffuse_attenuation(a, b)) == pytest.approx(secchi, rel=0.4)


@pytest.mark.parametrize("kind", ["3C", "chesapeake-mid", "pure"])
def test_a_secchi_depth_in_the_recipe_is_the_waters(kind: str) -> None:
    water = water_constituents(WaterRecipe(type=kind, secchi_m=3.0, cdom_440=0.1, scattering_550=0.4))
    assert secchi_depth(water) == pytest.approx(3.0, rel=1e-6)


def test_turbidity_scales_particles_and_leaves_dissolved_matter() -> None:
    plain, double, none = (water_constituents(WaterRecipe(type="chesapeake-mid", turbidity=t)) for t in (1, 2, 0))
    assert double.scatter() == pytest.approx(2 * plain.scatter())
    assert double.cdom == plain.cdom
    assert none.scattering == 0
    assert np.all(np.isfinite(build_water(WaterRecipe(type="I", turbidity=0)).veil))


def test_water_without_particles_has_no_veil() -> None:
    water = build_water(WaterRecipe(type="3C", turbidity=0))
    assert np.max(water.veiling(3.0, 10.0, -0.5)) < 1e-8
    assert np.max(water.forward_scatter) == pytest.approx(0, abs=1e-6)


def test_daylight_can_be_sun_alone_or_sky_alone() -> None:
    for sky in (0.0, 1.0):
        water = build_water(WaterRecipe(type="3C"), Daylight(sun_cosine=0.7, sky=sky))
        assert np.all(np.isfinite(water.veil))
        assert water.daylight[0] == pytest.approx(1.0, rel=1e-4)


def test_jerlov_key_and_type_key_make_the_same_water() -> None:
    assert water_constituents(WaterRecipe(jerlov="3C")) == water_constituents(WaterRecipe(type="3C"))


def test_camera_bands_are_shares() -> None:
    response = camera_response()
    assert response.sum(axis=1) == pytest.approx(1.0)
    assert np.all(response >= 0)
    assert [WAVELENGTHS[i] for i in response.argmax(axis=1)] == [600, 540, 460]


@pytest.mark.parametrize(
    ("lines", "message"),
    [
        ('jerlov = "3C"\nturbidity = -1', r"mini\.toml: key 'sequence\.water\.turbidity': expected 0 to 20, got -1"),
        ('type = "4C"', r"mini\.toml: key 'sequence\.water\.type': expected one of I, .*turbid, pure, got '4C'"),
        ('type = "pure"\nsecchi_m = 0', r"mini\.toml: key 'sequence\.water\.secchi_m': expected 0\.2 to 12, got 0"),
        ("turbidity = 1", r"mini\.toml: sequence mini-01: missing key 'water\.type' \(one of I, "),
        (
            'type = "pure"\nsecchi_m = 3.0\nturbidity = 2.0',
            r"'water\.secchi_m': pure water has nothing to scale.*got 3$",
        ),
        ('type = "pure"\njerlov = "9C"', r"'water\.type', 'water\.jerlov': expected one of them, got 'pure' and '9C'"),
        ('type = "pure"\nsalt = 1', r"mini\.toml: unknown key 'sequence\.water\.salt'; known keys here: type, jerlov"),
    ],
)
def test_bad_values_are_refused_by_name(lines: str, message: str) -> None:
    source = load_split("slam-mini").source
    assert 'jerlov = "3C"' in source
    with pytest.raises(RecipeError, match=message):
        parse_split(source.replace('jerlov = "3C"', lines), "mini.toml")


@pytest.mark.parametrize("kind", ["I", "II", "3C", "9C", "chesapeake-clear"])
@pytest.mark.parametrize("cosine", [-0.95, -0.5, 0.0])
def test_veil_of_the_tables_is_duntleys_in_every_wavelength(waters: dict[str, Water], kind: str, cosine: float) -> None:
    """L(z, mu) - exp(-c' r) L(z - mu r, mu), wavelength by wavelength, for level and falling view rays."""
    matter = water_constituents(WaterRecipe(type=kind))
    a, b = matter.absorption(), matter.scatter()
    clear = np.minimum(molecular_scattering(), b)
    image = a + b - forward_share(IMAGE_CONE_RAD) * (b - clear)
    fields = [solve_daylight(x, y, ASYMMETRY, Daylight(), z) for x, y, z in zip(a, b, clear, strict=True)]
    for range_m in (0.3, 1.0, 3.0):
        depths = np.array([3.0, 3.0 - cosine * range_m])
        ends = np.array([field.radiance(depths, np.array([cosine]))[:, 0] for field in fields])
        veil = np.pi * camera_weights() @ (ends[:, 0] - np.exp(-image * range_m) * ends[:, 1])
        assert waters[kind].veiling(3.0, range_m, cosine) == pytest.approx(veil, rel=0.05)
