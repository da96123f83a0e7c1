"""The methods: from images to masks, without training."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import asdict, dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from oysterbench.methods.images import Picture, Segmentation

WIDEST = 640
"""Maximum width, px, as in most splits: the time to blur over a share of the width grows with its cube or faster."""


class All:
    """Labels every pixel as oyster: the score that a reef's cover alone gives."""

    name, track = "all", "segmentation"

    def run(self, images: Iterable[Picture]) -> Iterator[Segmentation]:
        """Yield full masks."""
        for image in images:
            yield Segmentation(image.name, oyster=np.ones(image.pixels.shape[:2], dtype=bool))


class Nothing:
    """Labels no pixel as oyster."""

    name, track = "none", "segmentation"

    def run(self, images: Iterable[Picture]) -> Iterator[Segmentation]:
        """Yield empty masks."""
        for image in images:
            yield Segmentation(image.name, oyster=np.zeros(image.pixels.shape[:2], dtype=bool))


@dataclass(frozen=True)
class ColourSettings:
    """Settings of `Colour`. surround: sigma, as a share of the image's width, over which the light of water and lamps
    is taken to be even, and the bottom to have one colour; smooth: sigma, likewise, of the patches classified as
    oyster; times: colour difference, in multiples of its mean, at which the probability is 0.5; steepness: of the
    probability over such multiples. Chosen on seg-mini.
    """

    surround: float = 0.15
    smooth: float = 0.035
    times: float = 1.15
    steepness: float = 3.0


class Colour:
    """Labels as oyster what differs in colour from its surroundings: shell over sediment, whichever is lighter."""

    name, track = "colour", "segmentation"

    def __init__(self, settings: ColourSettings | None = None) -> None:
        self.settings = settings or ColourSettings()

    def as_dict(self) -> dict[str, Any]:
        """The settings, for the record."""
        return asdict(self.settings)

    def run(self, images: Iterable[Picture]) -> Iterator[Segmentation]:
        """Yield probabilities."""
        for image in images:
            yield Segmentation(image.name, probability=probability(image.pixels, self.settings))


def probability(pixels: NDArray[np.uint8], settings: ColourSettings) -> NDArray[np.float32]:
    """Probability of oyster (H, W) for an image (H, W, 3) uint8 RGB: a logistic function of the colour difference."""
    steps = settings.steepness * (colour_difference(pixels, settings) - settings.times)
    return np.asarray(1 / (1 + np.exp(-steps)), dtype=np.float32)


def colour_difference(pixels: NDArray[np.uint8], settings: ColourSettings) -> NDArray[np.float32]:
    """Colour difference (H, W): distance in CIE L*a*b* (1976) between each pixel and its surround, smoothed and divided
    by its mean over the image; 0 for an image of one colour. Images wider than `WIDEST` are reduced to it first."""
    height, width = pixels.shape[:2]
    if width > WIDEST:
        size = (WIDEST, max(1, round(height * WIDEST / width)))
        small = colour_difference(
            np.asarray(cv2.resize(pixels, size, interpolation=cv2.INTER_AREA), np.uint8), settings
        )
        return np.asarray(cv2.resize(small, (width, height), interpolation=cv2.INTER_LINEAR), dtype=np.float32)
    lab = cv2.cvtColor(pixels.astype(np.float32) / np.float32(255), cv2.COLOR_RGB2LAB)
    surround = cv2.GaussianBlur(lab, (0, 0), settings.surround * width)
    distance = cv2.GaussianBlur(np.linalg.norm(lab - surround, axis=2), (0, 0), settings.smooth * width)
    return np.asarray(distance / max(float(distance.mean()), 1e-3), dtype=np.float32)
