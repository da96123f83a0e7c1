"""The methods: pictures in, where oysters are out, and which."""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

from oysterbench.core.errors import MethodError
from oysterbench.core.files import home
from oysterbench.methods.images import Detections, Picture, Segmentation

if TYPE_CHECKING:
    from oysterbench_baselines.unet.model import Model

CHECKPOINT = "OYSTERBENCH_UNET"
"""Environment variable that names the checkpoint."""


class UNet:
    """Where oysters are, as probabilities, by a network that was trained on this machine.

    checkpoint: path of the training; by default that which `OYSTERBENCH_UNET` names, or which `oysterbench train unet`
    left. device: auto, cpu, cuda or cuda:N.
    """

    name, track = "unet", "segmentation"

    def __init__(self, checkpoint: str = "", device: str = "auto") -> None:
        self.checkpoint, self.device = checkpoint, device

    def run(self, images: Iterable[Picture]) -> Iterator[Segmentation]:
        """Probabilities at the pictures' own size."""
        model = load_model(self.checkpoint, self.device)
        from oysterbench_baselines.unet.model import probability

        for image in images:
            yield Segmentation(image.name, probability=probability(model.logits(image.pixels)[0]))


class UNetInstances(UNet):
    """Oysters one by one: what the same network says, divided at the cores of oysters."""

    name, track = "unet_instances", "detection"

    def run(self, images: Iterable[Picture]) -> Iterator[Any]:
        """Masks that do not overlap, and how sure each is."""
        model = load_model(self.checkpoint, self.device)
        from oysterbench_baselines.unet.instances import find_instances
        from oysterbench_baselines.unet.model import probability

        for image in images:
            found = find_instances(*probability(model.logits(image.pixels)))
            yield Detections(image.name, found.scores, numbers=found.labels)


def default_checkpoint() -> Path:
    """Where `oysterbench train unet` leaves its checkpoint, and where the method looks for it."""
    return Path(os.environ.get(CHECKPOINT) or home() / "models" / "unet.pt")


def load_model(checkpoint: str, device: str) -> Model:
    """The trained network. Raises MethodError, with what to type, where there is none."""
    path = Path(checkpoint) if checkpoint else default_checkpoint()
    if not path.is_file():
        raise MethodError(
            f"unet: no checkpoint at {path}: it is trained on your machine, by `oysterbench train unet --data "
            f"seg-train`; one elsewhere is named by unet[checkpoint=PATH] or by {CHECKPOINT}"
        )
    try:
        from oysterbench_baselines.learning.loop import pick_device
        from oysterbench_baselines.unet.model import Model
    except ModuleNotFoundError as error:
        raise MethodError(f"unet: {error}; it runs on PyTorch: pip install 'oysterbench[learn]'") from None

    return Model.read(path, pick_device(device))
