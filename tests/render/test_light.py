"""Lamps, caustics, hidden sky and blur against their closed forms."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
import warp as wp

from oysterbench.core.streams import Streams
from oysterbench.recipe import LampRecipe
from oysterbench.render import blur, lamps
from oysterbench.render.camera import CameraRenderer
from oysterbench.render.caustics import Waves
from oysterbench.render.light import Light, sun_fan
from oysterbench.render.radiance import Daylight, solve_daylight
from oysterbench.render.water import IMAGE_CONE_RAD, build_water
from tests.helpers.reefs import CAMERA, FLAT, noise, pose, renderer_of, rig_with, small_reef, world_of

LAMP = LampRecipe(intensity_cd=1000.0, half_angle_deg=50.0, edge_deg=20.0, pitch_deg=90.0)
NIGHT = {"daylight": 0.0}


def down(height_m):
    return pose(0.0, 0.0, -3.0 + height_m, 0, 90)


def middle(picture):
    return picture[56:64, 76:84].reshape(-1, 3).mean(axis=0)


def test_a_lamps_light_falls_with_the_inverse_square():
    clear = renderer_of(small_reef(FLAT, light=NIGHT), rig=rig_with(LAMP))
    base = np.eye(4)
    values = []
    for height in (0.5, 1.0, 2.0):
        base[2, 3] = -3.0 + height
        values.append(middle(clear.layers(down(0.6), ["clean"], T_map_base=base)["clean"]))
    assert values[0] / values[1] == pytest.approx(np.full(3, 4.0), rel=0.03)
    assert values[1] / values[2] == pytest.approx(np.full(3, 4.0), rel=0.03)


def test_a_lamps_light_is_weakened_both_ways():
    recipe = small_reef(FLAT, light=NIGHT)
    renderer = renderer_of(recipe, rig=rig_with(LAMP))
    water = build_water(recipe.water, Daylight(float(renderer._optics.sun_direction[2]), renderer._optics.sky), 6.0)
    base = np.eye(4)
    base[2, 3] = -1.8
    layers = renderer.layers(down(0.6), ["clean", "direct", "forward_scatter"], T_map_base=base)
    arrived = middle(layers["direct"] + layers["forward_scatter"]) / middle(layers["clean"])
    expected = np.exp(-lamps.lamp_spread(water) * 1.2) * water.arriving(3.0, 0.6)
    assert arrived == pytest.approx(expected, rel=0.02)


def test_a_beam_is_the_integral_along_the_ray():
    recipe = small_reef(FLAT, light=NIGHT)
    rig = rig_with(dataclasses.replace(LAMP, position_m=(0.0, 0.3, 0.0), half_angle_deg=60.0))
    renderer = renderer_of(recipe, rig=rig)
    base = np.eye(4)
    base[2, 3] = -2.0
    seen = renderer.layers(down(1.0), ["backscatter"], T_map_base=base)["backscatter"][60, 80]
    water = build_water(recipe.water, Daylight(1.0, 0.3), 6.0)
    s = (np.arange(20000) + 0.5) / 20000
    apart = np.hypot(0.3, s)
    cosine = s / apart
    low, high = np.cos(np.deg2rad([70, 50]))
    edge = np.clip((cosine - low) / (high - low), 0, 1)
    edge = edge**2 * (3 - 2 * edge)
    g = water.asymmetry
    turned = -s / apart  # cosine of the scattering angle: back towards the camera
    phase = (1 - g * g) / (4 * np.pi * (1 + g * g - 2 * g * turned) ** 1.5)
    spread = lamps.lamp_spread(water)
    light = edge * 1000 / lamps.DAYLIGHT_LUX / apart**2 * np.pi * phase
    expected = (light[:, None] * np.exp(-spread * (apart + s)[:, None])).mean(axis=0) * water.scattering
    assert seen == pytest.approx(expected, rel=0.05)


def test_lamps_that_are_off_change_no_byte():
    recipe = small_reef()
    world = world_of(recipe)
    plain = CameraRenderer(world, CAMERA, recipe).render(pose(0, 0, -2.2, 20, 40), noise())
    dark = dataclasses.replace(recipe, light=dataclasses.replace(recipe.light, lamps=0.0))
    off = CameraRenderer(world, CAMERA, dark, rig=rig_with(LAMP)).render(pose(0, 0, -2.2, 20, 40), noise())
    assert np.array_equal(plain.colour, off.colour)


def waves(wind, depth=3.0):
    recipe = small_reef(light={"wind_m_s": wind})
    return Waves(recipe.light, build_water(recipe.water, Daylight(), 6.0), depth, Streams(77), "cpu")


def test_caustics_have_mean_one_and_move():
    some = waves(4.0)
    tiles = []
    for time_s in (0.0, 0.02, 30.0):
        some.move(time_s)
        tiles.append(some.light.tile.numpy().copy())
        assert tiles[-1].mean(dtype=float) == pytest.approx(1.0, abs=1e-6)
        assert tiles[-1].std() > 0.3
    near, far = (np.corrcoef(tiles[0].ravel(), tile.ravel())[0, 1] for tile in tiles[1:])
    assert near > 0.5 > abs(far)


def test_caustics_fade_with_depth_and_are_absent_in_a_calm():
    fade = waves(4.0).light.fade.numpy()
    assert fade[0] == 1.0
    assert np.all(np.diff(fade) < 0)
    calm = waves(0.0)
    calm.move(3.0)
    assert calm.light.on == 0
    assert np.all(calm.light.tile.numpy() == 1.0)


def test_caustics_keep_the_mean_light_of_the_bottom():
    T_map_cam = pose(0.0, 0.0, -1.0, 0, 90)
    still, moved = (
        renderer_of(small_reef(FLAT, {"jerlov": "IB"}, {"wind_m_s": wind})).layers(T_map_cam, ["clean"], time_s=2.0)[
            "clean"
        ]
        for wind in (0.0, 5.0)
    )
    assert moved.mean() == pytest.approx(still.mean(), rel=0.08)
    assert (moved / still).std() > 0.2


def test_the_sky_is_hidden_between_shells_and_open_on_bare_ground():
    recipe = small_reef({"oysters": 400, "relief_rms_m": 0.0}, light={"occlusion_m": 0.2, "sky_fraction": 1.0})
    renderer = renderer_of(recipe)
    renderer.layers(pose(0.0, 0.0, -2.0, 0, 90), ["radiance"])
    opening = renderer._openings.numpy()
    assert np.percentile(opening, 95) > 0.97
    assert np.percentile(opening, 1) < 0.6
    assert opening.min() > 0.1


def test_a_blur_keeps_the_light_and_spreads_it_as_wide_as_it_says():
    point = np.zeros((241, 321, 3), dtype=np.float32)
    point[120, 160] = 1.0
    spread = wp.zeros(point.shape[:2], dtype=wp.vec3)
    blur.Blur(point.shape[:2], 200.0, 0.02, "cpu").spread(wp.array(point, dtype=wp.vec3), spread)
    result = spread.numpy()[..., 0].astype(float)
    assert result.sum() == pytest.approx(1.0, abs=0.03)
    column = np.arange(321) - 160
    variance = (result * column**2).sum() / result.sum()
    expected = sum(s * (w * 4.0) ** 2 for s, w in zip(blur.SHARES, blur.WIDTHS, strict=True))
    assert np.sqrt(variance) == pytest.approx(np.sqrt(expected), rel=0.15)


def test_the_blur_of_an_even_picture_is_that_picture():
    even = wp.full((50, 70), wp.vec3(0.3, 0.2, 0.1), dtype=wp.vec3)
    result = wp.zeros((50, 70), dtype=wp.vec3)
    blur.Blur((50, 70), 200.0, 0.05, "cpu").spread(even, result)
    assert result.numpy() == pytest.approx(even.numpy(), rel=1e-5)


@pytest.mark.parametrize(("jerlov", "depth_m"), [("IB", 4.0), ("3C", 2.0), ("5C", 2.0), ("7C", 1.0), ("9C", 1.0)])
def test_the_suns_fan_is_as_wide_as_the_discrete_ordinates_find(jerlov, depth_m):
    # A high sun, whose field is the same all around it, and no sky.
    light = Light(np.array([0.0, 0.0, 1.0]), 1.0, 0.0)
    water = build_water(small_reef(water={"jerlov": jerlov}).water, Daylight(0.9999, 0.0), 6.0)
    field = solve_daylight(float(water.absorption[1]), float(water.scattering[1]), 0.92, Daylight(0.9999, 0.0))
    turned = np.sort(np.arccos(sun_fan(light, water, depth_m)[:, 2].astype(float)))

    def within(angle):
        cosines = np.linspace(np.cos(angle), 1.0, 4001)
        radiance = field.radiance(np.array([depth_m]), cosines)[0]
        unscattered = field.beam * np.exp(-field.rates[-1] * depth_m)
        return 2 * np.pi * np.trapezoid(radiance * cosines, cosines) + unscattered

    for angle in (0.15, 0.3, 0.5):
        expected = within(angle) / within(IMAGE_CONE_RAD)
        assert np.mean(turned < angle) == pytest.approx(expected, abs=0.04 + 1 / 16)


@pytest.mark.slow
def test_shadows_are_sharp_in_clear_water_and_soft_where_sunlight_is_scattered():
    moved = []
    for jerlov in ("I", "3C", "9C"):
        recipe = small_reef({"relief_rms_m": 0.0, "oysters": 400}, {"jerlov": jerlov}, {"sky_fraction": 0.2})
        renderer = renderer_of(recipe)
        shaded = []
        for layer in ("radiance", "clean"):  # with the water's fan, and with the sun alone
            renderer.layers(pose(0.0, 0.0, -2.0, 0, 90), [layer])
            shaded.append(renderer._lit.numpy() == 0)
        assert shaded[1].mean() > 0.01
        moved.append(np.mean(shaded[0] != shaded[1]) / np.mean(shaded[1]))
    assert moved[0] < 0.02
    assert 0.2 < moved[1] < moved[2]


@pytest.mark.parametrize("kind", ["I", "IA", "pure"])
def test_the_clearest_water_shows_the_reef_in_slanting_sunlight(kind):
    """Its sunlight comes from one direction: a fan so narrow that rounding decides the sign of its sine squared."""
    water = {"jerlov": None, "type": kind}
    recipe = small_reef({"oysters": 0, "stones": 0}, water=water, light={"sun_elevation_deg": 50.0})
    renderer = renderer_of(recipe, dataclasses.replace(CAMERA, width=32, height=24))
    assert renderer.layers(down(0.6), ["radiance"])["radiance"].min() > 0.01


@pytest.mark.slow
def test_caustics_do_not_repeat_over_the_reef():
    recipe = small_reef({**FLAT, "size_m": 20.0}, {"jerlov": "I"}, {"wind_m_s": 4.0})
    still = dataclasses.replace(recipe, light=dataclasses.replace(recipe.light, wind_m_s=0.0))
    period = 4.0
    places = [(x, y) for x in (-1.0, 0.0, 1.0) for y in (-1.0, 0.0, 1.0)]
    world = world_of(recipe)
    waves, flat = (CameraRenderer(world, CAMERA, r) for r in (recipe, still))

    def pattern(x, y):
        top = pose(x, y, -1.5, 0, 90)
        lit, even = (r.layers(top, ["clean"], time_s=2.0)["clean"][..., 1] for r in (waves, flat))
        return (lit / even)[20:100, 20:140].ravel()

    alike = []
    for x, y in places:
        here = pattern(x, y)
        for dx, dy in ((period, 0.0), (0.0, period), (period, period)):
            alike.append(np.corrcoef(here, pattern(x + dx, y + dy))[0, 1])
    assert np.mean(alike) < 0.5, "a quarter of the light at most is the same a period away"
    assert np.corrcoef(pattern(0.0, 0.0), pattern(0.0, 0.0))[0, 1] > 0.999
