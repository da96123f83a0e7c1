"""The method: a view in, how probable each command is out."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

from oysterbench.core.errors import MethodError
from oysterbench.core.files import home
from oysterbench.methods.steering import Steering, Views
from oysterbench_baselines.steering.memory import Memory

if TYPE_CHECKING:
    from oysterbench_baselines.steering.model import Model

CHECKPOINT = "OYSTERBENCH_STEERING"
"""Environment variable that names the checkpoint."""


class SteeringNet:
    """Steers by a network that learnt on this machine what an expert would do.

    checkpoint: path of the training; by default that which `OYSTERBENCH_STEERING` names, or which `oysterbench train
    steering` left. threads: of the processor.
    """

    name, track = "steering", "steering"

    def __init__(self, checkpoint: str = "", threads: int = 1) -> None:
        self.checkpoint, self.threads = checkpoint, threads

    def as_dict(self) -> dict[str, str]:
        """What results say of it, and what tells its dives from those of another training: SHA-256 of the checkpoint;
        empty where there is none."""
        path = checkpoint_path(self.checkpoint)
        return {"checkpoint_sha256": hashlib.sha256(path.read_bytes()).hexdigest() if path.is_file() else ""}

    def run(self, dive: Views) -> Iterator[Steering]:
        """An answer to each view, before the next one is taken."""
        model = load_model(self.checkpoint, self.threads)
        model.check(dive.task)
        memory = Memory(dive.task)
        for view in dive:
            looked = memory.look(view.state, view.time_s)
            yaw, pitch = model.probabilities(view.pixels, view.state, looked, dive.task)
            yield Steering(view.name, yaw_probability=yaw, pitch_probability=pitch)


def default_checkpoint() -> Path:
    """Where `oysterbench train steering` leaves its checkpoint, and where the method looks for it."""
    return Path(os.environ.get(CHECKPOINT) or home() / "models" / "steering.pt")


def checkpoint_path(checkpoint: str) -> Path:
    """Of the training that is meant."""
    return Path(checkpoint) if checkpoint else default_checkpoint()


def load_model(checkpoint: str, threads: int) -> Model:
    """The trained network. Raises MethodError, with what to type, where there is none."""
    path = checkpoint_path(checkpoint)
    if not path.is_file():
        raise MethodError(
            f"steering: no trained weights at {path}: type `oysterbench train steering --data steer-train`; others are "
            f"named by steering[checkpoint=PATH] or by {CHECKPOINT}"
        )
    try:
        import torch

        from oysterbench_baselines.steering.model import Model
    except ModuleNotFoundError as error:
        raise MethodError(f"steering: {error}; it runs on PyTorch: pip install 'oysterbench[learn]'") from None

    torch.set_num_threads(threads)
    return Model.read(path)
