"""The method: pictures in, where oysters are and which out."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING

from oysterbench.errors import MethodError
from oysterbench.files import home

if TYPE_CHECKING:
    from oysterbench_baselines.unet.model import Model

CHECKPOINT = "OYSTERBENCH_UNET"
"""Environment variable that names the checkpoint."""


def default_checkpoint() -> Path:
    """Where `oysterbench train unet` leaves its checkpoint, and where the method looks for it."""
    return Path(os.environ.get(CHECKPOINT) or home() / "models" / "unet.pt")


def load_model(checkpoint: str = "", device: str = "auto") -> Model:
    """The trained network. Raises MethodError, with what to type, where there is none."""
    path = Path(checkpoint) if checkpoint else default_checkpoint()
    if not path.is_file():
        raise MethodError(
            f"unet: no checkpoint at {path}: it is trained on your machine, by `oysterbench train unet --data "
            f"seg-train`; one elsewhere is named by the option checkpoint or by {CHECKPOINT}"
        )
    from oysterbench_baselines.learning.loop import pick_device
    from oysterbench_baselines.unet.model import Model

    return Model.read(path, pick_device(device))
