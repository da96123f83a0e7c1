"""Layers, sensor and snow: what a picture is made of."""

from __future__ import annotations

import dataclasses
import os
import platform
import subprocess
import sys

import numpy as np
import pytest
from numpy._core._multiarray_umath import __cpu_dispatch__, __cpu_features__

from oysterbench.recipe import CLASSES, LampRecipe
from oysterbench.render.camera import LAYERS, UNLIT, CameraRenderer
from oysterbench.render.lens import pixel_rays
from oysterbench.render.sensor import FULL_WELL, READ_NOISE, vignette
from oysterbench.scene.rig import camera_pose
from tests.helpers.paths import ROOT
from tests.helpers.reefs import CAMERA, FLAT, noise, pose, renderer_of, rig_with, small_reef, world_of

EVERYTHING = {"wind_m_s": 4.0, "occlusion_m": 0.15}
THICK = {"snow_per_m3": 3000.0, "forward_blur": 1.0}
LAMPS = rig_with(LampRecipe(intensity_cd=2000.0, position_m=(0.1, 0.2, 0.0)))
PLACE = pose(0.0, 0.0, -2.2, 20, 40)


@pytest.fixture(scope="module")
def full():
    return renderer_of(small_reef(water=THICK, light=EVERYTHING), rig=LAMPS)


def test_layers_add_up_to_the_picture_before_noise(full):
    layers = full.layers(PLACE, [name for name in LAYERS if name != "flow"], time_s=1.0)
    total = layers["direct"] + layers["forward_scatter"] + layers["backscatter"] + layers["snow"]
    assert total == pytest.approx(layers["radiance"], abs=1e-5)
    frame = full.render(PLACE, noise(), time_s=1.0)
    gain = np.array(full.exposure.scale)
    linear = np.clip(layers["radiance"] * gain, 0, 1)
    code = 255 * np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)
    assert abs((frame.colour - code).mean()) < 0.15
    assert np.array_equal(layers["depth"], frame.depth)
    assert np.array_equal(layers["instances"], frame.instances)


def test_layers_that_need_no_light_are_the_same_without_it(full):
    names = [name for name in UNLIT if name != "flow"]
    alone, together = full.layers(PLACE, names, time_s=1.0), full.layers(PLACE, [*names, "radiance"], time_s=1.0)
    for name in names:
        assert np.array_equal(alone[name], together[name], equal_nan=True), name
    before = full.seconds["shading"]
    full.layers(PLACE, names, time_s=1.0)
    assert full.seconds["shading"] == before


def test_a_clean_picture_has_no_water_in_it():
    recipe = small_reef(FLAT)
    near, far = (
        renderer_of(recipe).layers(pose(0.0, 0.0, -3.0 + height, 0, 90), ["clean"])["clean"] for height in (0.3, 2.5)
    )
    turbid = renderer_of(small_reef(FLAT, water={"jerlov": "9C", "turbidity": 5.0}))
    same = turbid.layers(pose(0.0, 0.0, -2.7, 0, 90), ["clean"])["clean"]
    light = turbid._optics.sun, turbid._optics.sky
    assert np.abs(near / same - (near / same).mean()).max() < 1e-5, "only the shares of sun and sky may differ"
    assert light[0] + light[1] == pytest.approx(1.0)
    assert far.mean() == pytest.approx(near.mean(), rel=0.2), "the bottom is as bright from afar"
    ones = turbid._clear
    for table in (ones.direct, ones.daylight):
        assert np.all(table.numpy() == 1.0)
    for table in (ones.forward_scatter, ones.veil, ones.saturation):
        assert np.all(table.numpy() == 0.0)


def test_an_unknown_layer_is_named(full):
    with pytest.raises(ValueError, match=r"unknown layers \['fog'\]; expected some of radiance"):
        full.layers(PLACE, ["fog"])


def test_normals_are_unit_vectors_that_face_the_camera(full):
    layers = full.layers(PLACE, ["normals", "depth"])
    there = layers["depth"] > 0
    assert np.linalg.norm(layers["normals"], axis=-1)[there] == pytest.approx(1.0, abs=1e-4)
    assert np.all(layers["normals"][~there] == 0)
    rays = pixel_rays(CAMERA)[1:-1, 1:-1].copy()
    rays[..., 2] = 1.0
    assert (np.sum(layers["normals"] * rays, axis=-1)[there] < 0.2).mean() > 0.98


def two_stones(aside):
    """A flat bottom with two stones, one over the other as a camera from above sees it, `aside` m off its middle."""
    recipe = small_reef({**FLAT, "stones": 2})
    world = world_of(recipe)
    things = world.instances
    assert len(things) == 2
    values = {f.name: getattr(things, f.name).copy() for f in dataclasses.fields(things)}
    values["shapes"][:] = values["shapes"][0]
    values["rotations"][:] = np.eye(3)
    values["scales"][:] = 0.1
    values["positions"][:] = [[0.0, 0.0, -2.7], [aside, 0.0, -2.4]]
    return recipe, dataclasses.replace(world, instances=type(things)(**values))


def test_visibility_is_the_share_of_pixels_that_nothing_hides():
    T_map_cam = pose(0.0, 0.0, -1.6, 0, 90)
    recipe, world = two_stones(0.06)
    renderer = CameraRenderer(world, CAMERA, recipe)
    layers = renderer.layers(T_map_cam, ["visibility", "instances"])
    below = dataclasses.replace(world, instances=world.instances.take(np.array([0])))
    alone = CameraRenderer(below, CAMERA, recipe).layers(T_map_cam, ["instances"])["instances"]
    expected = (layers["instances"] == 1).sum() / (alone == 1).sum()
    assert 0.05 < expected < 0.9
    assert layers["visibility"][1] == pytest.approx(expected)
    assert layers["visibility"][2] == 1.0
    assert np.isnan(layers["visibility"][0])
    recipe, apart = two_stones(0.5)
    assert CameraRenderer(apart, CAMERA, recipe).layers(T_map_cam, ["visibility"])["visibility"][1] == 1.0


def test_the_vehicle_is_seen_by_a_camera_behind_it_and_has_its_class():
    camera = dataclasses.replace(CAMERA, position_m=(-1.0, 0.0, 0.4), pitch_deg=25.0)
    renderer = renderer_of(small_reef(FLAT), camera, rig=rig_with(vehicle="bluerov2"))
    base = np.eye(4)
    base[2, 3] = -1.8
    frame = renderer.render(base @ camera_pose(camera), noise())
    vehicle = {name: number for number, name in CLASSES.items()}["vehicle"]
    seen = frame.classes == vehicle
    assert 0.02 < seen.mean() < 0.5
    assert 0.6 < frame.depth[seen].min() < 1.2
    assert np.all(frame.instances[seen] == 1), "one more than the world has"
    base[0, 3] = 30.0  # far away
    away = renderer.render(np.linalg.inv(np.linalg.inv(pose(0, 0, -2.0, 0, 30))), noise(), T_map_base=base)
    assert not np.any(away.classes == vehicle)


def test_vignetting_is_the_fourth_power_of_the_cosine():
    camera = dataclasses.replace(CAMERA, vignetting=1.0)
    share = vignette(pixel_rays(camera), camera)
    focal = 80 / np.tan(np.deg2rad(34.5))
    rows, columns = np.mgrid[0:120, 0:160]
    angle = np.arctan(np.hypot(rows - 59.5, columns - 79.5) / focal)
    assert share == pytest.approx(np.cos(angle) ** 4, abs=1e-5)
    assert np.all(vignette(pixel_rays(CAMERA), CAMERA) == 1.0)


@pytest.mark.parametrize("gain", [1.0, 8.0])
def test_the_variance_of_noise_is_gain_times_signal_and_that_of_reading(gain):
    camera = dataclasses.replace(CAMERA, gain=gain)
    renderer = renderer_of(small_reef(FLAT), camera)
    T_map_cam = pose(0.0, 0.0, -2.2, 0, 90)
    codes = np.stack([renderer.render(T_map_cam, noise(str(k))).colour for k in range(24)]) / 255.0
    linear = np.where(codes <= 0.04045, codes / 12.92, ((codes + 0.055) / 1.055) ** 2.4)
    signal = renderer.layers(T_map_cam, ["radiance"])["radiance"] * np.array(renderer.exposure.scale)
    slope = 1.055 / 2.4 * linear.mean(axis=0) ** (1 / 2.4 - 1)  # of the code over the signal, for its rounding
    variance = linear.var(axis=0, ddof=1) - (1 / 255 / slope) ** 2 / 12
    expected = gain * signal / FULL_WELL + (gain * READ_NOISE) ** 2
    assert variance.mean() == pytest.approx(expected.mean(), rel=0.06)


def test_exposure_is_in_stops():
    one, two = (
        renderer_of(small_reef(FLAT), dataclasses.replace(CAMERA, exposure_stops=stops)) for stops in (0.0, 1.0)
    )
    assert np.array(two.exposure.scale) == pytest.approx(2 * np.array(one.exposure.scale))


@pytest.mark.slow
def test_snow_grows_with_its_density_and_stays_where_it_is():
    def flakes(density, T_map_cam=PLACE, time_s=0.0):
        snow = renderer_of(small_reef(FLAT, water={"snow_per_m3": density}))._snow
        places, sizes = snow.flakes(T_map_cam, pixel_rays(CAMERA), time_s)
        return places @ T_map_cam[:3, :3].T + T_map_cam[:3, 3], sizes, snow

    few, _, _ = flakes(1000.0)
    many, sizes, snow = flakes(4000.0)
    assert len(many) / len(few) == pytest.approx(4.0, rel=0.1)
    tangent = np.abs(pixel_rays(CAMERA)[1:-1, 1:-1, :2]).max(axis=(0, 1))
    angles = np.array([(u, v) for u in np.linspace(-1, 1, 201) for v in np.linspace(-1, 1, 201)]) * tangent
    solid = np.mean((1 + (angles**2).sum(axis=1)) ** -1.5) * 4 * tangent.prod()
    inside = (many - PLACE[:3, 3]) @ PLACE[:3, :3]
    seen = np.all(np.abs(inside[:, :2]) < inside[:, 2:] * tangent, axis=1)
    assert seen.sum() == pytest.approx(4000.0 * solid * snow._reach**3 / 3, rel=0.05)
    assert (sizes > 0.0008).mean() == pytest.approx(0.25, abs=0.03), "numbers fall with the square of the diameter"
    moved, _, _ = flakes(4000.0, pose(0.05, 0.02, -2.2, 22, 41))
    shared = {tuple(p) for p in np.round(many, 6)} & {tuple(p) for p in np.round(moved, 6)}
    assert len(shared) > 0.8 * len(many)
    later, _, _ = flakes(4000.0, time_s=1.0)
    drift = np.round(later - snow._velocity, 6)
    assert len({tuple(p) for p in np.round(many, 6)} & {tuple(p) for p in drift}) > 0.8 * len(many)


def test_snow_is_drawn_and_lamps_light_it(full):
    layers = full.layers(PLACE, ["snow", "radiance"])
    assert layers["snow"].max() > 0.01
    assert (np.abs(layers["snow"]) > 1e-4).mean() < 0.3


def test_everything_on_gives_the_same_bytes_twice(full):
    first = full.render(PLACE, noise(), time_s=2.0)
    full.render(pose(0.4, 0.0, -2.0, 80, 50), noise("b"), time_s=7.0)
    again = renderer_of(small_reef(water=THICK, light=EVERYTHING), rig=LAMPS).render(PLACE, noise(), time_s=2.0)
    for field in dataclasses.fields(first):
        assert np.array_equal(getattr(first, field.name), getattr(again, field.name)), field.name


PRINT_DIGEST = """
import hashlib, sys
sys.path.insert(0, {folder!r})
import warp as wp
from oysterbench.render.camera import MODULES
for module in MODULES:
    wp.get_module(module.__name__).options["cpu_compiler_flags"] = {flags!r}
from tests.render.test_layers import EVERYTHING, LAMPS, PLACE, THICK, noise, renderer_of, small_reef
frame = renderer_of(small_reef(water=THICK, light=EVERYTHING), rig=LAMPS).render(PLACE, noise(), time_s=1.0)
from oysterbench.recipe.turbidity import LayerRecipe, PatchesRecipe
from tests.render.test_turbidity import silty
varied = {{**THICK, "layer": LayerRecipe(factor=2.0), "patches": PatchesRecipe(contrast=0.5)}}
silt = silty((0.6, 0.0, -2.6), light=EVERYTHING, rig=LAMPS, water=varied).render(PLACE, noise(), time_s=1.0)
parts = (frame.colour, frame.depth, frame.instances, silt.colour)
print(hashlib.sha256(b"".join(part.tobytes() for part in parts)).hexdigest())
"""


@pytest.mark.slow
@pytest.mark.skipif(platform.machine() != "x86_64", reason="the targets are those of x86-64")
def test_everything_on_gives_the_same_bytes_on_any_processor(tmp_path):
    def digest(flags, **environment):
        script = PRINT_DIGEST.format(folder=str(ROOT), flags=flags)
        environment = {**os.environ, "WARP_CACHE_PATH": str(tmp_path), **environment}
        run = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, env=environment)
        assert run.returncode == 0, run.stderr
        return run.stdout.split()[-1]

    plain = {
        "NPY_DISABLE_CPU_FEATURES": " ".join(name for name in __cpu_dispatch__ if __cpu_features__[name]),
        "OPENBLAS_CORETYPE": "Nehalem",
        "GLIBC_TUNABLES": "glibc.cpu.hwcaps=-AVX2,-AVX512F,-FMA",
    }
    assert digest("-march=native") == digest("-target-cpu x86-64", **plain)
