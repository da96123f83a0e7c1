"""The methods: pictures in, masks out, with nothing learnt."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import asdict, dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from oysterbench.methods.images import Picture, Segmentation

WIDEST = 640
"""px, as in most splits: blurring over a share of the width takes a time that grows with the cube of it or more."""


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
class ColourSettings:
    """surround: of the picture's width, the sigma over which the water's and the lamps' light is taken to be even, and
    the bottom of one colour; smooth: the same, of the patches that are called oyster; times: the mean colour difference
    at which the probability is a half; steepness: of the probability over mean colour differences. Chosen on seg-mini.
    """

    surround: float = 0.15
    smooth: float = 0.035
    times: float = 1.15
    steepness: float = 3.0


class Colour:
    """What has another colour than its surroundings: shell over sediment, whichever is lighter."""

    name, track = "colour", "segmentation"

    def __init__(self, settings: ColourSettings | None = None) -> None:
        self.settings = settings or ColourSettings()

    def as_dict(self) -> dict[str, Any]:
        """The settings, for the record."""
        return asdict(self.settings)

    def run(self, images: Iterable[Picture]) -> Iterator[Segmentation]:
        """Probabilities."""
        for image in images:
            yield Segmentation(image.name, probability=probability(image.pixels, self.settings))


def probability(pixels: NDArray[np.uint8], settings: ColourSettings) -> NDArray[np.float32]:
    """(H, W) of a picture (H, W, 3) uint8 RGB: a logistic function of the colour difference."""
    steps = settings.steepness * (colour_difference(pixels, settings) - settings.times)
    return np.asarray(1 / (1 + np.exp(-steps)), dtype=np.float32)


def colour_difference(pixels: NDArray[np.uint8], settings: ColourSettings) -> NDArray[np.float32]:
    """(H, W): distance in CIE L*a*b* (1976) of each pixel's colour from its surround's, smoothed, by the picture's
    mean; 0 where the picture is of one colour. Pictures wider than `WIDEST` are reduced to it first."""
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
