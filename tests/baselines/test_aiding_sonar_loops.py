"""Ground that a sonar hears again: it is found on an old chart, and what proves nothing does not count."""

from __future__ import annotations

import gtsam
import numpy as np
import pytest
from gtsam.symbol_shorthand import V, X
from scipy.spatial.transform import Rotation

from oysterbench.core.geometry import Array
from oysterbench_baselines.common.aiding.sonar.chart import Chart, packed, unpacked
from oysterbench_baselines.common.aiding.sonar.factor import SONAR_KEY, Motion, Sighting
from oysterbench_baselines.common.aiding.sonar.loops import Loops
from oysterbench_baselines.gtsam_vi.states import State, make_state
from tests.baselines.test_aiding_sonar import GRID, HEIGHT, OF, VIEW, charted, oysters, picture

STILL = Motion(0.0, np.eye(3), np.zeros(3), np.zeros((3, 3)))
WAY = 20.0
"""m, from the first visit to the second."""
VISITS = np.array([[0.4, 0.2, 0.0], [3.2, -2.8, np.pi / 2], [5.8, 0.4, 3.0]])
"""x, y, heading of the sonar on its second visit, whose fans are those of three key frames."""


def state(place: Array) -> State:
    """With the inertial unit where the sonar is."""
    rotation = Rotation.from_euler("z", place[2]).as_matrix()
    return make_state(rotation, np.array([*place[:2], HEIGHT]), np.zeros(3), np.zeros(3), np.zeros(3))


def sighted(place: Array, way: float, chart: int) -> Sighting:
    return Sighting.at(place, np.diag([4e-6, 4e-6, 1e-6]), chart, way, STILL, np.eye(4))


def two_visits(visits: Array = VISITS, reef: int = 1) -> Loops:
    """A chart around the origin, and a second visit, whose own chart begins at its first fan; of another reef, where
    that has another number."""
    loops, first = Loops(GRID, OF), oysters(1, 2500)
    chart = charted(first)
    loops.keep(0, sighted(np.zeros(3), 0.0, 1), chart, picture(13, first, np.zeros(3)), VIEW)
    later = first if reef == 1 else oysters(reef, 2500)
    for k, place in enumerate(visits):
        shown = picture(20 + k, later, place)
        chart = Chart(OF.chart)
        chart.add(shown, np.zeros(3), VIEW, GRID, OF.fan)
        loops.keep(k + 1, sighted(np.zeros(3), WAY + k, 2 + k), chart, shown, VIEW)
    return loops


def drifted(drift: Array, visits: Array = VISITS) -> dict[int, State]:
    return {0: state(np.zeros(3))} | {k + 1: state(place + drift) for k, place in enumerate(visits)}


def error(loops: Loops, states: dict[int, State], at: dict[int, State]) -> float:
    """Of the factors that were found from some states, at others."""
    values = gtsam.Values()
    values.insert(SONAR_KEY, np.zeros(2))
    for k, one in at.items():
        values.insert(X(k), one.nav.pose())
        values.insert(V(k), np.zeros(3))
    return float(sum(factor.error(values) for factor in loops.factors(states)))


def test_ground_is_found_again_from_any_side():
    drift = np.array([0.25, -0.3, 0.0])
    loops = two_visits()
    states = drifted(drift)
    found = loops.factors(states)
    assert len(found) == loops.count == 3
    assert error(loops, states, drifted(np.zeros(3))) < 1.0  # 0.02 m, which is within what a loop is believed by
    assert error(loops, states, states) > 3.0


def test_another_reef_closes_no_loop():
    assert two_visits(reef=2).factors(drifted(np.array([0.25, -0.3, 0.0]))) == []


def test_one_match_alone_proves_nothing():
    assert two_visits(VISITS[:1]).factors(drifted(np.zeros(3), VISITS[:1])) == []


def test_what_says_something_else_of_the_path_than_its_neighbours_does_not_count():
    """The path is off by as much from fan to fan as it cannot be."""
    states = drifted(np.zeros(3))
    for k, off in enumerate([0.3, -0.3, 0.0]):
        states[k + 1] = state(VISITS[k] + [off, 0.0, 0.0])
    assert two_visits().factors(states) == []


def test_places_of_one_chart_are_no_loop():
    loops = two_visits()
    loops.places = [
        type(place)(place.keyframe, sighted(np.zeros(3), 0.9 * k, 1), place.chart, place.picture, place.view)
        for k, place in enumerate(loops.places)
    ]
    assert loops.factors(drifted(np.zeros(3))) == []


def test_key_frames_that_are_not_adjusted_have_no_loops():
    states = drifted(np.zeros(3))
    assert two_visits().factors({k: states[k] for k in (1, 2, 3)}) == []
    assert two_visits().factors({}) == []


def test_a_kept_chart_is_what_it_was():
    chart = charted(oysters(1, 2500))
    again = chart.packed().chart()
    known = chart.fans > 0
    np.testing.assert_array_equal(again.fans > 0, known)
    np.testing.assert_allclose(again.values[known], np.minimum(chart.values[known], 254 / 8), atol=1 / 16 + 1e-6)
    cells = np.array([0, 12345])
    np.testing.assert_array_equal(again.points(cells), chart.points(cells))


@pytest.mark.parametrize("echo", [0.0, 10.0, 31.75])
def test_echoes_are_kept_in_steps_of_an_eighth_of_a_decibel(echo):
    assert unpacked(packed(np.array([echo + 0.05], np.float32)))[0] == pytest.approx(echo)
