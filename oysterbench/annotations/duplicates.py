"""Leakage: images of one side of a split that nearly are images of the other."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from oysterbench.annotations.image import LabelledSet
from oysterbench.core.errors import LabelError

SIDE = 32
"""px, of the small grey images that are compared: finer than water and noise change from frame to frame."""
BLUR = 3
"""px, standard deviation at which the small image is smoothed to find its slow changes of light."""
MIN_CORRELATION = 0.4
"""Correlation from which two images are taken to show the same place. Measured on 306 real images: of different clips
0.28 at most, neighbouring frames of a moving camera 0.35 to 0.85, one image under two names 1.0."""


@dataclass(frozen=True)
class Duplicate:
    """An image of one set and the image of another that shows the same; correlation: 1 for the very same."""

    one: str
    other: str
    correlation: float


def fingerprint(pixels: NDArray[np.uint8]) -> NDArray[np.complex64]:
    """(2 S, S + 1) spectrum of an image (H, W, 3), `SIDE` px wide, bands of light taken out, of unit length."""
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
    """For each image of `one` the image of `other` that is most like it, by a `min_correlation` at least; best first.

    Correlation of the images at `SIDE` px without their slow changes of brightness, at the shift that suits them best,
    so that the path of a camera between two frames does not hide that they show one place.
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
    """The test images that a training image nearly is; the caller says so, or refuses.

    Raises LabelError where an image, or a clip, is on both sides and the sets do not say that its parts are apart.
    """
    shared = {entry.name for entry in train.entries} & {entry.name for entry in test.entries}
    if shared:
        raise LabelError(f"{min(shared)!r} and {len(shared) - 1} more images are in both the training and the test set")
    return near_duplicates(test, train, min_correlation)
