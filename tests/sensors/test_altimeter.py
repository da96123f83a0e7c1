"""The altimeter: the first strong echo, its noise, its steps and its reach."""

from __future__ import annotations

import numpy as np
import pytest

from oysterbench.core.streams import Streams
from oysterbench.recipe import SiteRecipe
from oysterbench.sensors import acoustics, altimeter
from oysterbench.sensors.altimeter import AltimeterRecipe
from tests.helpers.acoustic_scenes import Steady, at, ball, caster_over

SITE = SiteRecipe()
STREAMS = Streams(6)
TIMES = np.arange(20) / 10.0


def sounder(**changes) -> AltimeterRecipe:
    quiet = {"noise_m": 0.0, "noise_share": 0.0, "step_m": 0.0}
    return AltimeterRecipe(**{"name": "altimeter", "rate_hz": 10.0, **quiet, **changes})


def sound(caster, place, recipe, times=TIMES, site=SITE):
    return altimeter.measure(Steady(place), caster, recipe, site, times, STREAMS)


@pytest.mark.parametrize("altitude", [0.5, 3.0, 17.0])
def test_a_level_bottom_is_found_at_its_altitude(altitude):
    ranges = sound(caster_over(19.0), at(0, 0, altitude - 19.0), sounder())
    np.testing.assert_allclose(ranges, altitude, rtol=1e-3)


def test_a_tilted_vehicle_still_finds_the_nearest_bottom_in_its_cone():
    straight_down = sound(caster_over(19.0), at(0, 0, -14.0, pitch_deg=6.0), sounder())
    np.testing.assert_allclose(straight_down, 5.0, rtol=0.01)
    steep = sound(caster_over(19.0), at(0, 0, -14.0, pitch_deg=50.0), sounder(beam_deg=4.0))
    assert np.all(steep > 5.0 / np.cos(np.radians(47.0)))


def test_the_top_of_a_boulder_is_found_before_the_bottom_but_a_small_thing_is_not():
    boulder = sound(caster_over(19.0, ball(0, 0, -19.0, 1.2)), at(0, 0, -15.0), sounder())
    np.testing.assert_allclose(boulder, 2.8, atol=0.02)
    pebble = sound(caster_over(19.0, ball(0, 0, -18.5, 0.03)), at(0, 0, -15.0), sounder())
    np.testing.assert_allclose(pebble, 4.0, atol=0.02)


def test_noise_has_both_parts_and_readings_their_step():
    times = np.arange(3000) / 10.0
    recipe = sounder(noise_m=0.02, noise_share=0.01, step_m=0.005)
    ranges = sound(caster_over(19.0), at(0, 0, -15.0), recipe, times)
    assert ranges.std() == pytest.approx(np.hypot(0.02, 0.01 * 4.0), rel=0.05)
    assert ranges.mean() == pytest.approx(4.0, abs=0.005)
    np.testing.assert_allclose(ranges / 0.005, np.rint(ranges / 0.005), atol=1e-6)


@pytest.mark.parametrize(("altitude", "answers"), [(0.25, False), (0.35, True), (7.9, True), (8.2, False)])
def test_nothing_answers_outside_its_reach(altitude, answers):
    ranges = sound(caster_over(19.0), at(0, 0, altitude - 19.0), sounder(max_range_m=8.0, step_m=0.001))
    assert np.all(np.isfinite(ranges)) == answers
    assert np.all(np.isinf(ranges)) != answers


def test_a_bottom_that_sends_too_little_back_is_not_heard():
    """Mud from near its greatest range at 30 degrees; a bottom of shell answers."""
    recipe, slanted = sounder(max_range_m=8.0, beam_deg=4.0), Steady(at(0, 0, -12.25, pitch_deg=30.0))
    caster = caster_over(19.0)
    mud, shell = (altimeter.measure(slanted, caster, recipe, SITE, TIMES, STREAMS, kind) for kind in ("mud", "shell"))
    assert np.all(np.isinf(mud))
    assert np.all((shell > 7.4) & (shell < 7.9))


def test_another_speed_of_sound_than_the_true_one_scales_the_range():
    warm = SiteRecipe(temperature_c=30.0, salinity_ppt=36.0)
    ranges = sound(caster_over(19.0), at(0, 0, -15.0), sounder(assumed_sound_speed_m_s=1450.0), site=warm)
    np.testing.assert_allclose(ranges, 4.0 * 1450.0 / acoustics.sound_speed(warm, 15.0), rtol=1e-3)


def test_the_lever_arm_counts():
    ranges = sound(caster_over(19.0), at(0, 0, -15.0), sounder(position_m=(0.3, 0.0, -0.5)))
    np.testing.assert_allclose(ranges, 3.5, rtol=1e-3)
