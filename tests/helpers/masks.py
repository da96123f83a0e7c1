"""Random masks, and the same counts taken pixel by pixel: slow, and with nothing shared with the evaluator."""

from __future__ import annotations

import numpy as np
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from oysterbench.evaluate.segmentation import TruthImage
from oysterbench.recipe import OYSTER

SHAPES = st.tuples(st.integers(4, 9), st.integers(4, 9))


@st.composite
def pictures(draw, count=3):
    """So many boolean planes of one size: truth, estimate, ignored."""
    shape = draw(SHAPES)
    return tuple(draw(arrays(bool, shape)) for _ in range(count))


def truth_of(mask, ignore=None, name="a", **known):
    """A truth of oysters alone."""
    mask = np.asarray(mask, dtype=bool)
    classes = np.where(mask, np.uint8(OYSTER), np.uint8(0))
    return TruthImage(name, classes, False, None if ignore is None else np.asarray(ignore, bool), **known)


def counted(true, predicted, ignored):
    """Hits, extras, misses and the rest, pixel by pixel."""
    hit = extra = missed = rest = 0
    for t, s, i in zip(true.ravel().tolist(), predicted.ravel().tolist(), ignored.ravel().tolist(), strict=True):
        if i:
            continue
        hit, extra = hit + (t and s), extra + (s and not t)
        missed, rest = missed + (t and not s), rest + (not t and not s)
    return hit, extra, missed, rest


def border(mask, depth):
    """Pixels of a mask from which a pixel outside it, or outside the image, is at most `depth` off in x and y."""
    height, width = mask.shape
    found = np.zeros_like(mask)
    for y in range(height):
        for x in range(width):
            near = [
                not (0 <= v < height and 0 <= u < width and mask[v, u])
                for v in range(y - depth, y + depth + 1)
                for u in range(x - depth, x + depth + 1)
            ]
            found[y, x] = mask[y, x] and any(near)
    return found
