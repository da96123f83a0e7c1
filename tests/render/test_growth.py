"""What lies and grows on surfaces: loose silt, turf, specks, burrows, algae and litter, and soft shade over them."""

from __future__ import annotations

import dataclasses
import functools

import numpy as np
import pytest

from oysterbench.recipe import CLASSES
from oysterbench.render.camera import CameraRenderer
from tests.helpers.reefs import CAMERA, noise, pose, small_reef, world_of

DOWN = pose(0.0, 0.0, -2.4, 0, 90)
CLEAR = {"type": "pure", "jerlov": None}
DENSE = {"oysters": 2000, "patchiness": 0.0, "stones": 0, "relief_rms_m": 0.02}
NUMBERS = {name: number for number, name in CLASSES.items()}
OYSTER, PLANT, BOTTOM = NUMBERS["oyster"], NUMBERS["plant"], NUMBERS["bottom"]


CLOSE = dataclasses.replace(CAMERA, hfov_deg=10.0)


SHAPED_BY = ("infill_mm", "algae_per_m2", "litter_per_m2")


@functools.cache
def world_with(**shaped):
    return world_of(small_reef({**DENSE, **shaped}))


def frame_of(light=None, camera=CAMERA, **reef):
    """A frame over the reef with some keys; those that shape nothing take the world that is there."""
    world = world_with(**{key: value for key, value in reef.items() if key in SHAPED_BY})
    return CameraRenderer(world, camera, small_reef({**DENSE, **reef}, CLEAR, light)).render(DOWN, noise())


@pytest.fixture(scope="module")
def bare():
    return frame_of()


@pytest.fixture(scope="module")
def close():
    return frame_of(camera=CLOSE)


def roughness(frame, where):
    """Mean step of brightness between neighbours that are both of a kind of pixel."""
    level = frame.colour.astype(float).mean(axis=2)
    both = where[:, 1:] & where[:, :-1] & (frame.instances[:, 1:] == frame.instances[:, :-1])
    return np.abs(np.diff(level, axis=1))[both].mean()


@pytest.mark.parametrize("key", ["drape", "turf", "fouling", "grit", "burrows"])
def test_what_covers_thinly_changes_looks_and_no_truth(bare, close, key):
    fine = key in ("grit", "burrows")  # too fine for the wide view
    bare, covered = (close, frame_of(camera=CLOSE, **{key: 0.9})) if fine else (bare, frame_of(**{key: 0.9}))
    assert not np.array_equal(covered.colour, bare.colour)
    for name in ("depth", "classes", "instances"):
        assert np.array_equal(getattr(covered, name), getattr(bare, name)), "what lies thinly on an oyster is oyster"


def test_a_drape_smooths_shells_and_bottom_and_brings_them_to_one_colour(close):
    smooth = frame_of(camera=CLOSE, drape=1.0)
    for kind in (OYSTER, BOTTOM):
        assert (close.classes == kind).sum() > 500
        assert roughness(smooth, close.classes == kind) < 0.8 * roughness(close, close.classes == kind)

    def hues(frame):
        means = [frame.colour[frame.classes == kind].astype(float).mean(axis=0) for kind in (OYSTER, BOTTOM)]
        return [mean / mean.sum() for mean in means]

    def apart(frame):
        return np.abs(np.subtract(*hues(frame))).sum()

    assert apart(frame_of(drape=1.0, silt=0.0)) < 0.5 * apart(frame_of(silt=0.0))


def test_turf_makes_oysters_greener_and_leaves_the_bottom_as_it_is(bare):
    grown = frame_of(turf=0.9)

    def green(frame, kind):
        colour = frame.colour[bare.classes == kind].astype(float).mean(axis=0)
        return colour[1] / colour.mean()

    assert green(grown, OYSTER) > green(bare, OYSTER) + 0.005
    ground = (bare.classes == BOTTOM) & ~near(bare.classes == OYSTER)
    assert np.array_equal(grown.colour[ground], bare.colour[ground])


def near(mask):
    """Pixels of a mask and those around them, which share edges with it."""
    grown = mask.copy()
    for axis in (0, 1):
        for shift in (-1, 1):
            grown |= np.roll(mask, shift, axis)
    return grown | near_once(grown)


def near_once(mask):
    return np.roll(mask, 1, 0) | np.roll(mask, -1, 0) | np.roll(mask, 1, 1) | np.roll(mask, -1, 1)


def test_infill_hides_parts_of_oysters_and_shows_bottom_there(bare):
    filled = frame_of(infill_mm=25.0)
    assert (filled.classes == OYSTER).sum() < 0.85 * (bare.classes == OYSTER).sum()
    changed = filled.instances != bare.instances
    assert np.mean(filled.classes[changed] == BOTTOM) > 0.95


@pytest.mark.slow
def test_algae_and_litter_are_plants_and_hide_what_is_under_them(bare):
    grown = frame_of(algae_per_m2=200.0, litter_per_m2=60.0)
    changed = grown.classes != bare.classes
    assert 0.02 < changed.mean() < 0.6
    assert set(np.unique(grown.classes[changed])) == {PLANT}
    assert (bare.classes[changed] == OYSTER).sum() > 50
    kept = ~changed
    assert np.array_equal(grown.instances[kept], bare.instances[kept])


def test_soft_shade_takes_light_away_in_patches(bare):
    shaded = frame_of(light={"shade": 0.8, "shade_m": 0.15})
    ratio = shaded.colour.astype(float).mean(axis=2) / np.maximum(bare.colour.astype(float).mean(axis=2), 1.0)
    assert np.percentile(ratio, 5) < 0.75
    assert np.percentile(ratio, 95) > 0.9
    blocks = ratio[: CAMERA.height // 8 * 8].reshape(-1, 8, CAMERA.width // 8, 8)
    assert blocks.std(axis=(1, 3)).mean() < 0.5 * blocks.mean(axis=(1, 3)).std(), "smooth over many pixels"


@pytest.mark.slow
def test_the_same_reef_is_covered_the_same_again():
    keys = {"drape": 0.5, "turf": 0.5, "grit": 0.5, "burrows": 0.5, "infill_mm": 10.0, "algae_per_m2": 20.0}
    assert np.array_equal(frame_of(**keys).colour, frame_of(**keys).colour)
