"""The methods: pictures in, where oysters are out, and which."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

from oysterbench.core.errors import MethodError
from oysterbench.methods.images import Detections, Picture, Segmentation
from oysterbench_baselines.learning.trained import checkpoint_path, on_torch, trained

if TYPE_CHECKING:
    from oysterbench_baselines.unet.model import UNetModel

DEFAULT_VIEWS = 2
"""Of a picture: all four take twice the time and gain nothing."""


class UNet:
    """Where oysters are, as probabilities, by a trained network on a pretrained encoder.

    checkpoint: path of the training; by default that which `OYSTERBENCH_UNET` names, or which `oysterbench train unet`
    or `oysterbench download unet` left. device: auto, cpu, cuda or cuda:N. views: of a picture, of which the mean is
    taken: 1 as it is; 2 enlarged and turned as well, or only that, by more, where oysters are small; 3 and 4 mirrored
    as well.
    """

    name, track = "unet", "segmentation"
    weights_name = "unet"

    def __init__(self, checkpoint: str = "", device: str = "auto", views: int = DEFAULT_VIEWS) -> None:
        if not 1 <= views <= 4:
            raise MethodError(f"{self.name}: views: expected 1 to 4, got {views}")
        self.checkpoint, self.device, self.views = checkpoint, device, views

    @property
    def weights(self) -> dict[str, Path]:
        """Files of trained weights that it runs on."""
        return {self.weights_name: checkpoint_path(self.weights_name, self.checkpoint)}

    def run(self, images: Iterable[Picture]) -> Iterator[Any]:
        """Probabilities at the pictures' own size, 0.5 being where IoU is greatest, and how novel the pictures are."""
        model = self._model()
        for image in images:
            seen = model.probabilities(image.pixels)
            yield Segmentation(image.name, probability=seen.oyster, novelty=model.novelty_of(image.pixels))

    def _model(self) -> UNetModel:
        """The trained network. Raises MethodError, with what to type, where there is none."""
        path = trained(self.weights_name, self.checkpoint)
        with on_torch(self.name):
            from oysterbench_baselines.learning.loop import pick_device
            from oysterbench_baselines.unet.model import read_unet
        return read_unet(path, pick_device(self.device), self.views, self.weights_name)


class UNetInstances(UNet):
    """Oysters one by one: what the same network says, divided by how deep in an oyster each pixel lies."""

    name, track = "unet_instances", "detection"

    def run(self, images: Iterable[Picture]) -> Iterator[Any]:
        """Masks that do not overlap, how sure each is, whether it is alive, where that can be told, and how novel the
        pictures are."""
        model = self._model()
        from oysterbench_baselines.unet.instances import find_instances, means

        for image in images:
            seen = model.probabilities(image.pixels)
            found = find_instances(seen.oyster, seen.depth, seen.division)
            live = None if seen.live is None else means(found, seen.live)
            novelty = model.novelty_of(image.pixels)
            yield Detections(image.name, found.scores, numbers=found.labels, live=live, novelty=novelty)


class UNetSmall(UNet):
    """Where oysters are, by the small network that begins with random weights (`oysterbench train unet_small`)."""

    name = weights_name = "unet_small"


class UNetSmallInstances(UNetInstances):
    """Oysters one by one, by the small network."""

    name, weights_name = "unet_small_instances", "unet_small"
