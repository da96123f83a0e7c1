"""Input and predictions of methods of the track steering.

    class MyPolicy:
        name, track = "my_policy", "steering"

        def run(self, views):
            for view in views:
                yield Steering(view.name, yaw_probability=..., pitch_probability=...)

A method receives views one by one and never the ground truth, and gives a command for each before it takes the next: in
a closed loop, the next view is what the vehicle sees after it has executed the command. `views.task` has the classes.
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
    """A view of a rollout. name: unique within it; pixels: (H, W, 3) uint8 RGB of the front camera; time_s: time since
    the first view."""

    name: str
    pixels: NDArray[np.uint8]
    state: VehicleState
    time_s: float


@dataclass(frozen=True)
class Steering:
    """The command for a view: classes, or a probability for each class, of which the most probable is taken. A class
    given beside probabilities must be a most probable one.

    yaw, pitch:             class numbers, from 0, in the order of the task
    yaw_probability:        (Y,) float, none negative, not all 0; they need not add up to 1
    pitch_probability:      (P,) float, likewise
    """

    name: str
    yaw: int | None = None
    pitch: int | None = None
    yaw_probability: NDArray[np.floating[Any]] | None = None
    pitch_probability: NDArray[np.floating[Any]] | None = None


class Views(Protocol):
    """The views of a rollout, and its steering task."""

    task: SteeringRecipe

    def __iter__(self) -> Iterator[View]: ...


class SteeringMethod(Protocol):
    """A method of the track steering. A method that draws random numbers also has the attribute `seed`."""

    name: str
    track: str

    def run(self, views: Views) -> Iterable[Steering]:
        """Return a command for each view, before the next one is taken."""
        ...
