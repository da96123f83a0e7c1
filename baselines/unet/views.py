"""Views of an image: several, whose predictions are averaged, closer ones where oysters are small, and views from
farther away where they are large."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from oysterbench_baselines.learning.masks import probability
from oysterbench_baselines.learning.samples import Floats
from oysterbench_baselines.unet.instances import SIDE, Division, find_instances


class View(NamedTuple):
    """A view of an image. zoom: relative to the scale at which the network was trained; turns: quarter turns."""

    zoom: float
    turns: int = 0
    mirrored: bool = False


VIEWS = (View(1.0), View(1.4, turns=1), View(1.0, mirrored=True), View(1.4, turns=1, mirrored=True))
"""In the order of their benefit."""
CLOSER, SHAPE = 5 / 3, 3 / 4
"""Zoom of a closer look at an image whose height is at most a share SHAPE of its width; a squarer one is enlarged less,
to as many pixels. At twice the size an image takes half as long again, for the same IoU and AP50."""
FINER = 1.5
"""Factor by which the oysters of a closer look are divided more finely (`instances.Division.zoomed`) than it is
enlarged."""
LARGE, FARTHEST = 32.0, 0.5
"""Size at which the network knows oysters best, px, for an image whose longer side is `instances.SIDE` px: an image of
larger ones is reduced until they have it, at most to a share FARTHEST. The size is the root of the mean area of
oysters, weighted by area: at a first glance, large oysters come out in pieces, whose number says nothing."""
SMALL = 18.0
"""Size below which oysters count as small: median square root of their areas, px, for an image whose longer side is
`instances.SIDE` px."""
MANY = 15
"""Minimum number of oysters from which their size can be judged."""
LIKELY = 0.2
"""Minimum score of these oysters."""
SAME = 0.68
"""Minimum intersection over union of the oysters in a closer look and in the first glance. It was 0.69 to 0.91 on clear
rendered reefs, and 0.54 to 0.67 on real quadrats, where the closer look sees oysters in eelgrass."""


class Look(NamedTuple):
    """Prediction for an image: logits (K, H, W) float32 of `network.OUTPUTS` at its own size, and the zoom by which
    it is divided: `FINER` times that of a closer look, that of a farther look, and 1 for the usual one."""

    logits: Floats
    zoom: float = 1.0


def fitting_zoom(logits: Floats) -> float:
    """Zoom at which to look at an image, by the size of its oysters, given the logits (K, H, W) of a first glance:
    below 1 where they are large, `closer_zoom` where they are small, and 1 otherwise. The logits are subsampled,
    which takes a quarter of the time; whether oysters are small came out differently for one image in 78."""
    step = max(1, max(logits.shape[1:]) // SIDE)
    oyster, depth = (probability(plane[::step, ::step]) for plane in logits[:2])
    found = find_instances(oyster, depth, Division(sure=LIKELY))
    unit = max(oyster.shape) / SIDE
    areas = found.areas / unit**2
    size = math.sqrt(np.square(areas).sum() / max(areas.sum(), 1.0))
    if size > LARGE:
        return max(LARGE / size, FARTHEST)
    areas = areas[found.scores >= 0.5]
    small = len(areas) >= MANY and float(np.median(np.sqrt(areas))) < SMALL
    return closer_zoom(*oyster.shape) if small else 1.0


def closer_zoom(height: int, width: int) -> float:
    """Zoom of a closer look at an image of this shape (`CLOSER`)."""
    return CLOSER * math.sqrt(min(1.0, SHAPE * max(height, width) / min(height, width)))


def closer_views(zoom: float) -> tuple[View, ...]:
    """Views of an image of small oysters, of which the enlarged ones alone are used where they show the same oysters as
    the first glance."""
    return tuple(view._replace(zoom=zoom) if view.turns else view for view in VIEWS)


def shows_the_same(closer: Floats, glance: Floats) -> bool:
    """Whether a closer look shows the same oysters as the first glance. Both: logits (K, H, W)."""
    one, other = closer[0] > 0, glance[0] > 0
    return bool(np.count_nonzero(one & other) >= SAME * np.count_nonzero(one | other))
