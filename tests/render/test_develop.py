"""What a soft lens and a camera's own processing make of a picture."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
import warp as wp

from oysterbench.recipe import CameraRecipe
from oysterbench.render.develop import MIDDLE, Developer, Softness, processes
from oysterbench.render.target import start_warp
from tests.helpers.reefs import CAMERA, noise, pose, renderer_of, small_reef

SHAPE = (60, 80)
DOWN = pose(0.0, 0.0, -2.0, 0, 90)


def developed(picture, **keys):
    """A picture (H, W, 3) uint8 as a camera with these keys makes it."""
    start_warp()
    height, width = picture.shape[:2]
    camera = CameraRecipe(name="test", width=width, height=height, hfov_deg=60.0, rate_hz=1.0, **keys)
    colour = wp.array(picture, dtype=wp.uint8, device="cpu")
    Developer(camera, "cpu").develop(colour)
    return colour.numpy()


def step(low, high, spread=0.0):
    """Dark on the left, bright on the right, with noise."""
    picture = np.full((*SHAPE, 3), float(low))
    picture[:, SHAPE[1] // 2 :] = high
    grain = np.random.default_rng(1).normal(0, spread, (*SHAPE, 1)) if spread else 0.0
    return np.clip(np.round(picture + grain), 0, 255).astype(np.uint8)


@pytest.mark.parametrize("sigma_px", [0.8, 1.7, 3.0])
def test_a_point_is_spread_by_the_stated_deviation_and_keeps_its_light(sigma_px):
    start_warp()
    point = np.zeros((41, 41, 3), dtype=np.float32)
    point[20, 20] = 1.0
    out = wp.zeros((41, 41), dtype=wp.vec3, device="cpu")
    Softness((41, 41), sigma_px, "cpu").spread(wp.array(point, dtype=wp.vec3, device="cpu"), out)
    spread = out.numpy()[..., 1].astype(float)
    x = np.arange(41) - 20
    assert spread.sum() == pytest.approx(1.0, rel=1e-3)
    assert np.sqrt(spread.sum(axis=0) @ x**2) == pytest.approx(sigma_px, rel=0.04)


def test_a_picture_that_nothing_is_made_of_keeps_its_levels():
    assert not processes(CAMERA)
    picture = np.random.default_rng(0).integers(0, 256, (*SHAPE, 3)).astype(np.uint8)
    assert np.array_equal(developed(picture), picture)


def test_noise_reduction_takes_what_is_faint_and_leaves_edges():
    plain = developed(step(80, 160, spread=4.0), denoising=25.0)[..., 1].astype(float)
    left, right = plain[:, 4:36], plain[:, 44:76]
    assert max(left.std(), right.std()) < 0.45 * 4.0
    assert right.mean() - left.mean() == pytest.approx(80, abs=1)
    across = plain.mean(axis=0)
    assert across[40] - across[39] > 75, "the edge is as steep as it was"
    strong = developed(step(80, 160, spread=30.0), denoising=25.0)[..., 1].astype(float)
    assert strong[:, 4:36].std() > 0.6 * 30.0, "what is no noise stays"


def test_sharpening_leaves_a_dark_and_a_bright_seam():
    across = developed(step(90, 150), sharpening=1.0)[..., 0].astype(float).mean(axis=0)
    assert across[39] < 90 - 15
    assert across[40] > 150 + 15
    assert np.allclose(across[:30], 90)
    assert across.mean() == pytest.approx(120, abs=0.5)


def test_contrast_is_about_middle_grey_and_saturation_about_a_pixels_own():
    middle = float(MIDDLE)
    flat = np.full((*SHAPE, 3), (140, 120, 90), dtype=np.uint8)
    grey = float(np.dot([0.299, 0.587, 0.114], [140, 120, 90]))
    expected = middle + 1.5 * (grey - middle) + 1.5 * 1.2 * (np.array([140, 120, 90]) - grey)
    assert np.abs(developed(flat, contrast=1.5, saturation=1.2)[10, 10] - expected).max() <= 0.51
    assert np.ptp(developed(flat, saturation=0.0)[10, 10]) == 0


def test_processing_and_softness_touch_no_truth_and_no_layer():
    recipe = small_reef()
    keys = {"softness_px": 1.5, "denoising": 15.0, "sharpening": 1.0, "contrast": 1.3, "saturation": 1.4}
    plain, made = renderer_of(recipe), renderer_of(recipe, dataclasses.replace(CAMERA, **keys))
    one, two = plain.render(DOWN, noise()), made.render(DOWN, noise())
    assert not np.array_equal(one.colour, two.colour)
    for name in ("depth", "classes", "instances"):
        assert np.array_equal(getattr(one, name), getattr(two, name))
    layers = [renderer.layers(DOWN, ["radiance", "direct"]) for renderer in (plain, made)]
    assert all(np.array_equal(layers[0][name], layers[1][name]) for name in layers[0])
    assert np.array_equal(two.colour, made.render(DOWN, noise()).colour)
