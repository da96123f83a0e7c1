"""The methods: from images to masks of oysters, or to instances."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

from oysterbench.core.errors import MethodError
from oysterbench.methods.images import Detections, Picture, Segmentation
from oysterbench_baselines.learning.trained import on_torch, trained, used_path

if TYPE_CHECKING:
    from oysterbench_baselines.unet.model import UNetModel

DEFAULT_VIEWS = 2
"""Default number of views of an image: all four take twice the time and gain nothing."""


class UNet:
    """Probability of oyster for each pixel, from a trained network with a pretrained encoder.

    checkpoint: path of the checkpoint; by default the one that `OYSTERBENCH_UNET` names, or that `oysterbench train
    unet` or `oysterbench download unet` left. device: auto, cpu, cuda or cuda:N. views: number of views of an image
    that are averaged: 1, the image as it is; 2, also enlarged and rotated, or only that, enlarged further, where
    oysters are small; 3 and 4, also mirrored. Raises MethodError for another number of views.
    """

    name, track = "unet", "segmentation"
    weights_name = "unet"

    def __init__(self, checkpoint: str = "", device: str = "auto", views: int = DEFAULT_VIEWS) -> None:
        if not 1 <= views <= 4:
            raise MethodError(f"{self.name}: views: expected 1 to 4, got {views}")
        self.checkpoint, self.device, self.views = checkpoint, device, views

    @property
    def weights(self) -> dict[str, Path]:
        """Files of the trained weights that the method needs."""
        return {self.weights_name: used_path(self.weights_name, self.checkpoint)}

    def run(self, images: Iterable[Picture]) -> Iterator[Any]:
        """Yield probabilities at the images' own size, with the threshold of greatest IoU at 0.5, and the novelty of
        each image."""
        model = self._model()
        for image in images:
            seen = model.probabilities(image.pixels)
            yield Segmentation(image.name, probability=seen.oyster, novelty=model.novelty_of(image.pixels))

    def _model(self) -> UNetModel:
        """Load the trained network. Raises MethodError, which says what to type, where there is none."""
        path = trained(self.weights_name, self.checkpoint)
        with on_torch(self.name):
            from oysterbench_baselines.learning.loop import pick_device
            from oysterbench_baselines.unet.model import read_unet
        return read_unet(path, pick_device(self.device), self.views, self.weights_name)


class UNetInstances(UNet):
    """Instances of oysters: the same network's mask, divided by the depth of each pixel inside an oyster."""

    name, track = "unet_instances", "detection"

    def run(self, images: Iterable[Picture]) -> Iterator[Any]:
        """Yield masks that do not overlap, their scores, the probability of being alive where that can be told, and the
        novelty of each image."""
        model = self._model()
        from oysterbench_baselines.unet.instances import find_instances, means

        for image in images:
            seen = model.probabilities(image.pixels)
            found = find_instances(seen.oyster, seen.depth, seen.division)
            live = None if seen.live is None else means(found, seen.live)
            novelty = model.novelty_of(image.pixels)
            yield Detections(image.name, found.scores, numbers=found.labels, live=live, novelty=novelty)


class UNetSmall(UNet):
    """Probability of oyster from the small network trained from random weights (`oysterbench train unet_small`)."""

    name = weights_name = "unet_small"


class UNetSmallInstances(UNetInstances):
    """Instances of oysters from the small network."""

    name, weights_name = "unet_small_instances", "unet_small"
