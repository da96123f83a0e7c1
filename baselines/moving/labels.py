"""Training labels of what moves."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from oysterbench.annotations import Entry, LabelledImage, LabelledSet
from oysterbench.core.errors import LabelError
from oysterbench.recipe import CLASSES, OYSTER

MOVING = ("plant", "fish", "crab", "tether")
"""Classes that move by themselves or with the water. To a front end, debris and sinking particles are marine snow."""
LEAST = 0.002
"""Minimum share of moving pixels in a training image: about five hundred pixels. Most images have none, and would teach
that nothing ever moves."""

SET = "moving in "
"""Prefix of the names of such sets, by which a checkpoint trained on them is recognised."""

_NUMBERS = [number for number, name in CLASSES.items() if name in MOVING]


def moving_set(labelled: LabelledSet) -> LabelledSet:
    """Select the images of a set in which something moves, with the moving pixels labelled in place of oysters.

    Raises LabelError where there are none.
    """
    entries = [entry for entry in labelled.entries if np.mean(np.isin(entry.read().classes, _NUMBERS)) >= LEAST]
    if not entries:
        raise LabelError(
            f"{labelled.name}: of {len(labelled)} images, expected some with {', '.join(MOVING)}, got none; take "
            "sequences of slam-train, such as train-05"
        )
    return LabelledSet(SET + labelled.name, [_relabelled(entry) for entry in entries])


def _relabelled(entry: Entry) -> Entry:
    def read() -> LabelledImage:
        image = entry.read()
        moves = np.isin(image.classes, _NUMBERS)
        classes, nothing = np.where(moves, OYSTER, 0).astype(np.uint8), np.zeros_like(image.instances)
        return replace(image, classes=classes, instances=nothing, ignore=np.zeros_like(image.ignore))

    return replace(entry, read=read)
