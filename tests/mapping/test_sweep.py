"""Depths from two views are right or absent, at the edges of what they show too."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest

from oysterbench.mapping.cloud_settings import CloudSettings
from oysterbench.mapping.sweep import sweep
from oysterbench.mapping.views import View

SETTINGS = CloudSettings()
WIDTH, HEIGHT, FOCAL = 240, 160, 200.0
MATRIX = np.array([[FOCAL, 0.0, WIDTH / 2], [0.0, FOCAL, HEIGHT / 2], [0.0, 0.0, 1.0]])
DISTANCE_M, BASE_M = 1.5, 0.15
SHIFT_PX = round(FOCAL * BASE_M / DISTANCE_M)


def views(shown=None):
    """Two pictures of a wall at DISTANCE_M, the second camera BASE_M to the right; black where a lens shows nothing."""
    generator = np.random.default_rng(5)
    wall = cv2.GaussianBlur(generator.uniform(0.0, 255.0, (HEIGHT, WIDTH + SHIFT_PX)), (0, 0), 1.5)
    wall = np.clip((wall - wall.mean()) * 4.0 + 120.0, 30.0, 255.0).astype(np.uint8)
    found = []
    for k in range(2):
        pixels = np.repeat(wall[:, k * SHIFT_PX : k * SHIFT_PX + WIDTH, None], 3, axis=2)
        if shown is not None:
            pixels = pixels * shown[..., None]
        pose = np.eye(4)
        pose[0, 3] = k * BASE_M
        found.append(View(0, pixels.astype(np.uint8), MATRIX, pose, shown))
    return found


def test_a_wall_has_its_distance_and_what_one_view_does_not_show_has_none():
    own, other = views()
    depth = sweep(own, [other], SETTINGS).depth
    known = np.isfinite(depth)
    assert known[:, 3 * SHIFT_PX : -8].mean() > 0.9
    assert np.abs(depth[known] / DISTANCE_M - 1.0).max() < 0.03
    assert not known[:, :SHIFT_PX].any()


def test_what_one_picture_alone_shows_is_no_depth():
    own, other = views()
    colours = other.colours.copy()
    # A patch that the other picture has elsewhere, by chance: a depth of its own, and none of the wall's.
    colours[70:79, 120:129] = own.colours[70:79, 150:159]
    depth = sweep(own, [replace(other, colours=colours)], SETTINGS).depth
    known = np.isfinite(depth)
    assert np.abs(depth[known] / DISTANCE_M - 1.0).max() < 0.05


@pytest.mark.parametrize("swapped", [False, True])
def test_the_edge_of_a_lens_is_no_texture(swapped):
    v, u = np.mgrid[:HEIGHT, :WIDTH]
    shown = ((u - WIDTH / 2) / 100.0) ** 2 + ((v - HEIGHT / 2) / 70.0) ** 2 < 1.0
    own, other = reversed(views(shown)) if swapped else views(shown)
    depth = sweep(own, [other], SETTINGS).depth
    known = np.isfinite(depth)
    assert known.mean() > 0.3
    assert np.abs(depth[known] / DISTANCE_M - 1.0).max() < 0.03
    assert not known[~shown].any()
