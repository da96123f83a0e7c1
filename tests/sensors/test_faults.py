"""Sensors with faults, each against its own physics and against what its recipe asks for."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from scipy.stats import binomtest

from oysterbench.core.errors import RecipeError
from oysterbench.core.streams import Streams
from oysterbench.recipe import SiteRecipe, load_split
from oysterbench.scene.path import build_path
from oysterbench.scene.path.thrust import BOLLARD_N, HEAVE_QUADRATIC, TRIM_N, Throttle, throttle
from oysterbench.scene.waves import Waves, dispersion
from oysterbench.sensors import acoustics, dvl, echoes, pressure
from oysterbench.sensors.dvl import DvlRecipe
from oysterbench.sensors.dvl_faults import arrivals, ping_times, strike
from oysterbench.sensors.faults import Fault, fault_csv, spans
from oysterbench.sensors.imu import ImuRecipe, read_out, warmed
from oysterbench.sensors.interference import Beams, added_power, line_power, pulse
from oysterbench.sensors.iron import Dipoles, build_iron, deviation, motor_field
from oysterbench.sensors.magnetometer import earth_field
from oysterbench.sensors.pressure import PressureRecipe
from oysterbench.sensors.sonar import ImagingSonar, SonarRecipe
from oysterbench.sensors.vibration import VibrationRecipe, vibrate
from tests.helpers.acoustic_scenes import Steady, at, ball, caster_over

SITE = SiteRecipe()
SLAM = load_split("slam-mini").sequence[0]


# Thrusters: what vibration and compass follow.


def test_a_steady_way_takes_the_throttle_that_drag_and_trim_ask_for():
    path = Steady(at(0, 0, -2.0), (0.4, 0.0, -0.2))
    opened = throttle(path, dataclasses.replace(SLAM, duration_s=10.0), Streams(1)).at(np.linspace(5, 10, 20))
    ahead = (4.03 + 18.18 * 0.4) * 0.4 / BOLLARD_N[0]
    down = (-(5.18 + HEAVE_QUADRATIC * 0.2) * 0.2 - TRIM_N) / BOLLARD_N[2]
    assert opened == pytest.approx(np.hypot(ahead, down) ** 0.5, rel=1e-6)


def test_a_vehicle_that_drifts_with_the_current_only_holds_its_depth():
    site = SiteRecipe(current_m_s=0.3)
    recipe = dataclasses.replace(SLAM, duration_s=30.0, site=site)
    adrift = throttle(Steady(at(0, 0, -2.0), (0.3, 0.0, 0.0)), recipe, Streams(1)).shares.mean()
    holding = throttle(Steady(at(0, 0, -2.0)), recipe, Streams(1)).shares.mean()
    assert (TRIM_N / BOLLARD_N[2]) ** 0.5 <= adrift < holding < 0.3


# Inertial unit.


def unit(**changes):
    quiet = dict.fromkeys(("gyro_noise_density", "accel_noise_density", "gyro_random_walk", "accel_random_walk"), 0.0)
    return ImuRecipe(**{"rate_hz": 100.0, **quiet, **changes})


def test_a_warming_unit_drifts_as_one_minus_the_exponential():
    recipe = unit(gyro_bias_per_k=2e-4, warming_k=20.0, warming_tau_s=120.0, warmed_s=60.0)
    times = np.arange(30_000) / 100.0
    drift = read_out(np.zeros((30_000, 3)), recipe, "gyro", Streams(3).at("imu"))
    closed = 20.0 * (np.exp(-60 / 120) - np.exp(-(times + 60) / 120))
    assert warmed(recipe, times) == pytest.approx(closed, abs=1e-12)
    assert drift / drift[-1] == pytest.approx(np.tile(closed / closed[-1], (3, 1)).T, abs=1e-9)
    assert not drift[0].any()  # the turn-on bias is that of the start
    per_k = [drift_per_k(seed, recipe) for seed in range(300)]
    assert np.std(per_k) == pytest.approx(2e-4, rel=0.1)


def drift_per_k(seed, recipe):
    found = read_out(np.zeros((100, 3)), recipe, "gyro", Streams(seed).at("imu"))
    return found[-1] / warmed(recipe, np.array([0.99]))


def test_the_thrusters_tone_is_at_their_rate_and_grows_with_its_square():
    recipe = VibrationRecipe(on="accel", kind="thrusters", level=(1.0, 0.0, 0.5), frequency_hz=58.0)
    times = np.array([0.0, 100.0])
    for share in (0.25, 0.5, 1.0):
        shaken = vibrate(8000, 400.0, recipe, Streams(1), Throttle(times, np.full(2, share)))
        lines = np.abs(np.fft.rfft(shaken, axis=0)) * 2 / len(shaken)
        at_line = round(58.0 * share * len(shaken) / 400.0)
        assert lines[at_line] == pytest.approx([share**2, 0.0, 0.5 * share**2], abs=1e-9)
    rising = Throttle(times, np.array([0.0, 1.0]))
    assert rising.turns(np.array([100.0])) == pytest.approx(50.0)
    assert not vibrate(10, 400.0, recipe, Streams(1)).any()  # nothing turns


# Doppler log.


def log(**changes):
    quiet = {"beam_noise_m_s": 0.0, "scale_error": 0.0, "range_noise_share": 0.0, "misalignment_deg": 0.0}
    return DvlRecipe(**{**quiet, **changes})


def test_pings_fail_as_often_as_asked_and_more_where_there_is_risk():
    risky = np.arange(40_000) % 4 == 0
    recipe = log(invalid=0.02, invalid_risky=0.2, outliers=0.01, outliers_risky=0.1, outlier_m_s=0.4)
    found = strike(recipe, risky, Streams(1).at("dvl"))
    for struck, elsewhere, there in ((found.invalid, 0.02, 0.2), (found.outliers != 0, 0.01 * 0.98, 0.1 * 0.8)):
        for mask, share in ((~risky, elsewhere), (risky, there)):
            assert binomtest(int(struck[mask].sum()), int(mask.sum()), share).pvalue > 0.001
    assert found.outliers[found.outliers != 0].std() == pytest.approx(0.4, rel=0.1)
    assert not strike(log(), risky, Streams(1)).invalid.any()
    assert strike(log(invalid=0.3), risky, Streams(1)).invalid[risky].mean() == pytest.approx(0.3, abs=0.02)


@pytest.fixture(scope="module")
def level():
    return caster_over(19.0)


def pings(caster, recipe, height=2.0, n=2000, seed=1):
    times = np.arange(n) / recipe.rate_hz
    path = Steady(at(0, 0, height - 19.0))
    return dvl.measure(path, caster, recipe, SITE, times, np.arange(n), Streams(seed), "sand", 1.0)


def test_a_ping_that_failed_says_so_and_an_outlier_does_not(level):
    measured, struck = pings(level, log(invalid=0.05, outliers=0.05, outlier_m_s=0.5))
    assert binomtest(int(struck.invalid.sum()), 2000, 0.05).pvalue > 0.001
    for sample, lost, wrong in zip(measured, struck.invalid, struck.outliers, strict=True):
        assert sample.beam_valid.any() != lost
        assert np.isnan(sample.velocity).all() == lost
        if wrong:
            assert sample.beam_valid.all()
            error = np.abs(sample.beam_velocities)
            assert error.max() == pytest.approx(abs(wrong))
            assert np.sort(error)[2] < 1e-12  # one beam
        elif not lost:
            np.testing.assert_allclose(sample.velocity, 0.0, atol=1e-12)


def test_pings_are_at_risk_when_low_and_over_plants(level):
    recipe = log(invalid_risky=0.5, low_m=0.3)
    _, high = pings(level, recipe, height=0.5, n=50)
    _, low = pings(level, recipe, height=0.25, n=50)
    assert not high.risky.any()
    assert low.risky.all()
    meadow = caster_over(19.0, ball(0, 0, -19.0, 1.0, "plant"))
    _, over = pings(meadow, recipe, height=2.5, n=50)
    assert over.risky.all()
    _, stone = pings(caster_over(19.0, ball(0, 0, -19.0, 1.0)), recipe, height=2.5, n=50)
    assert not stone.risky.any()


def test_the_rate_falls_with_altitude_from_15_to_2_hz():
    recipe = log(rate_hz=15.0, min_rate_hz=2.0, max_range_m=50.0)
    for height, period in ((0.0, 1 / 15), (25.0, (1 / 15 + 1 / 2) / 2), (50.0, 0.5), (80.0, 0.5)):
        times = ping_times(recipe, 60.0, lambda time, height=height: height)
        assert np.diff(times) == pytest.approx(period, abs=2e-6)
        assert 60.0 - period <= times[-1] < 60.0


def test_messages_arrive_late_by_the_latency_and_in_order():
    stamps = np.arange(5000, dtype=np.int64) * 66_666_667
    late = (arrivals(log(latency_ms=120.0), stamps, Streams(1)) - stamps) * 1e-6
    assert late.mean() == pytest.approx(120.0, rel=0.05)
    assert late.min() >= 60.0
    assert (np.diff(arrivals(log(latency_ms=200.0), stamps, Streams(1))) > 0).all()
    assert arrivals(log(), stamps, Streams(1)) is stamps


@pytest.mark.parametrize(
    ("keys", "named"),
    [({"min_rate_hz": 20.0}, "min_rate_hz"), ({"invalid": 0.1, "invalid_risky": 0.05}, "invalid_risky")],
)
def test_logs_that_cannot_be_are_refused(keys, named):
    with pytest.raises(RecipeError, match=rf"rig: key 'dvl.{named}': expected at .* got"):
        log(**keys).check("rig")


# Compass.


def test_the_motors_turn_the_heading_in_proportion_to_the_throttle_and_by_no_more_than_asked():
    earth = earth_field(SITE)
    shares = np.linspace(0, 1, 11)
    turned = []
    for yaw in range(0, 360, 2):
        motion = Steady(at(0, 0, -2.0, yaw_deg=yaw)).at(np.zeros(11))
        turned.append(np.degrees(deviation(earth, motor_field(earth, 15.0, shares, motion, Streams(1)))))
    most = np.abs(turned).max(axis=0)
    assert most[-1] == pytest.approx(15.0, abs=0.01)
    assert np.sin(np.radians(most)) == pytest.approx(np.sin(np.radians(15.0)) * shares, abs=1e-3)
    assert most[0] == 0.0


def test_iron_bends_as_a_dipole_with_the_cube_of_the_distance():
    iron = Dipoles(np.zeros((1, 3)), np.array([[0.0, 0.0, 10.0]]))
    above, beside = iron.field(np.array([[0, 0, 1.0], [1.0, 0, 0]]))
    assert above == pytest.approx([0, 0, 2e-6])  # mu0 m / 2 pi d^3
    assert beside == pytest.approx([0, 0, -1e-6])
    far = iron.field(np.array([[0, 0, 2.0]]))[0]
    assert far == pytest.approx(above / 8)
    steel = Dipoles(np.zeros((1, 3)), np.array([[0.0, 20.0, 0.0]]))
    turned = np.degrees(deviation(earth_field(SITE), steel.field(np.array([[0.7, 0.7, 0.3]]))))
    assert 2.0 < abs(turned[0]) < 30.0  # a piece of 20 to 200 kg, a metre away


def test_iron_lies_on_the_bottom_where_the_seed_puts_it():
    site = SiteRecipe(iron=400, iron_am2=5.0)
    found = build_iron(site, 10.0, lambda x, y: -4.0 + 0.1 * x, Streams(2))
    assert found.places[:, 2] == pytest.approx(-4.0 + 0.1 * found.places[:, 0])
    assert np.abs(found.places[:, :2]).max() <= 5.0
    assert np.median(np.linalg.norm(found.moments, axis=1)) == pytest.approx(5.0, rel=0.1)
    again = build_iron(site, 10.0, lambda x, y: -4.0 + 0.1 * x, Streams(2))
    assert np.array_equal(found.moments, again.moments)


# Pressure.


def test_a_wave_presses_as_linear_theory_has_it():
    """Of one component: rho g a cosh k(z + h) / cosh kh, below a crest positive (Dean & Dalrymple 1991, eq. 4.22)."""
    height, period, depth = 0.4, 4.0, 5.0
    omega = np.array([2 * np.pi / period])
    k = dispersion(omega, depth)
    waves = Waves(depth, np.array([height / 2]), omega, np.column_stack([k, [0.0]]), np.zeros(1))
    times = np.arange(0.0, 8.0, 0.02)
    quiet = PressureRecipe(offset_m=0.0, noise_m=0.0, step_pa=0.0)
    for z in (-1.0, -3.0, -5.0):
        read = pressure.measure(Steady(at(0, 0, z)), quiet, SITE, waves, times, Streams(1))
        weight = pressure.density(SITE) * 9.80665
        swing = (read - pressure.ATMOSPHERE) / weight + z
        factor = np.cosh(k[0] * (z + depth)) / np.cosh(k[0] * depth)
        assert swing == pytest.approx(0.2 * factor * np.cos(omega[0] * times), abs=2e-4)


def test_the_zero_drifts_towards_its_end_and_as_far_as_asked():
    recipe = PressureRecipe(drift_m=0.05, drift_tau_s=300.0)
    times = np.arange(0.0, 1800.0, 1.0)
    drift = pressure.drift(recipe, times, Streams(1))
    assert drift[0] == 0.0
    assert drift[300] / drift[-1] == pytest.approx((1 - np.exp(-1)) / (1 - np.exp(-1799 / 300)))
    ends = [pressure.drift(recipe, np.array([1e5]), Streams(seed))[0] for seed in range(300)]
    assert np.std(ends) == pytest.approx(0.05, rel=0.1)


# Sonar.


def fan(**changes):
    values = {"name": "fls", "rate_hz": 10.0, "hfov_deg": 60.0, "beams": 64, "bins": 200, "max_range_m": 10.0}
    return SonarRecipe(**{**values, "noise_db": -200.0, **changes})


def test_the_water_sends_back_its_volume_strength_times_the_length_of_a_bin():
    recipe = fan(volume_db=-60.0, tvg=False)
    ranges, loss = echoes.bin_middles(recipe), acoustics.absorption(SITE, 10.0, 750.0)
    beams = Beams(np.eye(4), np.zeros(1), 0.02)
    power = added_power(recipe, loss, beams, Streams(1), Streams(2))[0]
    step = 9.9 / 200
    assert power == pytest.approx(1e-6 * step / ranges**2 * 10 ** (-0.2 * loss * ranges))
    assert not added_power(fan(), loss, beams, Streams(1), Streams(2)).any()
    # In open water it is all that there is: speckle, with that mean.
    image, _ = ImagingSonar(caster_over(60.0), recipe, SITE).ping(at(0, 0, -10.0), Streams(3), 0)
    near = np.mean((image.pixels[:20] * echoes.PLAIN_STEP) ** 2, axis=1)
    wanted = power[:20]
    assert near / wanted == pytest.approx(np.ones(20), rel=0.6)
    assert np.mean(near / wanted) == pytest.approx(1.0, abs=0.15)


def test_others_pulses_strike_as_many_pings_as_asked_from_where_they_are():
    recipe = fan(interference=0.15, interference_bearing_deg=0.0, interference_ms=40.0)
    struck = [pulse(recipe, at(0, 0, -2.0, yaw_deg=20.0), Streams(1), Streams(1).at("fls", k)) for k in range(2000)]
    known = [one for one in struck if one is not None]
    assert binomtest(len(known), 2000, 0.15).pvalue > 0.001
    assert np.degrees([one.azimuth for one in known]) == pytest.approx(-20.0)
    assert np.array([one.far_m - one.near_m for one in known]) == pytest.approx(30.0)


def test_a_pulse_is_a_radial_line_in_its_beam():
    recipe = fan(
        interference=1.0, interference_db=-40.0, interference_ms=100.0, interference_bearing_deg=10.0, tvg=False
    )
    heard = ImagingSonar(caster_over(60.0), recipe, SITE)
    place = at(0, 0, -10.0)
    struck = pulse(recipe, place, Streams(4), Streams(4).at("sonar", "fls", 0))
    image, _ = heard.ping(place, Streams(4), 0)
    lasting = (heard.ranges >= struck.near_m) & (heard.ranges < struck.far_m)
    loud = image.pixels[lasting].astype(float).mean(axis=0)
    beam = int(np.argmin(np.abs(heard.azimuths - np.radians(10.0))))
    assert abs(int(np.argmax(loud)) - beam) <= 1
    assert loud[beam] > 5 * np.median(loud)
    ways = np.array([struck.azimuth, struck.azimuth + np.pi, struck.azimuth + 0.01])
    power = line_power(recipe, struck, Beams(place, ways, 0.02))
    assert power[0][lasting] == pytest.approx(1e-4)
    assert power[2][lasting] == pytest.approx(1e-4 * np.sqrt(0.5), rel=1e-3)  # half of the two-way pattern's decibels
    only_heard = line_power(recipe, struck, Beams(place, ways, 0.02, listening=True))
    assert only_heard[2][lasting] == pytest.approx(0.5e-4, rel=1e-3)
    assert not power[0][~lasting].any()
    assert not power[1].any()  # behind


# The truth about them.


def test_runs_of_struck_samples_are_one_fault_each():
    times = np.arange(8.0)
    struck = np.array([0, 1, 1, 0, 0, 1, 0, 1], dtype=bool)
    sizes = np.array([0, 1, -3, 0, 0, 2, 0, 4.0])
    assert spans(times, struck, "x", sizes) == [Fault(1, 2, "x", -3), Fault(5, 5, "x", 2), Fault(7, 7, "x", 4)]
    assert spans(times, np.zeros(8, dtype=bool), "x", sizes) == []
    table = fault_csv([("b", Fault(1.5, 2.0, "y", 0.25)), ("a", Fault(0.5, 0.5, "x", 1.0))], 10**9)
    assert table.decode().splitlines() == [
        "start_ns,end_ns,sensor,fault,value",
        "1500000000,1500000000,a,x,1",
        "2500000000,3000000000,b,y,0.25",
    ]


def test_the_paths_of_splits_take_throttles_that_rovs_take():
    path = build_path(SLAM, lambda x, y: -4.0 + 0.0 * x, lambda x, y: -4.0 + 0.0 * x, Streams(7))
    shares = throttle(path, SLAM, Streams(7)).shares
    assert 0.1 < np.median(shares) < 0.5
    assert shares.max() < 1.0
