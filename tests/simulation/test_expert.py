"""The expert: where the oysters are is where it goes, and not where they were seen already."""

from __future__ import annotations

import numpy as np
import pytest

from oysterbench.core.streams import Streams
from oysterbench.exploration.references import lawnmower, random_walk, swath
from oysterbench.simulation.steering.expert import Expert, Plan, best
from oysterbench.simulation.steering.vehicle import advance, folded, turns
from tests.helpers.flat_site import BOTTOM, field, flat_site

HERE = np.array([0.0, 0.0, BOTTOM + 0.95, 0.0, 0.0])
NONE = np.zeros(0, dtype=bool)


def degrees(site, state, found=None):
    """What the expert commands, in degrees."""
    found = np.zeros(len(site.ids), dtype=bool) if found is None else found
    yaw, pitch = Expert(site).command(state, found)
    return site.task.yaw_deg[yaw], site.task.pitch_deg[pitch]


@pytest.mark.parametrize("side", [1, -1])
def test_it_turns_to_the_side_where_oysters_are(side):
    yaw, _ = degrees(flat_site(field(2.0, 2.5 * side)), HERE)
    assert yaw * side > 0


def test_it_goes_straight_on_to_what_lies_ahead():
    yaw, pitch = degrees(flat_site(field(4.0, 0.0)), HERE)
    assert yaw == 0.0
    assert abs(pitch) <= 16.0


def test_what_was_seen_draws_it_no_more():
    oysters = np.vstack([field(2.0, 2.5), field(2.0, -2.5)])
    found = np.arange(len(oysters)) < len(oysters) // 2  # those on the left
    assert degrees(flat_site(oysters), HERE, found)[0] < 0


def test_the_mirrored_reef_has_the_mirrored_values():
    oysters = np.vstack([field(1.5, 2.0, 49), field(3.0, -1.0, 25)])
    values = Expert(flat_site(oysters)).values(HERE, np.zeros(len(oysters), dtype=bool))
    mirrored = Expert(flat_site(oysters * [1, -1])).values(HERE, np.zeros(len(oysters), dtype=bool))
    # The beam is narrow, and cells of the bottom are closed on one side: not to the last oyster.
    assert np.corrcoef(values.ravel(), mirrored[::-1].ravel())[0, 1] > 0.8


def test_a_more_distant_field_counts_when_nothing_is_near():
    behind = degrees(flat_site(field(-8.0, 1.0)), HERE)[0]
    assert behind == max(flat_site(field(0, 0)).task.yaw_deg)  # by the left, where it is


@pytest.mark.parametrize(("altitude", "sign"), [(2.2, 1), (0.35, -1)])
def test_it_comes_back_to_the_altitude_band(altitude, sign):
    state = np.array([0.0, 0.0, BOTTOM + altitude, 0.0, 0.0])
    _, pitch = degrees(flat_site(field(4.0, 0.0)), state)
    assert np.sign(pitch) == sign


def test_it_does_not_run_into_a_wall():
    site = flat_site(field(4.0, 0.0))
    object.__setattr__(site, "wall_x", 1.0)
    object.__setattr__(site, "wall_m", 3.0)
    state, found = HERE, np.zeros(len(site.ids), dtype=bool)
    expert = Expert(site)
    for _ in range(12):
        yaw, pitch = expert.command(state, found)
        way = advance(state[None], turns(site.task)[0][[yaw]], turns(site.task)[1][[pitch]], site.task)[0]
        assert (way[:, 2] >= site.floor(way[:, 0], way[:, 1])).all()
        state = way[-1]


def test_without_oysters_it_flies_straight_and_level():
    assert degrees(flat_site(np.zeros((0, 2))), HERE) == (0.0, 0.0)


def test_values_are_the_same_twice_and_count_oysters():
    site = flat_site(field(1.5, 0.0))
    found = np.zeros(len(site.ids), dtype=bool)
    values = Expert(site).values(HERE, found)
    assert np.array_equal(values, Expert(site).values(HERE, found))
    assert values.shape == (7, 7)
    assert 0 < values.max() <= len(site.ids) * (1 + Plan().waiting)


def test_of_equal_values_the_first_is_taken():
    values = np.zeros((3, 3))
    values[1, 2] = values[2, 0] = 1.0
    assert best(values) == (1, 2)


def fly(site, command, steps, state=HERE):
    """Places (steps + 1, 2) of a policy over a flat bottom."""
    yaw, pitch = turns(site.task)
    places = [state]
    for _ in range(steps):
        classes = command(state, NONE)
        way = advance(state[None], yaw[[classes[0]]], pitch[[classes[1]]], site.task)[0]
        state = folded(way, site.half_m)[0][-1]
        places.append(state)
    return np.array(places)


def test_the_lawnmower_covers_the_area_in_lanes_as_far_apart_as_a_picture_is_wide():
    site = flat_site(np.zeros((0, 2)), half_m=5.0)
    places = fly(site, lawnmower(site, HERE), 260)
    lines = np.linspace(-4.4, 4.4, 40)
    x, y = (grid.ravel() for grid in np.meshgrid(lines, lines))
    nearest = np.min(np.hypot(x[:, None] - places[:, 0], y[:, None] - places[:, 1]), axis=1)
    assert nearest.max() < 0.75 * swath(site)
    assert np.abs(places[:, :2]).max() <= 5.0
    assert places[5:, 2] - BOTTOM == pytest.approx(np.full(256, 0.95), abs=0.05)


def test_the_random_walk_is_random_and_keeps_its_altitude():
    site = flat_site(np.zeros((0, 2)), half_m=5.0)
    ways = [fly(site, random_walk(site, Streams(seed).generator("walk")), 60) for seed in (1, 1, 2)]
    assert np.array_equal(ways[0], ways[1])
    assert not np.allclose(ways[0], ways[2])
    assert ways[2][:, 2] - BOTTOM == pytest.approx(np.full(61, 0.95), abs=0.05)
