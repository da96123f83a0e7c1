"""What pushes the vehicle: waves by linear theory, a current that it holds its track in, drag that tilts it."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from oysterbench.core.geometry import GRAVITY
from oysterbench.core.streams import Streams
from oysterbench.recipe import PathRecipe, SiteRecipe, load_split
from oysterbench.scene.path import build, build_path
from oysterbench.scene.path.disturbance import EXCITATION_S, HULL, crab
from oysterbench.scene.waves import Waves

BASE = load_split("slam-mini").sequence[0]
SPEED = 0.4
CALM = {"sway_m": 0.0, "tilt_deg": 0.0}
LINE = {"kind": "transect", "length_m": 9.0, **CALM}
HOVER = {"kind": "waypoints", "waypoints": ((0.5, -0.5),), **CALM}


def flat(x, y):
    return np.full(np.shape(x), -4.0)


def make(site=None, duration_s=60.0, altitude_m=1.0, **keys):
    plan = PathRecipe(speed_m_s=SPEED, altitude_m=altitude_m, **keys)
    recipe = dataclasses.replace(BASE, duration_s=duration_s, path=plan, site=site or SiteRecipe())
    return build_path(recipe, flat, flat, Streams(7))


def times(path, start=0.0):
    return np.arange(start, path.duration_s, 0.02)


@pytest.mark.parametrize("altitude_m", [0.8, 2.5])
@pytest.mark.parametrize("share", [1.0, 0.4])
def test_a_wave_carries_the_vehicle_by_the_amplitude_of_linear_theory_at_its_depth(monkeypatch, altitude_m, share):
    period, height, h = 4.0, 0.3, 4.0
    omega = 2 * np.pi / period
    k = omega**2 / GRAVITY
    for _ in range(200):  # omega^2 = g k tanh(k h), by relaxation
        k = 0.5 * (k + omega**2 / (GRAVITY * np.tanh(k * h)))
    wave = Waves(h, np.array([height / 2]), np.array([omega]), np.array([[0.0, k]]), np.array([0.7]))
    monkeypatch.setattr(build, "build_waves", lambda site, depth_m, streams: wave)
    site = SiteRecipe(wave_height_m=height, wave_period_s=period)
    path = make(site, altitude_m=altitude_m, wave_following=share, clearance_m=0.1, **HOVER)
    at = times(path, 5.0)
    basis = np.column_stack([np.cos(omega * at), np.sin(omega * at), np.ones(len(at))])
    fit, *_ = np.linalg.lstsq(basis, path.position(at), rcond=None)
    assert basis @ fit == pytest.approx(path.position(at), abs=1e-4)  # of that period and no other
    heave, surge = np.hypot(*fit[:2, 2]), np.hypot(*fit[:2, 1])
    assert heave == pytest.approx(share * height / 2 * np.sinh(k * altitude_m) / np.sinh(k * h), rel=1e-3)
    assert surge == pytest.approx(share * height / 2 * np.cosh(k * altitude_m) / np.sinh(k * h), rel=1e-3)
    assert np.hypot(*fit[:2, 0]) < 1e-6


def test_the_site_says_how_high_the_waves_are_and_when_they_come():
    def heave(**site):
        path = make(SiteRecipe(**site), 600.0, altitude_m=2.5, clearance_m=0.1, **HOVER)
        return path.position(times(path, 5.0))[:, 2]

    small, large, slow = (
        heave(wave_height_m=height, wave_period_s=period) for height, period in ((0.2, 4), (0.4, 4), (0.2, 6))
    )
    assert large.std() / small.std() == pytest.approx(2.0, rel=1e-3)
    crossings = [np.count_nonzero(np.diff(np.sign(z - z.mean()))) for z in (small, slow)]
    assert crossings[0] > 1.2 * crossings[1]
    assert heave().std() < 1e-12


@pytest.mark.parametrize("to_deg", [90.0, -90.0, 40.0])
def test_the_bow_turns_into_the_current_so_that_the_track_stays_straight(to_deg):
    path = make(SiteRecipe(current_m_s=0.2, current_to_deg=to_deg), 25.0, hold_s=0.0, **LINE)
    motion = path.at(times(path, 5.0))
    assert np.abs(motion.position[:, 1]).max() < 1e-6
    current = 0.2 * np.array([np.cos(np.radians(to_deg)), np.sin(np.radians(to_deg))])
    through = motion.velocity[:, :2] - current
    yaw = np.arctan2(motion.rotation[:, 1, 0], motion.rotation[:, 0, 0])
    bow = np.arctan2(through[:, 1], through[:, 0])
    assert np.sign(yaw) == pytest.approx(-np.sign(current[1]))
    assert np.degrees(yaw.mean()) == pytest.approx(np.degrees(bow.mean()), abs=5.0)  # of the mean, gusts aside
    assert np.ptp(yaw) > 1e-3


def test_crab_is_the_angle_of_the_way_through_the_water():
    n = 200
    water = np.tile([0.1, -0.3], (n, 1))
    assert crab(np.zeros(n), water, 0.5) == pytest.approx(np.arctan2(0.3, 0.4))
    assert crab(np.full(n, np.pi), water, 0.5) == pytest.approx(-np.arctan2(0.3, 0.6))
    assert np.abs(crab(np.zeros(n), np.tile([3.0, 0.1], (n, 1)), 0.5)).max() < np.pi / 2  # carried along: no spinning


def test_a_varying_current_pushes_the_vehicle_a_little_off_its_track():
    site = SiteRecipe(current_m_s=0.3, current_to_deg=90.0)
    off = {hold: make(site, 25.0, hold_s=hold, **LINE).position(np.arange(5.0, 25.0, 0.1))[:, 1] for hold in (1.0, 2.0)}
    assert 0.005 < np.abs(off[1.0]).max() < 0.06
    assert off[2.0] == pytest.approx(2 * off[1.0], abs=1e-9)


def test_a_vehicle_that_looks_at_a_place_does_not_turn_from_it_into_the_current():
    keys = {"kind": "orbit", "radius_m": 2.0, "look": "inward", "hold_s": 0.0, **CALM}
    still, pushed = make(**keys), make(SiteRecipe(current_m_s=0.3), **keys)
    assert np.array_equal(still.attitude(times(still)), pushed.attitude(times(pushed)))


def test_drag_lowers_the_bow_by_the_balance_of_moments():
    path = make(lean=1.0, **LINE)
    force = HULL.linear[0] * SPEED + HULL.quadratic[0] * SPEED**2
    expected = np.arctan(force / (HULL.mass_kg * GRAVITY))
    assert path.attitude(12.0)[1] == pytest.approx(expected, rel=0.02)
    assert path.at(np.array([12.0])).rotation[0, 2, 0] < 0.0  # the bow's axis points down
    assert path.attitude(0.0)[1] == pytest.approx(0.0, abs=0.01)
    assert make(lean=0.5, **LINE).attitude(12.0)[1] == pytest.approx(0.5 * expected, rel=0.02)
    assert np.all(make(**LINE).attitude(times(path))[:, 1:] == 0.0)


def test_the_hull_leans_into_its_turns_and_against_a_current_from_the_side():
    for look in ("along", "inward"):
        path = make(kind="orbit", radius_m=1.0, lean=1.0, look=look, **CALM)
        motion = path.at(times(path, 10.0))
        inwards = -motion.position[:, :2] / np.linalg.norm(motion.position[:, :2], axis=1, keepdims=True)
        mast = np.sum(motion.rotation[:, :2, 2] * inwards, axis=1)
        assert np.all(mast > 0.005), look
    held = make(SiteRecipe(current_m_s=0.3, current_to_deg=90.0), lean=1.0, **HOVER)
    assert np.all(held.at(times(held)).rotation[:, 1, 2] < -0.01)  # its mast points against the water


def test_acceleration_shows_in_the_pitch():
    keys = {**LINE, "repeat": True, "length_m": 2.0}
    path = make(lean=1.0, **keys)
    motion = path.at(times(path, 5.0))
    bow = motion.rotation[:, :2, 0]
    surge = np.sum(motion.acceleration[:, :2] * bow, axis=1)
    pitch = path.attitude(times(path, 5.0))[:, 1]
    assert np.corrcoef(surge[surge > 0.1], pitch[surge > 0.1])[0, 1] > 0.3
    assert pitch[surge > 0.1].max() > path.attitude(times(path, 5.0))[:, 1].mean()
    assert np.abs(pitch).max() < np.radians(15.0)


def test_the_opening_manoeuvre_excites_all_axes_and_then_ends():
    plain, excited = make(**LINE), make(excitation=1.0, **LINE)
    early, late = np.arange(0.0, EXCITATION_S, 0.02), np.arange(EXCITATION_S + 0.5, 60.0, 0.02)
    calm, moved = plain.at(early), excited.at(early)
    assert np.all(np.std(moved.rate, axis=0) > 0.03)
    assert np.all(np.std(moved.acceleration - calm.acceleration, axis=0) > 0.05)
    assert np.abs(moved.position - calm.position).max() < 0.1
    assert np.linalg.norm(moved.velocity[0]) < 1e-3
    assert excited.position(late) == pytest.approx(plain.position(late), abs=1e-6)
    assert excited.attitude(late) == pytest.approx(plain.attitude(late), abs=1e-6)


def test_sites_and_keys_at_their_defaults_leave_a_path_as_it_is():
    keys = {"kind": "loop", "radius_m": 1.6}
    plain = make(**keys)
    for other in (make(wave_following=0.2, hold_s=5.0, **keys), make(SiteRecipe(current_to_deg=90.0), **keys)):
        assert np.array_equal(plain.position.c, other.position.c)
        assert np.array_equal(plain.attitude.c, other.attitude.c)
