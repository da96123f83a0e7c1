"""Dives as they are flown: rests at the start, stops, drifts and corrections."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from oysterbench.core.streams import Streams
from oysterbench.recipe import load_split
from oysterbench.scene.path import build_path
from oysterbench.scene.path.disturbance import CORRECTION_S, drift


def flat(x, y):
    return np.full(np.shape(x), -4.0)


def fly(duration_s=60.0, **keys):
    recipe = load_split("slam-mini").sequence[0]
    reef = dataclasses.replace(recipe.reef, size_m=40.0, depth_m=4.0)
    plan = dataclasses.replace(recipe.path, excitation=0.0, **keys)
    recipe = dataclasses.replace(recipe, path=plan, reef=reef, duration_s=duration_s)
    return build_path(recipe, flat, flat, Streams(3))


def speeds(path, first_s, last_s):
    return np.linalg.norm(path.at(np.arange(first_s, last_s, 0.05)).velocity, axis=1)


def test_a_vehicle_that_rests_stays_still_and_then_sets_off():
    path = fly(rest_s=3.0)
    assert speeds(path, 0.0, 2.5).max() < 1e-6
    assert speeds(path, 10.0, 20.0).max() > 0.2


def test_a_vehicle_that_hovers_first_moves_about_its_place_only():
    path = fly(rest_s=3.0, resting="hovering", sway_m=0.05)
    assert speeds(path, 0.0, 2.5).max() > 0.005
    away = path.at(np.arange(0.0, 2.5, 0.05)).position
    assert np.ptp(away, axis=0).max() < 3 * 0.05


def test_a_drift_is_noticed_within_its_time_and_undone_by_a_quick_correction():
    times = np.arange(0.0, 600.0, 0.1)
    teeth = drift(times, (3.0, 9.0), np.random.default_rng(4))
    rate = np.abs(np.gradient(teeth, times))
    crossings = np.flatnonzero(np.diff(np.sign(teeth)))
    assert np.std(teeth) < 1.0
    assert np.percentile(rate, 97) > 4 * np.median(rate)  # slow off, quick back
    assert len(crossings) > 600 / (9.0 + CORRECTION_S) / 2


def test_a_dive_flown_by_hand_has_the_speeds_and_turns_of_real_ones():
    shape = {"kind": "lawnmower", "radius_m": None, "length_m": 12.0, "width_m": 8.0, "spacing_m": 1.0}
    path = fly(420.0, **shape, speed_m_s=0.25, turn_rate_deg_s=14.0, tilt_deg=2.5, sway_m=0.05, hand_flown=1.0)
    motion = path.at(np.arange(5.0, 420.0, 0.1))
    speed = np.linalg.norm(motion.velocity, axis=1)
    turn = np.degrees(np.linalg.norm(motion.rate, axis=1))
    assert 0.09 < np.median(speed) < 0.25
    assert 0.16 < np.percentile(speed, 95) < 0.35
    assert 3.0 < np.median(turn) < 7.0
    assert 11.0 < np.percentile(turn, 95) < 18.0
    assert 60.0 < speed.sum() * 0.1 < 200.0


def test_a_path_that_nobody_flies_by_hand_keeps_to_its_pace():
    steady, flown = fly(hand_flown=0.0, sway_m=0.0), fly(hand_flown=1.0, sway_m=0.0)
    assert np.std(speeds(steady, 10.0, 50.0)) < np.std(speeds(flown, 10.0, 50.0))


@pytest.mark.parametrize("seed", [1, 2])
def test_the_same_seed_flies_the_same_way(seed):
    recipe = load_split("slam-mini").sequence[0]
    recipe = dataclasses.replace(recipe, path=dataclasses.replace(recipe.path, hand_flown=1.0))
    one, two = (build_path(recipe, flat, flat, Streams(seed)) for _ in range(2))
    assert np.array_equal(one.position.c, two.position.c)
