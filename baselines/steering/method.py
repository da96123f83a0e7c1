"""The method: from a view to the probability of each command."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

from oysterbench.methods.steering import Steering, Views
from oysterbench_baselines.learning.trained import on_torch, trained, used_path
from oysterbench_baselines.steering.memory import Memory

if TYPE_CHECKING:
    from oysterbench_baselines.steering.model import SteeringModel


class SteeringNet:
    """Steers by a network trained on what an expert would do.

    checkpoint: path of the checkpoint; by default the one that `OYSTERBENCH_STEERING` names, or that `oysterbench train
    steering` or `oysterbench download steering` left. threads: of the CPU.
    """

    name, track = "steering", "steering"

    def __init__(self, checkpoint: str = "", threads: int = 1) -> None:
        self.checkpoint, self.threads = checkpoint, threads

    @property
    def weights(self) -> dict[str, Path]:
        """Files of the trained weights that the method needs."""
        return {"steering": used_path("steering", self.checkpoint)}

    def run(self, views: Views) -> Iterator[Steering]:
        """Yield a command for each view, before the next one is taken. Raises MethodError where the task has other
        classes than the training."""
        model = load_model(self.checkpoint, self.threads)
        model.check(views.task)
        memory = Memory(views.task)
        for view in views:
            looked = memory.observe(view.state, view.time_s)
            yaw, pitch = model.probabilities(view.pixels, view.state, looked, views.task)
            yield Steering(view.name, yaw_probability=yaw, pitch_probability=pitch)


def load_model(checkpoint: str, threads: int) -> SteeringModel:
    """Load the trained network. Raises MethodError, which says what to type, where there is none."""
    path = trained("steering", checkpoint)
    with on_torch("steering"):
        import torch

        from oysterbench_baselines.steering.model import SteeringModel
    torch.set_num_threads(threads)
    return SteeringModel.read(path)
