"""References that every policy is compared with: the expert, a lawnmower survey and a random walk.

They know the truth: the lawnmower its place, all of them their altitude over the bottom ahead.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from oysterbench.core.geometry import Array
from oysterbench.core.streams import Streams
from oysterbench.simulation.steering.expert import Expert, altitude_pitch
from oysterbench.simulation.steering.site import Site
from oysterbench.simulation.steering.vehicle import nearest_class, turns

REFERENCES = ("expert", "lawnmower", "random")

LOOKAHEAD_M = 0.8  # of the survey's pursuit of its line
MARGIN_M = 0.4  # of the survey's ends from the fence
HELD_STEPS = (2, 6)  # of the random walk's turns: at least, and below

Command = Callable[[Array, NDArray[np.bool_]], tuple[int, int]]
"""Classes of yaw and pitch at a state (5,), when these oysters (N,) were seen."""


def reference(name: str, site: Site, state: Array, streams: Streams) -> Command:
    """A policy of REFERENCES for a rollout that begins at a state."""
    match name:
        case "expert":
            return Expert(site).command
        case "lawnmower":
            return lawnmower(site, state)
        case "random":
            return random_walk(site, streams.generator("random walk"))
    raise ValueError(f"no reference policy {name!r}; expected one of {', '.join(REFERENCES)}")


def swath(site: Site) -> float:
    """Width of bottom, m, that pictures from the middle of the altitude band show within range."""
    height = 0.5 * sum(site.task.altitude_m)
    reach = np.sqrt(max(site.range_m**2 - height**2, 0.0))
    # Between the picture's sides, at the range where these and the circle of what is near enough meet.
    return float(2 * reach * np.sin(np.arctan(site.slopes[0])))


def lawnmower(site: Site, state: Array) -> Command:
    """A survey in lanes as far apart as a picture is wide, from the corner nearest to where it begins."""
    half = site.half_m - MARGIN_M
    lanes = max(2, int(np.ceil(2 * half / swath(site))) + 1)
    first = np.where(state[:2] < 0, -half, half)
    corners = []
    for k, y in enumerate(np.linspace(first[1], -first[1], lanes)):
        ends = (first[0], -first[0]) if k % 2 == 0 else (-first[0], first[0])
        corners += [(x, y) for x in ends]
    points = np.array(corners)
    leg = 0
    yaw, _ = turns(site.task)

    def command(state: Array, found: NDArray[np.bool_]) -> tuple[int, int]:
        nonlocal leg
        while leg < len(points) - 1 and _passed(points, leg, state[:2]):
            leg += 1
        aim = _pursued(points, leg, state[:2])
        bearing = np.arctan2(aim[1] - state[1], aim[0] - state[0])
        turn = float(np.remainder(bearing - state[3] + np.pi, 2 * np.pi) - np.pi)
        return nearest_class(turn, yaw), altitude_pitch(site, state)

    return command


def _passed(points: Array, leg: int, place: Array) -> bool:
    """Whether the end of a leg is within reach, or behind."""
    away = points[leg] - place
    if np.linalg.norm(away) <= LOOKAHEAD_M:
        return True
    if leg == 0:
        return False
    along = points[leg] - points[leg - 1]
    return bool(np.dot(away, along) <= 0)


def _pursued(points: Array, leg: int, place: Array) -> Array:
    """The point of a leg a little ahead of what is nearest to the place."""
    if leg == 0:
        return np.asarray(points[0])
    begin, end = points[leg - 1], points[leg]
    length = float(np.linalg.norm(end - begin))
    along = (end - begin) / length
    done = float(np.clip(np.dot(place - begin, along) + LOOKAHEAD_M, 0.0, length))
    return np.asarray(begin + done * along)


def random_walk(site: Site, generator: np.random.Generator) -> Command:
    """Turns of any class, each kept for some steps, at a steady altitude."""
    yaw, _ = turns(site.task)
    held, left = 0, 0

    def command(state: Array, found: NDArray[np.bool_]) -> tuple[int, int]:
        nonlocal held, left
        if left == 0:
            held = int(generator.integers(len(yaw)))
            left = int(generator.integers(*HELD_STEPS))
        left -= 1
        return held, altitude_pitch(site, state)

    return command
