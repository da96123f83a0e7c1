"""What moves, as labels to learn from."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from oysterbench.annotations import OYSTER, Entry, LabelledImage, LabelledSet
from oysterbench.core.errors import LabelError
from oysterbench.recipe import CLASSES

MOVING = ("plant", "fish", "crab", "tether")
"""Classes that the water or they themselves move. Debris and what sinks are marine snow to a front end."""
LEAST = 0.002
"""Of a picture, that moves, for it to be learnt from: half a thousand pixels. Pictures without are most of all, and
would teach that nothing ever moves."""

SET = "moving in "
"""How the names of such sets begin, by which a checkpoint of theirs is known."""

_NUMBERS = [number for number, name in CLASSES.items() if name in MOVING]


def moving_set(labelled: LabelledSet) -> LabelledSet:
    """The pictures of a set in which something moves, that being what is looked for in the place of oysters.

    Raises LabelError where there is none.
    """
    entries = [entry for entry in labelled.entries if np.mean(np.isin(entry.read().classes, _NUMBERS)) >= LEAST]
    if not entries:
        raise LabelError(
            f"{labelled.name}: of {len(labelled)} pictures, expected some with {', '.join(MOVING)}, got none; take "
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
