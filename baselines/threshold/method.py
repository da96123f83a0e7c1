"""The methods: pictures in, masks out, with nothing learnt."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import asdict, dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from oysterbench.methods.images import Picture, Segmentation


class All:
    """Every pixel is an oyster's: what a reef's cover alone is worth."""

    name, track = "all", "segmentation"

    def run(self, images: Iterable[Picture]) -> Iterator[Segmentation]:
        """Masks of everything."""
        for image in images:
            yield Segmentation(image.name, oyster=np.ones(image.pixels.shape[:2], dtype=bool))


class Nothing:
    """No pixel is an oyster's."""

    name, track = "none", "segmentation"

    def run(self, images: Iterable[Picture]) -> Iterator[Segmentation]:
        """Empty masks."""
        for image in images:
            yield Segmentation(image.name, oyster=np.zeros(image.pixels.shape[:2], dtype=bool))


@dataclass(frozen=True)
class Settings:
    """surround: of the picture's width, the sigma over which the water's and the lamps' light is taken to be even;
    smooth: the same, of the patches that are called oyster; steepness: of the probability over standard deviations;
    offset: standard deviations above the surround at which it is a half."""

    surround: float = 0.15
    smooth: float = 0.008
    steepness: float = 2.0
    offset: float = 0.6


class Colour:
    """What is lighter than its surroundings: shell over sediment. A threshold on one colour, and nothing learnt."""

    name, track = "colour", "segmentation"

    def __init__(self, settings: Settings | None = None) -> None:
        self.settings = settings or Settings()

    def as_dict(self) -> dict[str, Any]:
        """The settings, for the record."""
        return asdict(self.settings)

    def run(self, images: Iterable[Picture]) -> Iterator[Segmentation]:
        """Probabilities."""
        for image in images:
            yield Segmentation(image.name, probability=self.probability(image.pixels))

    def probability(self, pixels: NDArray[np.uint8]) -> NDArray[np.float32]:
        """(H, W) of a picture (H, W, 3) uint8 RGB: a logistic function of how far it is above its surround."""
        return logistic(contrast(pixels, self.settings), self.settings)


def contrast(pixels: NDArray[np.uint8], settings: Settings) -> NDArray[np.float32]:
    """(H, W): lightness (CIE L*) above its surround, in standard deviations of the picture."""
    width = pixels.shape[1]
    light = cv2.cvtColor(pixels.astype(np.float32) / np.float32(255), cv2.COLOR_RGB2LAB)[..., 0]
    above = cv2.GaussianBlur(light, (0, 0), settings.smooth * width)
    above = above - cv2.GaussianBlur(light, (0, 0), settings.surround * width)
    return np.asarray(above / max(float(above.std()), 1e-3), dtype=np.float32)


def logistic(contrast: NDArray[np.float32], settings: Settings) -> NDArray[np.float32]:
    """(H, W) probabilities."""
    return np.asarray(1 / (1 + np.exp(-settings.steepness * (contrast - settings.offset))), dtype=np.float32)
