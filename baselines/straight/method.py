"""The methods: views in, commands out, without looking at them."""

from __future__ import annotations

from collections.abc import Iterator

from oysterbench.core.streams import stream
from oysterbench.methods.steering import Steering, Views


class Straight:
    """Always straight on, and neither up nor down: what a policy achieves that never turns."""

    name, track = "straight", "steering"

    def run(self, views: Views) -> Iterator[Steering]:
        """Yield the classes that turn by 0."""
        yaw, pitch = views.task.yaw_deg.index(0.0), views.task.pitch_deg.index(0.0)
        for view in views:
            yield Steering(view.name, yaw, pitch)


class Chance:
    """Commands drawn uniformly from all pairs of classes, each seeded by the name of its view."""

    name, track = "chance", "steering"

    def __init__(self, seed: int = 0) -> None:
        self.seed = seed

    def run(self, views: Views) -> Iterator[Steering]:
        """Yield random classes."""
        for view in views:
            generator = stream(self.seed, b"", "chance", view.name)
            yield Steering(
                view.name,
                int(generator.integers(len(views.task.yaw_deg))),
                int(generator.integers(len(views.task.pitch_deg))),
            )
