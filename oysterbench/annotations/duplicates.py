"""Leakage: images on one side of a split that are near-duplicates of images on the other."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from oysterbench.annotations.image import LabelledSet
from oysterbench.core.errors import LabelError

SIDE = 32
"""Side of the grey thumbnails that are compared, px: finer detail changes with water and noise between frames."""
BLUR = 3
"""Standard deviation, px, of the Gaussian that extracts the slow changes of brightness of a thumbnail."""
MIN_CORRELATION = 0.4
"""Correlation from which two images are taken to show the same place. Measured on 306 real images: between clips at
most 0.28, between neighbouring frames of a moving camera 0.35 to 0.85, for one image under two names 1.0."""


@dataclass(frozen=True)
class Duplicate:
    """An image of one set, and the image of another that shows the same place; correlation: 1 for identical images."""

    one: str
    other: str
    correlation: float


def fingerprint(pixels: NDArray[np.uint8]) -> NDArray[np.complex64]:
    """Spectrum (2 S, S + 1) of an image (H, W, 3), reduced to S = `SIDE` px, without slow changes of brightness, and
    normalised."""
    grey = cv2.cvtColor(pixels, cv2.COLOR_RGB2GRAY).astype(np.float32)
    small = cv2.resize(grey, (SIDE, SIDE), interpolation=cv2.INTER_AREA)
    detail = small - cv2.GaussianBlur(small, (0, 0), BLUR)
    detail = detail / (np.linalg.norm(detail) + 1e-6)
    return np.fft.rfft2(detail, (2 * SIDE, 2 * SIDE)).astype(np.complex64)


def near_duplicates(
    one: LabelledSet,
    other: LabelledSet,
    min_correlation: float = MIN_CORRELATION,
    progress: Callable[[int], None] = lambda done: None,
) -> list[Duplicate]:
    """For each image of `one`, find the most similar image of `other`, if correlated by at least `min_correlation`;
    best first.

    The images are correlated at `SIDE` px without their slow changes of brightness, at the best shift, so that the
    motion of a camera between two frames does not hide that they show the same place.
    """
    spectra = np.array([fingerprint(image.pixels) for image in other])
    found = []
    for k, image in enumerate(one):
        scores = np.fft.irfft2(fingerprint(image.pixels) * spectra.conj()).max(axis=(1, 2))
        best = int(scores.argmax())
        if scores[best] >= min_correlation:
            found.append(Duplicate(image.name, other.entries[best].name, round(float(scores[best]), 3)))
        progress(k + 1)
    return sorted(found, key=lambda pair: (-pair.correlation, pair.one))


def check_leakage(train: LabelledSet, test: LabelledSet, min_correlation: float = MIN_CORRELATION) -> list[Duplicate]:
    """Find the test images that are near-duplicates of a training image; the caller reports or refuses them.

    Raises LabelError if an image of the same name is in both sets.
    """
    shared = {entry.name for entry in train.entries} & {entry.name for entry in test.entries}
    if shared:
        raise LabelError(f"{min(shared)!r} and {len(shared) - 1} more images are in both the training and the test set")
    return near_duplicates(test, train, min_correlation)
