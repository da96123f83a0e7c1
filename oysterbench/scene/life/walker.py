"""Crabs, which walk sideways over the bottom with rests."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from oysterbench.core.geometry import Array
from oysterbench.scene.life.course import Course
from oysterbench.scene.life.crab import PHASES, STRIDE
from oysterbench.scene.life.ground import Ground
from oysterbench.scene.life.states import State

REACH = 0.35  # distance from the centre at which the feet touch the ground, relative to the width


@dataclass(frozen=True)
class Crab:
    """Crab of width `width_m` that walks along a course over the ground."""

    colours: Array
    course: Course
    width_m: float
    ground: Ground
    class_name: str = "crab"
    kind: str = "blue crab"

    @property
    def ids(self) -> NDArray[np.int64]:
        return np.zeros(1, dtype=np.int64)

    def at(self, time_s: float) -> State:
        way = self.course.way(np.array([time_s]))
        place, along = self.course.at(way)[0], self.course.heading(way)[0]
        reach = REACH * self.width_m
        ahead = np.array([along[1], -along[0]])  # its left side goes first
        feet = place + reach * np.array([ahead, -ahead, along, -along])
        heights = self.ground.foothold(feet[:, 0], feet[:, 1])
        slope = np.array([heights[0] - heights[1], heights[2] - heights[3]]) / (2 * reach)
        x = np.array([*ahead, slope[0]])
        y = np.array([*along, slope[1]])
        x /= np.linalg.norm(x)
        z = np.cross(x, y)
        z /= np.linalg.norm(z)
        rotation = np.column_stack([x, np.cross(z, x), z])
        position = np.array([[*place, max(heights.mean(), float(self.ground.foothold(*place)))]])
        form = int(PHASES * ((way[0] / (STRIDE * self.width_m)) % 1.0)) % PHASES
        return State(np.array([form]), position, rotation[None], np.full((1, 3), self.width_m))
