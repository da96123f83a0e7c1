"""Loop closures of a sonar: ground that is seen again much later.

Every metre or so a place is stored: the chart as it was, and the fan that was registered on it last. Where a dive is
adjusted as a whole, each place is looked for on the charts of earlier ones that should show the same ground: by
correlation, within the possible error of the path, and then to a fraction of a cell (`registration`). On a bottom that
looks alike everywhere one such match proves little: it counts only if one between neighbouring places agrees.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from oysterbench.core.geometry import Array
from oysterbench_baselines.common.aiding.sonar.chart import Chart, PackedChart, packed, unpacked
from oysterbench_baselines.common.aiding.sonar.factor import Sighting, Step, sonar_at, step_factor, turned, wrapped
from oysterbench_baselines.common.aiding.sonar.fan import Grid, View
from oysterbench_baselines.common.aiding.sonar.registration import Guess, Match, register
from oysterbench_baselines.common.aiding.sonar.settings import SonarSettings

if TYPE_CHECKING:
    import gtsam

    from oysterbench_baselines.gtsam_vi.states import State


@dataclass(frozen=True)
class Place:
    """What the sonar saw at a keyframe: the chart, and the fan's image (bins, beams), `packed`."""

    keyframe: int
    sighting: Sighting
    chart: PackedChart
    picture: NDArray[np.uint8]
    view: View


@dataclass(frozen=True)
class Loop:
    """The second of two places, by their numbers, found on the chart of the first: its place (3,) and covariance (3, 3)
    there; miss (2,) m: error of the path, in its own axes."""

    first: int
    second: int
    match: Match
    miss: Array


class Loops:
    """Places along a dive, and the loops among them."""

    def __init__(self, grid: Grid, settings: SonarSettings) -> None:
        self.grid, self.settings = grid, settings
        self.places: list[Place] = []
        self.count = 0  # of loops in the latest adjustment
        self._tried: dict[tuple[int, int], Loop | None] = {}

    def keep(self, keyframe: int, sighting: Sighting, chart: Chart, picture: NDArray[np.float32], view: View) -> None:
        """Store a place, if the sonar has moved on since the last one."""
        if self.places and sighting.way - self.places[-1].sighting.way < self.settings.loops.step_m:
            return
        self.places.append(Place(keyframe, sighting, chart.packed(), packed(picture), view))

    def factors(self, states: Mapping[int, State]) -> list[gtsam.NonlinearFactor]:
        """Factors of the loops among keyframes whose states are given."""
        of, factors = self.settings.loops, []
        found = self._agreeing([self._tried_once(*pair, states) for pair in self._candidates(states)])
        self.count = len(found)
        for loop in found:
            first, second = (self.places[n] for n in (loop.first, loop.second))
            covariance = loop.match.covariance + np.diag([of.sigma_m**2] * 2 + [0.0])
            heard = replace(second.sighting, place=loop.match.place, covariance=covariance)
            step = Step.of(first.sighting, heard, 0.0, of.turn_sigma)
            factors.append(step_factor(step, first.keyframe, second.keyframe, cauchy=of.cauchy))
        return factors

    def _candidates(self, states: Mapping[int, State]) -> Iterator[tuple[int, int]]:
        """Pairs of places that should show the same ground, the earlier one first; for each place, the nearest few."""
        of = self.settings.loops
        numbers = [n for n, place in enumerate(self.places) if place.keyframe in states]
        if len(numbers) < 2:
            return
        ends = (sonar_at(self.places[n].sighting, states[self.places[n].keyframe]) for n in numbers)
        ahead = 0.5 * self.settings.fan.reach_m
        heard = np.array([spot + ahead * np.array([np.cos(heading), np.sin(heading)]) for spot, heading in ends])
        tree = cKDTree(heard)
        for k, second in enumerate(numbers):
            near = np.array(tree.query_ball_point(heard[k], of.apart_m), dtype=int)
            near = near[np.argsort(np.linalg.norm(heard[near] - heard[k], axis=1), kind="stable")]
            good = [numbers[n] for n in near if self._way(numbers[n], second) > of.least_way_m]
            yield from ((first, second) for first in good[: of.candidates])

    def _way(self, first: int, second: int) -> float:
        """Path length (m) from one place to a later one."""
        return self.places[second].sighting.way - self.places[first].sighting.way

    def _tried_once(self, first: int, second: int, states: Mapping[int, State]) -> Loop | None:
        if (first, second) not in self._tried:
            self._tried[first, second] = self._find(first, second, states)
        return self._tried[first, second]

    def _find(self, first: int, second: int, states: Mapping[int, State]) -> Loop | None:
        """Find the second place on the chart of the first; None where it is not found there."""
        of, (old, new) = self.settings, (self.places[n] for n in (first, second))
        (spot, heading), (spot_2, heading_2) = (sonar_at(p.sighting, states[p.keyframe]) for p in (old, new))
        to_chart = turned(old.sighting.place[2] - heading)
        moved = np.append(to_chart @ (spot_2 - spot), wrapped(heading_2 - heading))
        off = of.loops.drift * self._way(first, second)
        guess = Guess(old.sighting.place + moved, off, of.loops.turn_sigma)
        chart, picture = old.chart.chart(), unpacked(new.picture)
        match = register(chart, picture, new.view, guess, self.grid, of.fan, of.loops.registration)
        if match is None:
            return None
        return Loop(first, second, match, to_chart.T @ (match.place - guess.place)[:2])

    def _agreeing(self, loops: list[Loop | None]) -> list[Loop]:
        """Loops that are confirmed by one between neighbours of their places."""
        of, found = self.settings.loops, [loop for loop in loops if loop is not None]
        return [
            loop
            for loop in found
            if any(
                other.second != loop.second
                and abs(other.second - loop.second) <= of.neighbours
                and abs(other.first - loop.first) <= of.neighbours
                and np.linalg.norm(other.miss - loop.miss) < of.agree_m
                for other in found
            )
        ]
