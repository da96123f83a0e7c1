"""The imaging sonar, held against its own physics in worlds that can be computed by hand."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from oysterbench.core.streams import Streams
from oysterbench.recipe import CLASSES, SiteRecipe
from oysterbench.sensors import acoustics, echoes, sonar
from oysterbench.sensors.sonar import ImagingSonar, SonarRecipe
from tests.helpers.acoustic_scenes import at, ball, caster_over, wall

SITE = SiteRecipe()
FRESH, SALT = SiteRecipe(temperature_c=8.0, salinity_ppt=0.0), SiteRecipe(temperature_c=28.0, salinity_ppt=36.0)
SILENT = {"noise_db": -200.0, "tvg": False}
STREAMS = Streams(5)
DEEP = 19.0


def fan(**changes) -> SonarRecipe:
    values = {"name": "fls", "rate_hz": 10.0, "hfov_deg": 60.0, "beams": 64, "bins": 400, **changes}
    return SonarRecipe(**values)


def expected(caster, place, site=SITE, **changes):
    """Power (beams, bins) on average, and the sonar."""
    heard = ImagingSonar(caster, fan(**changes), site)
    return heard.listen(place, STREAMS).power, heard


@pytest.mark.parametrize("looks", [0.7, 1.0, 4.0])
def test_speckle_has_the_gamma_distribution_of_its_looks(looks):
    recipe = fan(looks=looks, bins=1000, **SILENT)
    power = np.full((64, 1000), 1e-2)
    counts = echoes.record(power, recipe, 0.0, STREAMS.generator("speckle"))
    intensity = (counts.ravel() * echoes.amplitude_step(recipe)) ** 2 / 1e-2
    assert stats.kstest(intensity, stats.gamma(looks, scale=1 / looks).cdf).pvalue > 0.01
    assert intensity.mean() == pytest.approx(1.0, abs=0.02)


def test_the_speckle_of_a_bottom_is_rayleigh_in_amplitude():
    heard = ImagingSonar(caster_over(3.0), fan(noise_db=-200.0, pitch_deg=30.0), SITE)
    place = at(0, 0, -1.0)
    image, _ = heard.ping(place, STREAMS, 0)
    mean = heard.listen(place, STREAMS.at("sonar", "fls", 0)).power.T
    gain = echoes.time_varying_gain(heard.recipe, acoustics.absorption(SITE, 1.0, 750.0))[:, None]
    counts = np.sqrt(mean) * gain / heard.amplitude_step
    clear = counts > 30
    assert clear.sum() > 3000
    between = STREAMS.generator("dither").uniform(-0.5, 0.5, clear.sum())  # of the counts that readings are rounded to
    amplitude = np.abs(image.pixels[clear] + between) / counts[clear]
    assert stats.kstest(amplitude, stats.rayleigh(scale=np.sqrt(0.5)).cdf).pvalue > 0.01


def test_the_noise_floor_is_rayleigh_and_adds_to_the_power():
    recipe = fan(noise_db=-60.0, tvg=False, bins=1000)
    noise = echoes.record(np.zeros((64, 1000)), recipe, 0.0, STREAMS.generator("n")) * echoes.amplitude_step(recipe)
    assert np.mean(noise**2) == pytest.approx(1e-6, rel=0.02)
    fine = noise.ravel() + STREAMS.generator("dither").uniform(-0.5, 0.5, noise.size) * echoes.amplitude_step(recipe)
    assert stats.kstest(np.abs(fine), stats.rayleigh(scale=np.sqrt(0.5e-6)).cdf).pvalue > 0.01
    both = echoes.record(np.full((64, 1000), 3e-6), recipe, 0.0, STREAMS.generator("n")) * echoes.amplitude_step(recipe)
    assert np.mean(both**2) == pytest.approx(4e-6, rel=0.02)


@pytest.mark.parametrize("site", [FRESH, SALT])
@pytest.mark.parametrize("assumed", [None, 1500.0])
def test_a_wall_is_found_at_its_range_by_the_clock_of_the_assumed_speed(site, assumed):
    """Within half a bin; a sonar that assumes another speed of sound is wrong by their ratio."""
    heard = ImagingSonar(caster_over(DEEP, wall(4.0)), fan(assumed_sound_speed_m_s=assumed, vfov_deg=4.0), site)
    images = [heard.ping(at(0, 0, -9.0), STREAMS, k)[0].pixels for k in range(20)]
    energy = np.mean(np.square(images, dtype=float), axis=0)
    middle = [31, 32]
    peak = heard.ranges[energy[:, middle].mean(axis=1).argmax()]
    ratio = 1.0 if assumed is None else assumed / acoustics.sound_speed(site, 9.0)
    believed = 4.0 * ratio / np.cos(heard.azimuths[31])
    half_bin = (heard.ranges[1] - heard.ranges[0]) / 2
    assert abs(peak - believed) <= half_bin + 1e-9
    if assumed is not None:
        assert abs(4.0 * ratio - 4.0) > 2 * half_bin  # so that the test would notice


def test_a_wall_that_fills_the_beam_falls_with_the_square_of_the_range():
    powers = {}
    for x in (2.0, 4.0, 8.0):
        power, heard = expected(caster_over(DEEP, wall(x)), at(0, 0, -9.0), vfov_deg=4.0)
        powers[x] = power[32].sum()
    loss = acoustics.absorption(SITE, 9.0, 750.0)
    mu = acoustics.backscatter("sand")[3]
    for x, power in powers.items():
        assert power == pytest.approx(mu * x**-2 * 10 ** (-0.2 * loss * x), rel=0.02)
    assert heard.azimuths[0] > 0 > heard.azimuths[-1]


def test_a_small_ball_falls_with_the_fourth_power_of_the_range():
    """And has the echo of a Lambertian ball: the integral of mu cos^2 over its near half is 2 pi / 3 mu R^2."""
    loss, mu = acoustics.absorption(SITE, 9.0, 750.0), acoustics.backscatter("sand")[3]
    width = np.radians(6.0)
    off = np.linspace(-sonar.PATTERN_REACH, sonar.PATTERN_REACH, 4001) * width
    across = np.trapezoid(acoustics.beam_pattern(off, width), off)
    fill = across * acoustics.aperture(np.radians(20.0))
    for x in (3.0, 6.0):
        caster = caster_over(DEEP, ball(x, 0, -9.0, 0.05))
        heard = ImagingSonar(caster, fan(beams=129, beam_deg=6.0, vfov_deg=20.0), SITE)
        pings = [heard.listen(at(0, 0, -9.0), STREAMS.at(k)).power[64].sum() for k in range(5)]
        echo = 2 * np.pi / 3 * mu * 0.05**2 * (x - 0.03) ** -4 * 10 ** (-0.2 * loss * x) / fill
        assert np.mean(pings) == pytest.approx(echo, rel=0.06)


def test_a_beam_hears_a_ball_with_its_pattern_and_neighbours_hear_it_weaker():
    caster = caster_over(DEEP, ball(6.0, 0, -9.0, 0.04))
    heard = ImagingSonar(caster, fan(beam_deg=3.0, beams=128, vfov_deg=10.0), SITE)
    power = np.mean([heard.listen(at(0, 0, -9.0), STREAMS.at(k)).power.sum(axis=1) for k in range(4)], axis=0)
    pattern = acoustics.beam_pattern(heard.azimuths, np.radians(3.0))
    near = np.abs(heard.azimuths) < np.radians(4.5)
    np.testing.assert_allclose(power[near] / power.max(), pattern[near] / pattern.max(), atol=0.03)
    assert pattern[near].min() < 0.01 < 0.9 < pattern[near].max()


def test_a_beam_hears_high_and_low_with_its_vertical_pattern_and_nothing_past_its_null():
    heard = {}
    for elevation in (0.0, 6.0, 10.0, -10.0, 26.0):
        caster = caster_over(DEEP, ball(6.0 * np.cos(np.radians(elevation)), 0, -9.0, 0.06))
        place = at(0, 0, -9.0 - 6.0 * np.sin(np.radians(elevation)))
        sonars = ImagingSonar(caster, fan(beams=65, vfov_deg=20.0, beam_deg=4.0), SITE)
        heard[elevation] = np.mean([sonars.listen(place, STREAMS.at(k)).power[32].sum() for k in range(8)])
    for elevation in (6.0, 10.0, -10.0):
        pattern = acoustics.beam_pattern(np.radians(elevation), np.radians(20.0))
        assert heard[elevation] / heard[0.0] == pytest.approx(pattern, abs=0.05)
    assert heard[26.0] == 0


def bottom_power(heard, height, loss):
    """Power per bin of a level bottom `height` m below a level sonar: a strip dA = r dr dphi at the range r."""
    recipe = heard.recipe
    r = heard.ranges
    sine = height / np.maximum(r, height)
    step = r[1] - r[0]
    mu = acoustics.backscatter("sand")[1]
    vertical = acoustics.beam_pattern(np.arcsin(sine), np.radians(recipe.vfov_deg))
    across = acoustics.aperture(np.radians(recipe.beam_deg))  # the main lobe's, of which the sidelobes add a little
    fill = across * acoustics.aperture(np.radians(recipe.vfov_deg))
    return mu * sine**2 * r**-4 * 10 ** (-0.2 * loss * r) * vertical * r * step * across / fill


def test_a_level_bottom_at_grazing_incidence_has_no_gaps_and_the_power_of_its_area():
    power, heard = expected(caster_over(2.0), at(0, 0, -1.0), vfov_deg=30.0, max_range_m=12.0)
    law = bottom_power(heard, 1.0, acoustics.absorption(SITE, 1.0, 750.0))
    from_here = (heard.ranges > 2.5) & (heard.ranges < 11.5)
    middle = power[20:44][:, from_here] / law[from_here]
    assert middle.min() > 0.95
    assert middle.max() < 1.05
    assert middle.mean() == pytest.approx(1.0, abs=0.01)


@pytest.mark.parametrize(("beams", "per_beam", "per_column"), [(16, 6, 1), (60, 2, 1), (200, 1, 1), (1000, 1, 2)])
def test_beams_near_or_far_apart_hear_the_same_wall(beams, per_beam, per_column):
    recipe = fan(beams=beams, vfov_deg=4.0)
    columns = sonar.build_columns(recipe)
    assert (columns.per_beam, columns.per_column) == (per_beam, per_column)
    heard = ImagingSonar(caster_over(DEEP, wall(4.0)), recipe, SITE)
    power = heard.listen(at(0, 0, -9.0), STREAMS).power.sum(axis=1)
    r = 4.0 / np.cos(heard.azimuths)
    loss, mu = acoustics.absorption(SITE, 9.0, 750.0), acoustics.backscatter("sand")[3]
    law = mu * np.cos(heard.azimuths) * r**-2 * 10 ** (-0.2 * loss * r)
    np.testing.assert_allclose(power, law, rtol=0.03)


def test_the_number_of_rays_does_not_change_the_power(monkeypatch):
    caster = caster_over(2.0, ball(4.0, 0.3, -1.7, 0.3))
    sparse, _ = expected(caster, at(0, 0, -1.0), pitch_deg=15.0)
    monkeypatch.setattr(sonar, "ROWS", 700)
    monkeypatch.setattr(sonar, "COLUMNS_PER_WIDTH", 4.0)
    dense, _ = expected(caster, at(0, 0, -1.0), pitch_deg=15.0)
    assert sparse.sum() == pytest.approx(dense.sum(), rel=0.02)


def test_a_ball_casts_a_shadow_as_long_as_its_tangent_ray_says():
    """The ray that just passes over a ball of radius R at the distance d meets the bottom where the shadow ends."""
    height, distance, radius = 1.5, 3.0, 0.25
    caster = caster_over(2.0, ball(distance, 0, -2.0 + radius, radius))
    heard = ImagingSonar(caster, fan(pitch_deg=20.0, max_range_m=6.0, beam_deg=0.5, hfov_deg=30.0), SITE)
    here = at(0, 0, -2.0 + height)
    power = np.mean([heard.listen(here, STREAMS.at(k)).power for k in range(4)], axis=0)
    clear = np.mean([ImagingSonar(caster_over(2.0), heard.recipe, SITE).listen(here, STREAMS).power], axis=0)
    share = np.ones_like(clear[0])
    seen = clear[31] > 0.01 * clear[31].max()
    share[seen] = power[31:33, seen].sum(axis=0) / clear[31:33, seen].sum(axis=0)
    down = np.arctan2(height - radius, distance)
    tangent = down - np.arcsin(radius / np.hypot(distance, height - radius))
    end = height / np.sin(tangent)
    behind = (heard.ranges > np.hypot(distance, height - radius)) & (heard.ranges < end + 0.5)
    dark = heard.ranges[behind & (share < 0.5)]
    start_of_shadow = height / np.sin(down + np.arcsin(radius / np.hypot(distance, height - radius)))
    assert dark.max() == pytest.approx(end, abs=0.06)
    assert share[(heard.ranges > start_of_shadow + 0.2) & (heard.ranges < end - 0.1)].max() < 0.1
    assert share[(heard.ranges > end + 0.1) & (heard.ranges < end + 0.5)].min() > 0.7


def test_gain_undoes_spreading_and_absorption():
    recipe = fan()
    gain = echoes.time_varying_gain(recipe, 0.2)
    r = ImagingSonar(caster_over(3.0), recipe, SITE).ranges
    np.testing.assert_allclose(gain**2 * r**-4 * 10 ** (-2 * 0.2 * r / 10), 1.0)
    assert np.all(echoes.time_varying_gain(fan(tvg=False), 0.2) == 1.0)


def test_a_pulse_of_less_bandwidth_resolves_less():
    axis = echoes.RangeAxis(0.0, 0.01, 100, 1.0)
    power = np.zeros((1, 100))
    power[0, 50] = 1.0
    resolution = 0.1  # ten bins
    spread = echoes.resolve(power, axis, 1500.0, 1500.0 / (2e3 * resolution))[0]
    r = 0.01 * np.arange(100) - 0.5
    law = np.sinc(r / resolution) ** 2
    near = np.abs(r) < 0.25
    np.testing.assert_allclose(spread[near] / spread.max(), law[near], atol=0.01)
    assert spread.sum() == pytest.approx(1.0)
    sharp = echoes.resolve(power, axis, 1500.0, 1000.0)[0]
    assert sharp[50] > 0.9


def test_one_more_bounce_comes_later_and_weaker():
    distance, up = 5.0, 1.0
    caster = caster_over(6.0, ball(distance, 0, -6.0 + up, 0.2))
    here = at(0, 0, -6.0 + up)
    single, heard = expected(caster, here, vfov_deg=60.0, max_range_m=8.0)
    double, _ = expected(caster, here, vfov_deg=60.0, max_range_m=8.0, multipath=0.5)
    added = (double - single)[30:34].sum(axis=0)
    direct = distance - 0.2
    late = (direct + np.hypot(distance, 2 * up)) / 2
    near = (heard.ranges > direct + 0.05) & (heard.ranges < late + 0.4)
    assert heard.ranges[near][added[near].argmax()] == pytest.approx(late, abs=0.12)
    echo = single[30:34, np.abs(heard.ranges - direct) < 0.15].sum()
    assert 0.0 < added[near].sum() < 0.5 * echo
    assert np.all(double >= single - 1e-18)


def test_the_cloud_says_what_each_return_is():
    thing = ball(3.0, 0.5, -2.0, 0.3, "oyster")
    caster = caster_over(3.0, thing)
    place = at(1.0, 0.0, -1.8, yaw_deg=10.0)
    _, cloud = ImagingSonar(caster, fan(cloud=True, pitch_deg=20.0), SITE).ping(place, STREAMS, 0)
    assert len(cloud.points) == len(cloud.intensity) == len(cloud.classes) == len(cloud.instances) > 300
    points = (
        place
        @ acoustics.mount_pose(fan(pitch_deg=20.0))
        @ np.column_stack([cloud.points, np.ones(len(cloud.points))]).T
    ).T
    shell = cloud.instances == 1
    assert shell.sum() > 20
    assert {CLASSES[k] for k in cloud.classes[shell]} == {"oyster"}
    assert {CLASSES[k] for k in cloud.classes[~shell]} == {"bottom"}
    np.testing.assert_allclose(np.linalg.norm(points[shell, :3] - [3.0, 0.5, -2.0], axis=1), 0.3, atol=0.013)
    np.testing.assert_allclose(points[~shell, 2], -3.0, atol=0.013)  # half a bin
    assert cloud.intensity.dtype == np.float32
    assert np.all((cloud.intensity > -105) & (cloud.intensity < 0))


def test_nothing_is_heard_in_open_water():
    power, _ = expected(caster_over(DEEP), at(0, 0, -2.0), vfov_deg=5.0, multipath=1.0)
    assert power.max() == 0


def test_a_ping_is_the_same_each_time_and_another_is_not():
    heard = ImagingSonar(caster_over(3.0), fan(pitch_deg=20.0), SITE)
    first, again, other = (heard.ping(at(0, 0, -1.0), STREAMS, k)[0].pixels for k in (3, 3, 4))
    assert first.shape == (400, 64)
    assert first.dtype == np.uint16
    assert np.array_equal(first, again)
    assert not np.array_equal(first, other)
