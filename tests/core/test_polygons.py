"""Polygons of masks: rasterised by COCO's own code they are the masks, whatever their shape."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import ndimage

from oysterbench.core.polygons import mask_polygons

masks = pytest.importorskip("pycocotools.mask")
pytestmark = pytest.mark.filterwarnings("ignore:__array__ implementation:DeprecationWarning")  # of pycocotools


def rasterised(polygons, shape):
    height, width = shape
    return masks.decode(masks.merge(masks.frPyObjects(polygons, height, width))).astype(bool)


@given(st.integers(0, 2**32 - 1), st.integers(1, 40), st.integers(1, 40), st.floats(0.1, 0.9), st.booleans())
@settings(max_examples=150, deadline=None)
def test_a_mask_comes_back_pixel_by_pixel(seed, height, width, share, smooth):
    field = np.random.default_rng(seed).random((height, width))
    if smooth:
        field = ndimage.gaussian_filter(field, 1.5)
    mask = field <= np.quantile(field, share)
    polygons = mask_polygons(mask)
    assert all(len(polygon) >= 8 for polygon in polygons)
    assert len(polygons) == ndimage.label(mask)[1], "one polygon to a piece"
    assert np.array_equal(rasterised(polygons, mask.shape), mask)


def test_one_pixel_is_a_square():
    mask = np.zeros((4, 5), dtype=bool)
    mask[1, 2] = True
    (polygon,) = mask_polygons(mask)
    corners = {tuple(polygon[k : k + 2]) for k in range(0, 8, 2)}
    assert corners == {(2, 1), (3, 1), (3, 2), (2, 2)}


def test_a_ring_in_a_ring_is_kept():
    mask = np.zeros((15, 15), dtype=bool)
    mask[1:14, 1:14] = True
    mask[3:12, 3:12] = False
    mask[5:10, 5:10] = True
    mask[7, 7] = False
    polygons = mask_polygons(mask)
    assert len(polygons) == 2
    assert np.array_equal(rasterised(polygons, mask.shape), mask)


def test_nothing_has_no_polygon():
    assert mask_polygons(np.zeros((3, 3), dtype=bool)) == []
