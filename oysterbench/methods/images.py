"""Input and predictions of methods of the tracks segmentation and detection.

    class MyNet:
        name, track = "my_net", "segmentation"

        def run(self, images):
            for image in images:
                yield Segmentation(image.name, probability=self.net(image.pixels))

A method receives the images of a clip one by one and never the ground truth, and predicts in the same order. It may
read ahead to make batches; only what it reads ahead is kept in memory. A segmentation method may also take part in the
track detection: each connected component of its masks then counts as one oyster.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class Picture:
    """An image. name: unique within its clip; pixels: (H, W, 3) uint8 RGB."""

    name: str
    pixels: NDArray[np.uint8]


@dataclass(frozen=True)
class Segmentation:
    """Prediction for the pixels of an image, at the image's size: one of `oyster`, `probability` and `classes`.

    oyster:      (H, W) bool, where there is an oyster
    probability: (H, W) float from 0 to 1, that there is one; resize logits to the image before the sigmoid
    classes:     (H, W) uint8, numbers of `recipe.CLASSES`
    novelty:     how much the image differs from the training images; above 1 the prediction should not be relied upon
    """

    name: str
    oyster: NDArray[np.bool_] | None = None
    probability: NDArray[np.floating[Any]] | None = None
    classes: NDArray[np.uint8] | None = None
    novelty: float | None = None


@dataclass(frozen=True)
class Detections:
    """Predicted oysters of an image: their scores, and one of `numbers`, `masks` and `boxes`.

    scores:  (N,), higher is more certain; oysters with 0.5 or more are counted
    numbers: (H, W) integers, k + 1 where oyster k is seen, 0 elsewhere
    masks:   (N, H, W) bool, which may overlap
    boxes:   (N, 4) x, y, width, height in px, if there are no masks
    live:    (N,) probability that the oyster is alive, if the method can tell
    novelty: as for a `Segmentation`
    """

    name: str
    scores: NDArray[np.floating[Any]]
    numbers: NDArray[np.integer[Any]] | None = None
    masks: NDArray[np.bool_] | None = None
    boxes: NDArray[np.floating[Any]] | None = None
    live: NDArray[np.floating[Any]] | None = None
    novelty: float | None = None


class SegmentationMethod(Protocol):
    """A method of the track segmentation. A method that draws random numbers also has the attribute `seed`."""

    name: str
    track: str

    def run(self, images: Iterable[Picture]) -> Iterable[Segmentation]:
        """Return a prediction for each image, in the order in which they are given."""
        ...


class DetectionMethod(Protocol):
    """A method of the track detection. A method that draws random numbers also has the attribute `seed`."""

    name: str
    track: str

    def run(self, images: Iterable[Picture]) -> Iterable[Detections]:
        """Return a prediction for each image, in the order in which they are given."""
        ...
