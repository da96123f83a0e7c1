"""Reference policies that every policy is compared with: the expert, a lawnmower survey and a random walk.

They know the ground truth: the lawnmower its position, all of them the altitude over the bottom ahead.
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

LOOKAHEAD_M = 0.8  # distance along its line at which the survey aims
MARGIN_M = 0.4  # distance of the ends of the survey's lanes from the fence
HELD_STEPS = (2, 6)  # duration of the random walk's turns: minimum, and upper bound (exclusive)

Command = Callable[[Array, NDArray[np.bool_]], tuple[int, int]]
"""Returns the classes of yaw and pitch for a state (5,), given which oysters (N,) were found so far."""


def reference(name: str, site: Site, state: Array, streams: Streams) -> Command:
    """Make a policy of REFERENCES for a rollout that starts at a state (5,). Raises ValueError for another name."""
    match name:
        case "expert":
            return Expert(site).command
        case "lawnmower":
            return lawnmower(site, state)
        case "random":
            return random_walk(site, streams.generator("random walk"))
    raise ValueError(f"no reference policy {name!r}; expected one of {', '.join(REFERENCES)}")


def swath(site: Site) -> float:
    """Width of the bottom, m, that images from the middle of the altitude band show within range."""
    height = 0.5 * sum(site.task.altitude_m)
    reach = np.sqrt(max(site.range_m**2 - height**2, 0.0))
    # Between the sides of the image, where they meet the circle of the points within range.
    return float(2 * reach * np.sin(np.arctan(site.slopes[0])))


def lawnmower(site: Site, state: Array) -> Command:
    """Make a survey in lanes no farther apart than an image is wide, from the corner nearest to the start."""
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
    """Whether the end of a leg is within the lookahead distance, or behind."""
    away = points[leg] - place
    if np.linalg.norm(away) <= LOOKAHEAD_M:
        return True
    if leg == 0:
        return False
    along = points[leg] - points[leg - 1]
    return bool(np.dot(away, along) <= 0)


def _pursued(points: Array, leg: int, place: Array) -> Array:
    """Point of a leg that is the lookahead distance ahead of the one nearest to the position (2,)."""
    if leg == 0:
        return np.asarray(points[0])
    begin, end = points[leg - 1], points[leg]
    length = float(np.linalg.norm(end - begin))
    along = (end - begin) / length
    done = float(np.clip(np.dot(place - begin, along) + LOOKAHEAD_M, 0.0, length))
    return np.asarray(begin + done * along)


def random_walk(site: Site, generator: np.random.Generator) -> Command:
    """Make a policy that holds random classes of yaw for some steps each, at a steady altitude."""
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
