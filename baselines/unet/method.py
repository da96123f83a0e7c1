"""The methods: pictures in, where oysters are out, and which."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

from oysterbench.methods.images import Detections, Picture, Segmentation
from oysterbench_baselines.learning.trained import checkpoint_path, on_torch, trained

if TYPE_CHECKING:
    from oysterbench_baselines.learning.masks import MaskModel


class UNet:
    """Where oysters are, as probabilities, by a trained network.

    checkpoint: path of the training; by default that which `OYSTERBENCH_UNET` names, or which `oysterbench train unet`
    or `oysterbench download unet` left. device: auto, cpu, cuda or cuda:N.
    """

    name, track = "unet", "segmentation"

    def __init__(self, checkpoint: str = "", device: str = "auto") -> None:
        self.checkpoint, self.device = checkpoint, device

    @property
    def weights(self) -> dict[str, Path]:
        """Files of trained weights that it runs on."""
        return {"unet": checkpoint_path("unet", self.checkpoint)}

    def run(self, images: Iterable[Picture]) -> Iterator[Segmentation]:
        """Probabilities at the pictures' own size."""
        model = load_model(self.checkpoint, self.device)
        from oysterbench_baselines.learning.masks import probability

        for image in images:
            yield Segmentation(image.name, probability=probability(model.logits(image.pixels)[0]))


class UNetInstances(UNet):
    """Oysters one by one: what the same network says, divided at the cores of oysters."""

    name, track = "unet_instances", "detection"

    def run(self, images: Iterable[Picture]) -> Iterator[Any]:
        """Masks that do not overlap, and how sure each is."""
        model = load_model(self.checkpoint, self.device)
        from oysterbench_baselines.learning.masks import probability
        from oysterbench_baselines.unet.instances import find_instances

        for image in images:
            found = find_instances(*probability(model.logits(image.pixels)))
            yield Detections(image.name, found.scores, numbers=found.labels)


def load_model(checkpoint: str, device: str) -> MaskModel:
    """The trained network. Raises MethodError, with what to type, where there is none."""
    path = trained("unet", checkpoint)
    with on_torch("unet"):
        from oysterbench_baselines.learning.loop import pick_device
        from oysterbench_baselines.unet.model import read_unet
    return read_unet(path, pick_device(device))
