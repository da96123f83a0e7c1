"""A trained network and its commands for views."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from oysterbench.core.errors import MethodError
from oysterbench.methods.steering import VehicleState
from oysterbench.recipe import SteeringRecipe
from oysterbench_baselines.learning.checkpoint import Checkpoint, read_finished
from oysterbench_baselines.learning.loop import channels_last
from oysterbench_baselines.learning.samples import standardised, statistics
from oysterbench_baselines.steering.examples import Floats, TrainingExamples, check_classes, senses_of, small
from oysterbench_baselines.steering.network import SteeringNetwork, SteeringNetworkSettings

AT_ONCE = 64
"""Number of views in a batch, where there are many."""


@dataclass
class SteeringModel:
    """A network with its weights, ready to predict. yaw_deg, pitch_deg: angles of its classes."""

    network: SteeringNetwork
    settings: SteeringNetworkSettings
    yaw_deg: tuple[float, ...]
    pitch_deg: tuple[float, ...]

    @classmethod
    def of(cls, checkpoint: Checkpoint) -> SteeringModel:
        """Build the model from a checkpoint. Raises MethodError where that is of another network."""
        known = dict(checkpoint.network)
        if known.pop("kind", None) != "steering":
            found = checkpoint.network.get("kind")
            raise MethodError(f"expected the checkpoint of `oysterbench train steering`, got one of {found!r}")
        yaw, pitch = tuple(known.pop("yaw_deg")), tuple(known.pop("pitch_deg"))
        settings = SteeringNetworkSettings(**{**known, "channels": tuple(known["channels"])})
        network = SteeringNetwork(settings, len(yaw), len(pitch))
        network.load_state_dict(checkpoint.weights)
        return cls(channels_last(network).eval(), settings, yaw, pitch)

    @classmethod
    def read(cls, path: Path) -> SteeringModel:
        """Read the model from a file. Raises MethodError where it is of another or an unfinished training."""
        return cls.of(read_finished(path))

    def check(self, task: SteeringRecipe) -> None:
        """Raise MethodError where a task has other classes than the training."""
        check_classes(task, self.yaw_deg, self.pitch_deg, "this task")

    def probabilities(
        self, pixels: NDArray[np.uint8], state: VehicleState, looked: NDArray[np.uint8], task: SteeringRecipe
    ) -> tuple[Floats, Floats]:
        """Probabilities (Y,) and (P,) of the classes for an image (H, W, 3) uint8 RGB. looked: map of `Memory`."""
        shown = small(pixels, self.settings)
        yaw, pitch = self._probabilities(shown[None], senses_of(state, task)[None], looked[None])
        return yaw[0], pitch[0]

    def predictions(self, examples: TrainingExamples) -> tuple[Floats, Floats]:
        """Probabilities (N, Y) and (N, P) of the classes for the images of examples."""
        self.check(examples.task)
        parts = [
            self._probabilities(examples.pixels[chosen], examples.senses[chosen], examples.looked[chosen])
            for chosen in _parts(len(examples))
        ]
        yaw, pitch = (np.concatenate(part) for part in zip(*parts, strict=True))
        return yaw, pitch

    def _probabilities(
        self, pixels: NDArray[np.uint8], senses: Floats, looked: NDArray[np.uint8]
    ) -> tuple[Floats, Floats]:
        """Probabilities averaged over images and their mirror images, where the classes are symmetric, so that neither
        side of the reef is preferred."""
        values = torch.from_numpy(np.stack([as_planes(one) for one in pixels]))
        told = torch.from_numpy(senses)
        seen = torch.from_numpy(looked.astype(np.float32))[:, None]
        with torch.inference_mode():
            yaw, pitch = self.network(values.contiguous(memory_format=torch.channels_last), told, seen)
            yaw, pitch = yaw.softmax(1), pitch.softmax(1)
            if is_symmetric(self.yaw_deg):
                mirrored = values.flip(3).contiguous(memory_format=torch.channels_last)
                other_yaw, other_pitch = self.network(mirrored, told, seen.flip(3))
                yaw = (yaw + other_yaw.softmax(1).flip(1)) / 2
                pitch = (pitch + other_pitch.softmax(1)) / 2
        return yaw.numpy(), pitch.numpy()


def described(settings: SteeringNetworkSettings, task: SteeringRecipe) -> dict[str, Any]:
    """Description of the network in a checkpoint."""
    plain = {**asdict(settings), "channels": list(settings.channels)}
    return {"kind": "steering", **plain, "yaw_deg": list(task.yaw_deg), "pitch_deg": list(task.pitch_deg)}


def as_planes(pixels: NDArray[np.uint8]) -> Floats:
    """Convert an image (h, w, 3) to planes (3, h, w), standardised by its own mean and contrast, which removes the
    effect of water and exposure."""
    return np.ascontiguousarray(standardised(pixels, *statistics(pixels)).transpose(2, 0, 1))


def is_symmetric(yaw_deg: tuple[float, ...]) -> bool:
    """Whether each turn to the left has its counterpart to the right: only then may an image be mirrored."""
    return all(a == -b for a, b in zip(yaw_deg, reversed(yaw_deg), strict=True))


def _parts(count: int) -> Iterator[slice]:
    for begin in range(0, count, AT_ONCE):
        yield slice(begin, begin + AT_ONCE)
