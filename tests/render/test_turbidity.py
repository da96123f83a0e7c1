"""Water that varies: transmittance by numerical integration, limits, energy, and what changes nothing."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from oysterbench.core.streams import Streams
from oysterbench.recipe import LampRecipe
from oysterbench.recipe.turbidity import LayerRecipe, PatchesRecipe, PlumesRecipe
from oysterbench.render.admixture import silt
from oysterbench.render.camera import CameraRenderer
from oysterbench.scene.plumes import Plumes
from oysterbench.scene.waves import build_waves
from tests.helpers.reefs import CAMERA, FLAT, noise, pose, renderer_of, rig_with, small_reef, world_of

DOWN = pose(0.0, 0.0, -2.2, 20, 40)
LAMPS = rig_with(LampRecipe(intensity_cd=2000.0, position_m=(0.1, 0.2, 0.0)))
LIGHT = ["radiance", "direct", "forward_scatter", "backscatter"]
MUD = {**FLAT, "bottom": "mud"}


def puffs_at(*places, amount: float = 0.5, spread: float = 0.25) -> Plumes:
    """Puffs at rest over a level bottom at 3 m, of an amount in m^2 each."""
    recipe = PlumesRecipe(attenuation=10.0)
    n = len(places)
    place = np.array(places, dtype=float).reshape(n, 3)
    waves = build_waves(small_reef().site, 3.0, Streams(1))
    wide, floor, much = (np.full(n, value) for value in (spread, -3.0, amount))
    return Plumes(recipe, np.full(n, -1.0), place, wide, floor, much, np.array([0.0, 9.0]), np.zeros((2, 2)), waves)


def silty(*places, light=None, rig=None, reef=MUD, water=None, **keys) -> CameraRenderer:
    recipe = small_reef(reef, water={"plumes": PlumesRecipe(attenuation=10.0), **(water or {})}, light=light)
    return CameraRenderer(world_of(recipe), CAMERA, recipe, rig=rig, plumes=puffs_at(*places, **keys))


def grey_levels(renderer: CameraRenderer, radiance: np.ndarray) -> np.ndarray:
    linear = np.clip(radiance * np.array(renderer.exposure.scale), 0, 1)
    return 255 * np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)


@pytest.mark.parametrize(
    ("kind", "daylight", "pitch"),
    [
        ("3C", 0.0, 40),
        ("7C", 1.0, 40),
        *(pytest.param(*case, marks=pytest.mark.slow) for case in (("1C", 1.0, 40), ("3C", 1.0, 40), ("3C", 1.0, 90))),
    ],
)
def test_an_endless_layer_is_the_even_water_of_that_turbidity(kind: str, daylight: float, pitch: float) -> None:
    rig = LAMPS if daylight == 0.0 else None
    layer = LayerRecipe(factor=2.0, thickness_m=1e6)
    layered = renderer_of(small_reef(MUD, {"jerlov": kind, "layer": layer}, {"daylight": daylight}), rig=rig)
    even = renderer_of(small_reef(MUD, {"jerlov": kind, "turbidity": 2.0}, {"daylight": daylight}), rig=rig)
    at = pose(0.0, 0.0, -2.2, 20, pitch)
    a, b = (grey_levels(even, r.layers(at, ["radiance"])["radiance"]) for r in (layered, even))
    assert np.abs((a - b).mean(axis=(0, 1))).max() < 1.0
    assert np.abs(a - b).max() < 2.5


def test_transmittance_through_puffs_is_the_numerical_integral() -> None:
    places = [(0.8, 0.1, -2.6), (1.2, -0.1, -2.4), (0.5, 0.3, -2.9)]
    renderer = silty(*places, spread=0.2)
    renderer.layers(DOWN, ["radiance"])
    field = renderer._optics.turbidity
    along = field.along.numpy()
    puffs = puffs_at(*places, spread=0.2).at(0.0)
    direction = DOWN[:3, :3] @ np.array([0.0, 0.0, 1.0])
    middle = along[along.shape[0] // 2, along.shape[1] // 2]
    nodes = along.shape[2] - 1
    distances = field.reach * (np.arange(nodes) / (nodes - 1)) ** 2
    fine = np.linspace(0, distances[-1], 4000)
    steps = puffs.attenuation(DOWN[:3, 3] + fine[:, None] * direction)
    integral = np.interp(distances, fine, np.concatenate([[0], np.cumsum(0.5 * (steps[1:] + steps[:-1]) * fine[1])]))
    assert integral[-1] > 1.0
    assert middle[:-1, 1] == pytest.approx(integral, abs=0.03 * integral[-1])


def test_silt_dims_surfaces_by_beers_law() -> None:
    """Of a puff between camera and bottom that throws no shadow on what is seen, by the attenuation of silt."""
    at = pose(-1.2, 0.0, -2.4, 0, 25)
    places = [(-0.6, 0.0, -2.68)]
    names = ["direct", "forward_scatter", "depth", "transmittance"]
    with_silt = silty(*places, amount=0.15, spread=0.15).layers(at, names)
    without = silty((50.0, 0.0, -2.5)).layers(at, names)
    puffs = puffs_at(*places, amount=0.15, spread=0.15).at(0.0)
    row, column = 60, 80
    reach = with_silt["depth"][row, column]
    line = np.linspace(0, reach, 500)
    direction = at[:3, :3] @ np.array([0.0, 0.0, 1.0])
    depth = puffs.attenuation(at[:3, 3] + line[:, None] * direction).sum() * line[1]
    assert depth > 0.5
    seen = with_silt["direct"][row, column, 1] / without["direct"][row, column, 1]
    assert -np.log(seen) == pytest.approx(depth, rel=0.12)
    through = with_silt["transmittance"] / np.maximum(without["transmittance"], 1e-6)
    assert seen < through[row, column] < 1.0, "most of what is scattered forward arrives, blurred"
    assert through[-1, 0] == pytest.approx(1.0, abs=0.02)


@pytest.mark.slow
def test_a_plume_out_of_sight_or_of_no_strength_changes_no_byte() -> None:
    recipe = small_reef({"bottom": "mud"}, water={"snow_per_m3": 500.0})
    even = renderer_of(recipe, rig=LAMPS).render(DOWN, noise(), 1.0).colour
    world = world_of(recipe)
    for plumes in (puffs_at((50.0, 0.0, -2.5)), puffs_at((0.5, 0.0, -2.5), amount=0.0)):
        other = CameraRenderer(world, CAMERA, recipe, rig=LAMPS, plumes=plumes)
        assert np.array_equal(even, other.render(DOWN, noise(), 1.0).colour)


@pytest.mark.slow
def test_nothing_is_brighter_than_its_source() -> None:
    """In full daylight, looking anywhere through thick silt: less than a white surface in the sun."""
    renderer = silty(*[(x, y, -2.7) for x in (0.4, 0.9, 1.4) for y in (-0.4, 0.0, 0.4)], amount=3.0)
    for pitch in (-20, 10, 40, 90):
        layers = renderer.layers(pose(-0.3, 0.0, -2.3, 0, pitch), LIGHT)
        assert np.isfinite(layers["radiance"]).all()
        assert layers["backscatter"].min() >= 0.0
        assert layers["backscatter"].max() < 1.0


def test_a_plume_hides_glows_and_shades() -> None:
    place = (0.6, 0.0, -2.6)
    without, plume = (r.layers(DOWN, LIGHT) for r in (silty((50.0, 0.0, -2.5)), silty(place, amount=2.0)))
    middle = (slice(40, 80), slice(60, 100))
    assert plume["direct"][middle].mean() < 0.1 * without["direct"][middle].mean()
    assert plume["backscatter"][middle].mean() > 1.5 * without["backscatter"][middle].mean()
    under = pose(0.6, 0.0, -2.95, 0, 80)
    dark, bright = (r.layers(under, ["radiance"])["radiance"] for r in (silty(place, amount=2.0), silty((50, 0, -2.5))))
    assert dark.mean() < 0.7 * bright.mean(), "it takes the daylight from what is below it"


@pytest.mark.slow
def test_caustics_fade_under_silt() -> None:
    """Under plumes high over the bottom, which take little light, and most of the pattern in it."""
    above = [(x, y, -0.6) for x in (-0.8, 0.0, 0.8) for y in (-0.8, 0.0, 0.8)]

    def pattern(wind_m_s: float, places: list[tuple[float, float, float]]) -> np.ndarray:
        light = {"wind_m_s": wind_m_s, "sky_fraction": 0.1, "sun_elevation_deg": 85.0}
        renderer = silty(*places, amount=1.5, spread=0.3, light=light)
        return renderer.layers(pose(0.0, 0.0, -2.4, 0, 90), ["direct"])["direct"][..., 1]

    clear, under = (pattern(5.0, places) / pattern(0.0, places) for places in ([(50.0, 0.0, -2.5)], above))
    assert under.mean() == pytest.approx(clear.mean(), rel=0.05)
    assert 0.2 * clear.std() < under.std() < 0.75 * clear.std()


@pytest.mark.slow
def test_lamps_light_a_plume_and_not_what_is_behind_it() -> None:
    night = {"daylight": 0.0}
    place = (0.6, 0.0, -2.6)
    without, plume = (
        r.layers(DOWN, LIGHT)
        for r in (silty((50.0, 0.0, -2.5), light=night, rig=LAMPS), silty(place, amount=1.0, light=night, rig=LAMPS))
    )
    middle = (slice(40, 80), slice(60, 100))
    assert plume["backscatter"][middle].mean() > 1.8 * without["backscatter"][middle].mean()
    assert plume["direct"][middle].mean() < 0.2 * without["direct"][middle].mean()


@pytest.mark.slow
def test_detail_is_lost_in_silt_and_not_only_light() -> None:
    """What silt scatters forward arrives blurred, whatever forward_blur says of the water."""
    reef = {"bottom": "mud"}
    place = (0.6, 0.0, -2.5)
    without, plume = (
        r.layers(DOWN, ["radiance"])["radiance"] for r in (silty((50, 0, -2), reef=reef), silty(place, reef=reef))
    )

    def contrast(picture: np.ndarray) -> float:
        green = picture[30:90, 50:110, 1]
        return float(np.abs(np.diff(green, axis=1)).mean() / green.mean())

    assert contrast(plume) < 0.6 * contrast(without)


def test_a_layer_thickens_towards_the_bottom() -> None:
    recipe = small_reef(FLAT, {"layer": LayerRecipe(factor=3.0, thickness_m=0.4)})
    renderer = renderer_of(recipe)
    renderer.layers(pose(0.0, 0.0, -1.0, 0, 90), ["radiance"])
    field = renderer._optics.turbidity
    along = field.along.numpy()
    ray = along[along.shape[0] // 2, along.shape[1] // 2]
    # Straight down to 2 m below: 2 T (exp(-h / T) from the bottom up).
    distances = field.reach * (np.arange(len(ray) - 1) / (len(ray) - 2)) ** 2
    own = np.interp(2.0, distances, ray[:-1, 0])
    assert own == pytest.approx(2.0 * 0.4 * (1 - np.exp(-2.0 / 0.4)), rel=0.06)


def test_patches_are_even_on_average_and_drift() -> None:
    recipe = small_reef(FLAT, {"patches": PatchesRecipe(contrast=0.6, size_m=0.5)})
    recipe = dataclasses.replace(recipe, site=dataclasses.replace(recipe.site, current_m_s=0.25))
    renderer = renderer_of(recipe)
    renderer.layers(pose(0.0, 0.0, -1.5, 0, 60), ["radiance"], time_s=0.0)
    before = renderer._optics.turbidity.along.numpy()[..., 20, 0]
    renderer.layers(pose(1.0, 0.0, -1.5, 0, 60), ["radiance"], time_s=4.0)
    after = renderer._optics.turbidity.along.numpy()[..., 20, 0]
    assert after == pytest.approx(before, abs=2e-3), "seen from a camera that drifts along"
    assert before.std() > 0.02
    assert before.min() < 0 < before.max()


def test_silt_is_mineral() -> None:
    """Nearly the same at all wavelengths, and brighter than what it absorbs."""
    grains = silt(1.0)
    b = grains.scatter()
    assert b[0] / b[-1] < 1.3
