"""The tether, from the vehicle's stern to the surface; it trails behind, and its slack hangs out to one side."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from oysterbench.core.geometry import Array
from oysterbench.scene.life.ground import Ground
from oysterbench.scene.life.states import State, Vehicle
from oysterbench.scene.waves import Waves

PIECES = 60
RADIUS_M = 0.0038  # of a neutrally buoyant tether for small ROVs (maker's data sheet: 7.6 mm across)
STERN = np.array([-0.19, 0.02, 0.05])  # in base_link
LAG_S = 9.0  # delay with which its far end follows: a tether pulled through water lies where the vehicle was
TURN_S = 70.0  # period with which the direction of the slack rotates
SLACKEST = 0.22  # share of the tether's length at which it hangs out farthest
SAG = 0.8  # how far the slack hangs down, relative to slack_m


@dataclass(frozen=True)
class Tether:
    """Tether of the vehicle. anchor (2,) m: x and y of the boat. slack_m: how far the slack hangs out. phase: its
    direction at time 0, rad."""

    colours: Array
    anchor: Array
    slack_m: float
    phase: float
    vehicle: Vehicle
    waves: Waves
    ground: Ground
    class_name: str = "tether"
    kind: str = "tether"

    @property
    def ids(self) -> NDArray[np.int64]:
        return np.zeros(PIECES, dtype=np.int64)

    def at(self, time_s: float) -> State:
        nodes = self.nodes(time_s)
        span = np.diff(nodes, axis=0)
        length = np.linalg.norm(span, axis=1)
        x = span / length[:, None]
        aside = np.cross(x, np.eye(3)[np.argmin(np.abs(x), axis=1)])
        y = aside / np.linalg.norm(aside, axis=1, keepdims=True)
        rotations = np.stack([x, y, np.cross(x, y)], axis=-1)
        scales = np.column_stack([length, np.full(PIECES, RADIUS_M), np.full(PIECES, RADIUS_M)])
        return State(np.zeros(PIECES, dtype=np.int64), nodes[:-1], rotations, scales)

    def nodes(self, time_s: float) -> Array:
        """Points (PIECES + 1, 3) m of the tether from the stern to the surface."""
        share = np.linspace(0, 1, PIECES + 1) ** 1.5  # pieces are shorter where the tether bends
        position, rotation = self.vehicle(time_s - LAG_S * share**2)
        trailing = position + rotation @ STERN
        rise = share[:, None] ** 1.6
        surface = np.array([*self.anchor, 0.0])
        nodes = (1 - rise) * trailing + rise * surface
        # It leaves the stern straight back before it bends.
        back = -rotation[0, :, 0] + [0.0, 0.0, 0.25]
        nodes += (0.9 * share * np.exp(-share / 0.08))[:, None] * back
        side = self.phase + 2 * np.pi * (time_s - 4.0 * (share - SLACKEST)) / TURN_S
        loop = self.slack_m * (share / SLACKEST) ** 1.5 * np.exp(1.5 * (1 - share / SLACKEST))
        nodes[:, 0] += loop * np.cos(side)
        nodes[:, 1] += loop * np.sin(side)
        nodes[:, 2] -= SAG * loop
        moved = self.waves.displacement(nodes, np.full(len(nodes), time_s))
        nodes += np.minimum(share / 0.3, 1.0)[:, None] * moved
        floor = self.ground.foothold(nodes[:, 0], nodes[:, 1]) + RADIUS_M
        nodes[:, 2] = np.maximum(nodes[:, 2], floor)
        return np.asarray(nodes)
