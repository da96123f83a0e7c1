"""Stereo pairs as they are calibrated, not parallel to the last bit: found, and brought into one plane."""

from __future__ import annotations

from types import SimpleNamespace

import cv2
import numpy as np
import pytest

from oysterbench.core.geometry import invert
from oysterbench.core.streams import Streams
from oysterbench.recipe import SiteRecipe, load_split
from oysterbench.sensors.registry import calibrate_rig, read_calibrations
from oysterbench.sequence.export.parts import rectify, stereo_partner, undistorting_maps

PAIR = ("cam_left", "cam_right")
POINT = np.array([1.4, 0.1, -0.9, 1.0])  # in base_link, m


def calibrated(quality, seed):
    found = calibrate_rig(load_split("slam-val").rig, SiteRecipe(), quality, Streams(seed))
    return SimpleNamespace(cameras=read_calibrations(found.given)["camera"])


@pytest.mark.parametrize("seed", range(20))
def test_a_pair_as_calibrated_sees_a_point_in_one_row_once_it_is_rectified(seed):
    sequence = calibrated("poor", seed)
    assert stereo_partner(sequence, "cam_left") == "cam_right"
    assert stereo_partner(sequence, "cam_right") is None
    pixels = []
    matrix = sequence.cameras["cam_left"].matrix
    for name, turn in zip(PAIR, rectify(sequence, PAIR), strict=True):
        camera = sequence.cameras[name]
        x, y, z = turn @ (invert(camera.T_base_cam) @ POINT)[:3]
        pixels.append((matrix @ [x / z, y / z, 1.0])[:2])
        # And the maps look that pixel up where the camera's own lens shows the point.
        maps = undistorting_maps(camera, matrix, turn)
        column, row = np.rint(pixels[-1]).astype(int)
        near = turn.T @ np.linalg.inv(matrix) @ [column, row, 1.0]
        wanted, _ = cv2.projectPoints(near[None], np.zeros(3), np.zeros(3), camera.matrix, camera.distortion)
        assert [maps[0][row, column], maps[1][row, column]] == pytest.approx(wanted.ravel(), abs=1e-3)
    assert pixels[0][1] == pytest.approx(pixels[1][1], abs=1e-9)
    assert pixels[0][0] > pixels[1][0]


def test_a_pair_that_is_parallel_is_left_as_it_is():
    for turn in rectify(calibrated("exact", 1), PAIR):
        assert np.array_equal(turn, np.eye(3))
