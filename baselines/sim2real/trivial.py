"""What needs no learning, and what every number has to be read against."""

from __future__ import annotations

import json
from collections.abc import Iterator
from typing import Any

import cv2
import numpy as np

from oysterbench.methods.images import Picture
from oysterbench_baselines.sim2real.scoring import Answer, Truth
from oysterbench_baselines.threshold import All, Colour, Nothing

TRIVIAL = (All, Nothing, Colour)
"""Methods that are rows of the table under their own names."""


def settings_of(method: Any) -> dict[str, Any]:
    """Of a method that has settings, as plain values."""
    as_dict = getattr(method, "as_dict", None)
    return {} if as_dict is None else json.loads(json.dumps(as_dict()))


def answers(method: Any, truth: Truth) -> Iterator[Answer]:
    """Of a method of the track segmentation to the test images. What hangs together is one oyster."""
    pictures = (Picture(mask.name, pixels) for mask, pixels in zip(truth.masks, truth.pixels, strict=True))
    for said in method.run(pictures):
        chance = np.asarray(said.oyster if said.probability is None else said.probability, dtype=np.float64)
        mask = chance >= 0.5
        count, labels = cv2.connectedComponents(mask.astype(np.uint8), connectivity=8)
        pixels = np.maximum(np.bincount(labels.ravel(), minlength=count), 1)
        sums = np.bincount(labels.ravel(), weights=chance.ravel(), minlength=count)
        yield Answer(mask, np.asarray(labels, np.int32), (sums / pixels)[1:])
