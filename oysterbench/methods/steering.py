"""What a method of the track steering is given, and what it predicts.

    class MyPolicy:
        name, track = "my_policy", "steering"

        def run(self, views):
            for view in views:
                yield Steering(view.name, yaw_probability=..., pitch_probability=...)

It is given views one by one and never the truth, and commands at each before it takes the next: in a closed loop the
next view is what the vehicle sees after it has done what was commanded. `views.task` has the classes.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from oysterbench.core.measurements import VehicleState as VehicleState
from oysterbench.recipe.steering import SteeringRecipe


@dataclass(frozen=True)
class View:
    """name: unlike that of any other view of the rollout; pixels: (H, W, 3) uint8 RGB of the front camera; time_s:
    since the first view."""

    name: str
    pixels: NDArray[np.uint8]
    state: VehicleState
    time_s: float


@dataclass(frozen=True)
class Steering:
    """The command at a view: classes, or how probable each class is, from which the likeliest is taken.

    yaw, pitch:             numbers of the classes, from 0, in the order of the task
    yaw_probability:        (Y,) float, at least 0, not all 0; they need not add up to 1
    pitch_probability:      (P,) float
    """

    name: str
    yaw: int | None = None
    pitch: int | None = None
    yaw_probability: NDArray[np.floating[Any]] | None = None
    pitch_probability: NDArray[np.floating[Any]] | None = None


class Views(Protocol):
    """The views of a rollout, and the task that is steered for."""

    task: SteeringRecipe

    def __iter__(self) -> Iterator[View]: ...


class SteeringMethod(Protocol):
    """A method of the track steering. One that draws random numbers also has the attribute `seed`."""

    name: str
    track: str

    def run(self, views: Views) -> Iterable[Steering]:
        """A command at each view, before the next one is taken."""
        ...
