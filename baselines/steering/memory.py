"""Map of where the vehicle has already looked, by dead reckoning: what no single image can tell."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from oysterbench.core.geometry import Array
from oysterbench.methods.steering import VehicleState
from oysterbench.recipe import SteeringRecipe

CELL_M = 0.75
AHEAD, BEHIND, ASIDE = 8, 4, 6
"""Cells of the map ahead of the vehicle, behind it, and to each side."""
SHAPE = (AHEAD + BEHIND, 2 * ASIDE)
HALF_VIEW = np.radians(40.0)
"""Half the width of the area looked at, rad."""


class Memory:
    """Record of what was looked at, which grows with every view. The vehicle is assumed to move at the task's speed in
    the direction of its bow, known from compass and tilt; anything that diverts it, such as a fence, is not known."""

    def __init__(self, task: SteeringRecipe) -> None:
        self.task = task
        self._looks: list[tuple[float, float, float, float]] = []
        self._last: tuple[VehicleState, float] | None = None
        self._place = np.zeros(2)
        rows = (AHEAD - 0.5 - np.arange(SHAPE[0])) * CELL_M
        columns = (ASIDE - 0.5 - np.arange(SHAPE[1])) * CELL_M
        self._cells = np.stack(np.meshgrid(rows, columns, indexing="ij"), axis=-1).reshape(-1, 2)

    def observe(self, state: VehicleState, time_s: float) -> NDArray[np.uint8]:
        """Add a view, and return the map (SHAPE) uint8: 1 where the bottom has been near in an image, this one
        included. Rows run from ahead to astern, columns from left to right; the vehicle is between the two middle
        columns, `AHEAD` rows from the top. time_s: from any origin."""
        if self._last is not None:
            before, then = self._last
            self._place = self._place + _way(before, state, self.task.speed_m_s * (time_s - then))
        self._last = state, time_s
        near = float(np.sqrt(max(self.task.view_range_m**2 - state.altitude**2, 0.0)))
        self._looks.append((float(self._place[0]), float(self._place[1]), state.heading, near))
        return self._map(state.heading)

    def _map(self, heading: float) -> NDArray[np.uint8]:
        looks = np.array(self._looks)
        cells = self._place + self._cells @ _axes(heading)  # (C, 2)
        away = cells[:, None] - looks[None, :, :2]
        bearing = np.arctan2(away[..., 1], away[..., 0]) - looks[:, 2]
        aside = np.abs(np.remainder(bearing + np.pi, 2 * np.pi) - np.pi)
        seen = (aside <= HALF_VIEW) & (np.linalg.norm(away, axis=-1) <= looks[:, 3])
        return np.asarray(seen.any(axis=1).reshape(SHAPE), dtype=np.uint8)


def _axes(heading: float) -> Array:
    """Axes (2, 2) of the vehicle in the plane of the map: rows are ahead and left."""
    return np.array([[np.cos(heading), np.sin(heading)], [-np.sin(heading), np.cos(heading)]])


def _way(before: VehicleState, after: VehicleState, length: float) -> Array:
    """Displacement over the ground (2,) m along an arc between two states. length: of the arc, m."""
    turn = np.remainder(after.heading - before.heading + np.pi, 2 * np.pi) - np.pi
    heading = before.heading + turn / 2
    level = np.cos((before.pitch + after.pitch) / 2)
    return np.asarray(length * level * np.array([np.cos(heading), np.sin(heading)]))
