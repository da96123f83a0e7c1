"""The Doppler log, held against the geometry of its beams."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from oysterbench.core.streams import Streams
from oysterbench.recipe import SiteRecipe
from oysterbench.sensors import acoustics, dvl
from oysterbench.sensors.dvl import DvlRecipe
from oysterbench.sensors.dvl_echoes import GRAZING_COSINE
from tests.helpers.acoustic_scenes import Steady, at, ball, caster_over

SITE = SiteRecipe()
QUIET = {"beam_noise_m_s": 0.0, "scale_error": 0.0, "range_noise_share": 0.0, "misalignment_deg": 0.0}
VELOCITY = (0.4, -0.2, 0.1)


def log(**changes) -> DvlRecipe:
    return DvlRecipe(**{**QUIET, **changes})


def listen(caster, path, recipe, count=4, site=SITE, bottom="sand", seed=1):
    times = np.arange(count) / recipe.rate_hz
    return dvl.measure(path, caster, recipe, site, times, np.arange(count) + 1, Streams(seed), bottom)[0]


def stacked(samples, name):
    return np.array([getattr(sample, name) for sample in samples])


@pytest.fixture(scope="module")
def level():
    return caster_over(19.0)


def test_without_errors_it_tells_the_velocity_of_where_it_sits(level):
    """v + w x r, turned into the log's frame; range along the beams of a tilted vehicle, altitude from them."""
    recipe = log(position_m=(0.3, 0.1, -0.2), yaw_deg=30.0)
    place = at(0, 0, -15.0, yaw_deg=50.0, pitch_deg=5.0)
    rate = (0.1, -0.2, 0.4)
    sample = listen(level, Steady(place, VELOCITY, rate), recipe)[0]
    at_log = place[:3, :3].T @ VELOCITY + np.cross(rate, recipe.position_m)
    expected = Rotation.from_euler("Z", 30.0, degrees=True).as_matrix().T @ at_log
    np.testing.assert_allclose(sample.velocity, expected, atol=1e-12)
    rotation = place[:3, :3] @ dvl.mount_rotation(recipe)
    height = 4.0 + (place[:3, :3] @ recipe.position_m)[2]
    slant = height / -(sample.beam_directions @ rotation.T)[:, 2]
    np.testing.assert_allclose(sample.beam_ranges, slant, rtol=3e-3)  # a beam hears its cone, the near side better
    np.testing.assert_allclose(sample.beam_velocities, sample.beam_directions @ expected, atol=1e-12)
    assert sample.altitude == pytest.approx(height / np.cos(np.radians(5.0)), rel=0.02)
    assert sample.beam_valid.all()
    assert sample.stamp_ns == 1


def test_noise_of_the_beams_is_1_85_times_as_large_across_and_0_54_times_along(level):
    sigma = 0.004
    samples = listen(level, Steady(at(0, 0, -15.0)), log(beam_noise_m_s=sigma), 6000)
    spread = stacked(samples, "velocity").std(axis=0) / sigma
    np.testing.assert_allclose(spread, [1.848, 1.848, 0.541], rtol=0.03)
    covariance = samples[0].covariance
    np.testing.assert_allclose(np.sqrt(np.diag(covariance)) / sigma, [1.85, 1.85, 0.54], atol=0.005)
    np.testing.assert_allclose(covariance, np.cov(stacked(samples, "velocity").T), atol=4e-6)
    assert samples[0].figure_of_merit == pytest.approx(np.sqrt(np.trace(covariance)))


@pytest.mark.parametrize(("altitude", "locked"), [(0.03, False), (0.06, True), (8.0, True), (9.0, True), (9.5, False)])
def test_lock_is_lost_below_the_least_and_past_the_greatest_range(level, altitude, locked):
    sample = listen(level, Steady(at(0, 0, altitude - 19.0)), log(max_range_m=10.0))[0]
    assert sample.beam_valid.tolist() == [locked] * 4
    assert np.isfinite(sample.velocity).all() == locked
    assert np.isnan(sample.altitude) != locked
    assert np.isnan(sample.beam_velocities).all() != locked
    assert np.isfinite(sample.figure_of_merit) == locked


def test_the_default_log_has_its_lock_at_a_few_centimetres(level):
    assert not listen(level, Steady(at(0, 0, -18.96)), log())[0].beam_valid.any()
    assert listen(level, Steady(at(0, 0, -18.9)), log())[0].beam_valid.all()


def test_three_beams_are_enough_and_two_are_not():
    """Rolled so far that the beams of one side are out of their reach."""
    caster = caster_over(19.0)
    place = at(0, 0, -16.0)
    place[:3, :3] = Rotation.from_euler("ZX", [45.0, 45.0], degrees=True).as_matrix()
    recipe = log(yaw_deg=45.0, max_range_m=7.0, beam_noise_m_s=0.002)  # one beam to each side
    sample = listen(caster, Steady(place, VELOCITY), recipe)[0]
    assert sample.beam_valid.sum() == 3
    turned = (place[:3, :3] @ dvl.mount_rotation(recipe)).T @ VELOCITY
    np.testing.assert_allclose(sample.velocity, turned, atol=0.05)
    assert np.isnan(sample.beam_ranges).sum() == 1
    assert sample.figure_of_merit > dvl_merit(recipe)
    two = listen(caster, Steady(place, VELOCITY), log(yaw_deg=0.0, max_range_m=6.0))[0]
    assert two.beam_valid.sum() == 2
    assert np.isnan(two.velocity).all()
    assert np.isnan(two.covariance).all()


def dvl_merit(recipe):
    """Figure of merit with all four beams."""
    off = np.radians(recipe.janus_deg)
    return recipe.beam_noise_m_s * np.sqrt(1 / np.sin(off) ** 2 + 1 / (4 * np.cos(off) ** 2))


def test_a_beam_that_grazes_a_slope_is_lost():
    def cliff(x, y):
        return -19.0 - 2.0 * np.maximum(x, 0.0)

    sample = listen(caster_over(0, heights=cliff), Steady(at(-0.2, 0, -15.0)), log())[0]
    cosines = np.abs(sample.beam_directions @ [2 / np.sqrt(5), 0, 1 / np.sqrt(5)])
    assert max(cosines[0], cosines[3]) < GRAZING_COSINE  # those ahead, over the slope
    assert sample.beam_valid.tolist() == [False, True, True, False]


def test_a_weak_bottom_is_lost_before_a_hard_one():
    caster = caster_over(19.0)
    tilted = Steady(at(0, 0, -10.9, pitch_deg=15.0))
    recipe = log(max_range_m=10.0)
    mud, shell = (listen(caster, tilted, recipe, bottom=kind)[0].beam_valid for kind in ("mud", "shell"))
    assert shell.all()
    assert mud.sum() == 2


def test_it_hears_what_lies_on_the_bottom():
    caster = caster_over(19.0, ball(0.0, 0.0, -19.0, 3.0))
    sample = listen(caster, Steady(at(0, 0, -14.0)), log())[0]
    assert sample.altitude == pytest.approx(2.2, abs=0.2)


def test_an_assumed_speed_of_sound_scales_velocity_and_range(level):
    warm = SiteRecipe(temperature_c=30.0, salinity_ppt=36.0)
    path = Steady(at(0, 0, -15.0), VELOCITY)
    right, wrong = (listen(level, path, log(assumed_sound_speed_m_s=c), site=warm)[0] for c in (None, 1450.0))
    ratio = 1450.0 / acoustics.sound_speed(warm, 15.0)
    np.testing.assert_allclose(wrong.velocity, right.velocity * ratio)
    np.testing.assert_allclose(wrong.beam_ranges, right.beam_ranges * ratio)


def test_errors_of_scale_and_mount_are_constant_and_of_their_size(level):
    path = Steady(at(0, 0, -15.0), (1.0, 0.0, 0.0))
    scales = []
    for seed in range(200):
        samples = listen(level, path, log(scale_error=0.01), 2, seed=seed)
        assert np.array_equal(samples[0].velocity, samples[1].velocity)
        scales.append(samples[0].velocity[0] - 1.0)
    assert np.std(scales) == pytest.approx(0.01, rel=0.15)
    twisted = [listen(level, path, log(misalignment_deg=1.0), 1, seed=k)[0].velocity for k in range(200)]
    assert np.std(twisted, axis=0)[1:] == pytest.approx(np.radians(1.0), rel=0.15)
    np.testing.assert_allclose(np.linalg.norm(twisted, axis=1), 1.0)


def test_ranges_are_as_noisy_as_asked(level):
    samples = listen(level, Steady(at(0, 0, -15.0)), log(range_noise_share=0.01), 2000)
    ranges = stacked(samples, "beam_ranges")
    assert ranges.std() / ranges.mean() == pytest.approx(0.01, rel=0.05)


def test_the_same_log_says_the_same():
    path, recipe = Steady(at(0, 0, -15.0), VELOCITY), DvlRecipe()
    one, again = (stacked(listen(caster_over(19.0), path, recipe, 50), "velocity") for _ in range(2))
    assert np.array_equal(one, again)
