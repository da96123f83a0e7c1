"""How a picture is looked at: in several ways, of which the mean is taken, and closer where oysters are small."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from oysterbench_baselines.learning.masks import probability
from oysterbench_baselines.learning.samples import Floats
from oysterbench_baselines.unet.instances import SIDE, Division, find_instances


class View(NamedTuple):
    """zoom: of the picture as the network has learnt to look at it; turns: by a quarter."""

    zoom: float
    turns: int = 0
    mirrored: bool = False


VIEWS = (View(1.0), View(1.4, turns=1), View(1.0, mirrored=True), View(1.4, turns=1, mirrored=True))
"""In the order of what they are worth."""
CLOSER = (View(2.0, turns=1), View(2.0, turns=1, mirrored=True))
"""Of a picture of small oysters, instead of two of `VIEWS` each: the network knows oysters of twice that size best."""
SMALL = 18.0
"""px of a picture whose longer side has `instances.SIDE` px: the root of the median area of oysters that are small."""
MANY = 15
"""Oysters by which it is told whether they are: fewer do not show it."""
LIKELY = 0.2
"""Their least score."""
SAME = 0.4
"""Intersection over union, at least, of the oysters of a closer look and of the glance: where they are true it was 0.57
to 0.90, and 0.14 where silt came out as oysters."""


class Look(NamedTuple):
    """What was seen of a picture: logits (K, H, W) float32 of `network.OUTPUTS` at its own size, and the zoom by which
    it was looked at more closely than others."""

    logits: Floats
    zoom: float = 1.0


def shows_small_oysters(logits: Floats) -> bool:
    """Whether a picture does, of which the network said (K, H, W) logits at a first glance. They are thinned out: that
    takes a quarter of the time, and says the same of all but one in 78."""
    step = max(1, max(logits.shape[1:]) // SIDE)
    oyster, depth = (probability(plane[::step, ::step]) for plane in logits[:2])
    found = find_instances(oyster, depth, Division(sure=LIKELY))
    areas = found.areas[found.scores >= 0.5]
    unit = max(oyster.shape) / SIDE
    return len(areas) >= MANY and float(np.median(np.sqrt(areas))) < SMALL * unit


def shows_the_same(closer: Floats, glance: Floats) -> bool:
    """Whether a closer look shows the oysters of the glance. Logits (K, H, W)."""
    one, other = closer[0] > 0, glance[0] > 0
    return bool(np.count_nonzero(one & other) >= SAME * np.count_nonzero(one | other))
