"""Methods without training, with which every number has to be compared."""

from __future__ import annotations

import json
from collections.abc import Iterator
from typing import Any

import cv2
import numpy as np

from oysterbench.methods.images import Picture
from oysterbench_baselines.sim2real.scoring import Prediction, Truth
from oysterbench_baselines.threshold import All, Colour, Nothing

TRIVIAL = (All, Nothing, Colour)
"""Methods that are rows of the table under their own names."""


def settings_of(method: Any) -> dict[str, Any]:
    """Settings of a method as plain values; empty where it has none."""
    as_dict = getattr(method, "as_dict", None)
    return {} if as_dict is None else json.loads(json.dumps(as_dict()))


def predictions(method: Any, truth: Truth) -> Iterator[Prediction]:
    """Predictions of a method of the track segmentation for the test images. Each connected component is one oyster."""
    pictures = (Picture(mask.name, pixels) for mask, pixels in zip(truth.masks, truth.pixels, strict=True))
    for found in method.run(pictures):
        chance = np.asarray(found.oyster if found.probability is None else found.probability, dtype=np.float64)
        mask = chance >= 0.5
        count, labels = cv2.connectedComponents(mask.astype(np.uint8), connectivity=8)
        pixels = np.maximum(np.bincount(labels.ravel(), minlength=count), 1)
        sums = np.bincount(labels.ravel(), weights=chance.ravel(), minlength=count)
        yield Prediction(mask, np.asarray(labels, np.int32), (sums / pixels)[1:])
