"""What a method of the tracks segmentation and detection is given, and what it predicts.

    class MyNet:
        name, track = "my_net", "segmentation"

        def run(self, images):
            for image in images:
                yield Segmentation(image.name, probability=self.net(image.pixels))

It is given the pictures of a clip one by one and never the truth, and predicts in the same order. It may read ahead, to
make batches; what it reads ahead is what is kept in memory. A method of the track segmentation may take part in the
track detection as well: what hangs together in its masks is then taken for one oyster.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class Picture:
    """name: unlike that of any other picture of the clip; pixels: (H, W, 3) uint8 RGB."""

    name: str
    pixels: NDArray[np.uint8]


@dataclass(frozen=True)
class Segmentation:
    """What is predicted for the pixels of a picture, one of three, at its size.

    oyster:      (H, W) bool, where there is an oyster
    probability: (H, W) float from 0 to 1, that there is one; bring logits to the picture's size before the sigmoid
    classes:     (H, W) uint8, numbers of `recipe.CLASSES`
    novelty:     how unlike the pictures are that the method has learnt from; above 1 it should not be relied upon
    """

    name: str
    oyster: NDArray[np.bool_] | None = None
    probability: NDArray[np.floating[Any]] | None = None
    classes: NDArray[np.uint8] | None = None
    novelty: float | None = None


@dataclass(frozen=True)
class Detections:
    """The oysters of a picture: their scores (N,), greater is surer, counted from 0.5 on; and one of three.

    numbers: (H, W) integers, k + 1 where oyster k is seen, 0 for none
    masks:   (N, H, W) bool, which may overlap
    boxes:   (N, 4) x, y, width, height in px, where there are no masks
    live:    (N,) probability that the oyster is alive, where the method can tell
    novelty: as of a `Segmentation`
    """

    name: str
    scores: NDArray[np.floating[Any]]
    numbers: NDArray[np.integer[Any]] | None = None
    masks: NDArray[np.bool_] | None = None
    boxes: NDArray[np.floating[Any]] | None = None
    live: NDArray[np.floating[Any]] | None = None
    novelty: float | None = None


class SegmentationMethod(Protocol):
    """A method of the track segmentation. One that draws random numbers also has the attribute `seed`."""

    name: str
    track: str

    def run(self, images: Iterable[Picture]) -> Iterable[Segmentation]:
        """A prediction for each picture, in the order in which they are given."""
        ...


class DetectionMethod(Protocol):
    """A method of the track detection. One that draws random numbers also has the attribute `seed`."""

    name: str
    track: str

    def run(self, images: Iterable[Picture]) -> Iterable[Detections]:
        """A prediction for each picture, in the order in which they are given."""
        ...
