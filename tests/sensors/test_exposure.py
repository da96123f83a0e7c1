"""The exposure loop: steps, limits, and what it does to frames."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from oysterbench.core.errors import RecipeError
from oysterbench.recipe import CameraRecipe, load_split, vary_split
from oysterbench.render.light import GREY_LEVEL
from oysterbench.sensors.camera import render_frame, shot, shown
from oysterbench.sensors.exposure import control, exposures, metered, sensitivity
from oysterbench.simulation.sensor_simulation import frames_csv
from oysterbench.simulation.simulated_sequence import build_sequence

CAMERA = CameraRecipe(
    name="cam", width=64, height=48, hfov_deg=69.0, rate_hz=20.0, auto_exposure=True, longest_exposure_ms=50.0
)
GREY = np.array([0.03, 0.03, 0.03])


def brightness(chosen, seen):
    """Linear mean of each frame."""
    return np.array([np.mean(np.array(chosen.of(k).scale) * now) for k, now in enumerate(seen)])


def step(stops: float, n: int = 200) -> np.ndarray:
    """Grey that changes by stops after a second."""
    return GREY * np.where(np.arange(n) < 20, 1.0, 2.0**stops)[:, None]


@pytest.mark.parametrize("settle_s", [0.3, 0.7, 2.0])
@pytest.mark.parametrize("stops", [1.0, -1.0])
def test_a_step_of_light_settles_to_five_percent_in_the_time_asked_for(settle_s, stops):
    camera = dataclasses.replace(CAMERA, exposure_settle_s=settle_s)
    seen = step(stops)
    off = np.abs(np.log2(brightness(control(camera, seen), seen) / GREY_LEVEL))
    assert off[:20].max() < 1e-3
    assert off[20] == pytest.approx(1.0, abs=1e-3), "the loop knows of a frame only after it"
    settled = (np.flatnonzero(off > 0.05 + 1e-3)[-1] + 1 - 20) / camera.rate_hz
    assert settled == pytest.approx(settle_s, abs=1.5 / camera.rate_hz)


def test_small_changes_move_nothing():
    seen = step(0.15)
    assert np.ptp(control(CAMERA, seen).shutter_s) == 0.0


def test_time_goes_first_then_gain_in_steps_then_nothing_is_left():
    seen = GREY * np.repeat(2.0 ** -np.arange(0.0, 16.0, 0.5), 100)[:, None]
    camera = dataclasses.replace(CAMERA, gain_step_db=3.0)
    chosen = control(camera, seen)
    assert chosen.shutter_s.max() == 0.050
    amplified = chosen.gain > 1.0
    assert np.all(chosen.shutter_s[amplified] == 0.050)
    steps = 20 * np.log10(np.unique(chosen.gain[chosen.gain < camera.highest_gain]))
    assert steps / 3.0 == pytest.approx(np.rint(steps / 3.0), abs=1e-4)
    assert chosen.gain.max() == camera.highest_gain
    assert brightness(chosen, seen)[-1] < 0.1 * GREY_LEVEL


def test_full_daylight_at_f_2_needs_the_time_of_the_sunny_16_rule():
    """f/16 and 1/ISO s in full sun are f/2 and 1/6400 s at ISO 100: a grey card of 18 % is then at 10 to 18 %."""
    assert 0.18 * sensitivity() / 6400 == pytest.approx(0.14, abs=0.08)


def test_white_balance_follows_slowly():
    camera = dataclasses.replace(CAMERA, auto_balance=True, balance_settle_s=3.0)
    seen = np.where(np.arange(200)[:, None] < 20, GREY, GREY * [0.4, 1.0, 0.8])
    balance = control(camera, seen).balance
    locked = control(CAMERA, seen).balance
    assert np.ptp(locked, axis=0).max() == 0.0
    ratio = np.log(balance[:, 0] / balance[:, 1])
    share = (ratio - ratio[0]) / (ratio[-1] - ratio[0])
    assert ratio[-1] > 0.1
    assert (np.flatnonzero(share < 0.95)[-1] - 20) / 20 == pytest.approx(3.0, abs=0.2)


@pytest.fixture(scope="module")
def dive():
    keys = {
        "camera.width": 160,
        "camera.height": 120,
        "camera.rate_hz": 5.0,
        "camera.layer_rate_hz": 0.0,
        "camera.auto_exposure": True,
        "camera.auto_balance": True,
        "camera.repeats": 0.2,
        "light.daylight": 0.02,
        "reef.oysters": 200,
    }
    split = vary_split(load_split("slam-mini"), keys, "test")
    return build_sequence(split, "mini-01", b"")


def test_the_meter_agrees_with_the_pictures(dive):
    camera = dive.rig.camera[0]
    seen = metered(dive, camera)
    renderer = dive.renderers[camera.name]
    for index in (0, 40, 95):
        taken = shot(dive, camera, index)
        whole = renderer.layers(taken.T_map_cam, ["radiance"], taken.time_s, taken.T_map_base)["radiance"]
        assert whole.mean(axis=(0, 1)) == pytest.approx(seen[index], rel=0.3)


def test_a_repeated_frame_is_the_picture_before_under_a_new_stamp(dive):
    camera = dive.rig.camera[0]
    pictures = shown(dive, camera)
    repeated = np.flatnonzero(pictures != np.arange(len(pictures)))
    assert len(repeated) / len(pictures) == pytest.approx(0.2, abs=0.1)
    assert np.all(pictures[pictures] == pictures)
    lines = frames_csv(dive).decode().splitlines()
    assert lines[0] == "camera,stamp_ns,shown_ns,exposure_ms,gain,red,green,blue"
    _, stamp, earlier, *rest = lines[1 + repeated[0]].split(",")
    assert int(stamp) > int(earlier)
    assert lines[1 + pictures[repeated[0]]].split(",")[2:] == [earlier, *rest]
    first, again = (render_frame(dive, camera, int(pictures[k])).colour for k in (pictures[repeated[0]], repeated[0]))
    assert np.array_equal(first, again)


def test_little_light_makes_long_exposures_that_blur_and_gain_that_is_noisy(dive):
    camera = dive.rig.camera[0]
    chosen = exposures(dive, camera)
    assert chosen.shutter_s.max() > 0.010
    assert shot(dive, camera, 10).passage.ends is not None


@pytest.mark.parametrize("keys", [{"shutter_ms": 5.0}, {"gain": 2.0}])
def test_what_the_loop_sets_is_not_set_beside_it(keys):
    with pytest.raises(RecipeError, match=r"key 'camera\.(shutter_ms|gain)'.*auto_exposure"):
        dataclasses.replace(CAMERA, **keys).check("rig.toml")
