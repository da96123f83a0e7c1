"""The method: a view in, how probable each command is out."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

from oysterbench.methods.steering import Steering, Views
from oysterbench_baselines.learning.trained import checkpoint_path, on_torch, trained
from oysterbench_baselines.steering.memory import Memory

if TYPE_CHECKING:
    from oysterbench_baselines.steering.model import SteeringModel


class SteeringNet:
    """Steers by a network that has learnt what an expert would do.

    checkpoint: path of the training; by default that which `OYSTERBENCH_STEERING` names, or which `oysterbench train
    steering` or `oysterbench download steering` left. threads: of the processor.
    """

    name, track = "steering", "steering"

    def __init__(self, checkpoint: str = "", threads: int = 1) -> None:
        self.checkpoint, self.threads = checkpoint, threads

    @property
    def weights(self) -> dict[str, Path]:
        """Files of trained weights that it runs on."""
        return {"steering": checkpoint_path("steering", self.checkpoint)}

    def run(self, views: Views) -> Iterator[Steering]:
        """A command at each view, before the next one is taken."""
        model = load_model(self.checkpoint, self.threads)
        model.check(views.task)
        memory = Memory(views.task)
        for view in views:
            looked = memory.observe(view.state, view.time_s)
            yaw, pitch = model.probabilities(view.pixels, view.state, looked, views.task)
            yield Steering(view.name, yaw_probability=yaw, pitch_probability=pitch)


def load_model(checkpoint: str, threads: int) -> SteeringModel:
    """The trained network. Raises MethodError, with what to type, where there is none."""
    path = trained("steering", checkpoint)
    with on_torch("steering"):
        import torch

        from oysterbench_baselines.steering.model import SteeringModel
    torch.set_num_threads(threads)
    return SteeringModel.read(path)
