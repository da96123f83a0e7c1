"""Stereo pairs as they are calibrated, not parallel to the last bit: found, and brought into one plane."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import cv2
import numpy as np
import pytest

from oysterbench.core.geometry import invert, transform
from oysterbench.core.streams import Streams
from oysterbench.recipe import SiteRecipe, load_split, with_rig
from oysterbench.sensors.registry import calibrate_rig, read_calibrations
from oysterbench.sequence.export.kitti import left_out
from oysterbench.sequence.export.parts import rectify, stereo_partner, undistorting_maps, unpaired

PAIR = ("cam_left", "cam_right")
POINT = np.array([1.4, 0.1, -0.9, 1.0])  # in base_link, m


def calibrated(quality, seed, rig):
    split = with_rig(load_split("slam-val"), rig, "")
    found = calibrate_rig(split.rig, SiteRecipe(), quality, Streams(seed))
    return SimpleNamespace(cameras=read_calibrations(found.given)["camera"])


def shown(camera, point):
    """The pixel (u, v) at which a camera's own lens shows a point (3,) of its frame."""
    lens = cv2.fisheye if camera.distortion_model == "equidistant" else cv2
    return lens.projectPoints(point[None, None], np.zeros(3), np.zeros(3), camera.matrix, camera.distortion)[0].ravel()


@pytest.mark.parametrize("rig", ["survey-stereo", "survey-stereo-port"])
@pytest.mark.parametrize("seed", range(10))
def test_a_pair_as_calibrated_sees_a_point_in_one_row_once_it_is_rectified(rig, seed):
    sequence = calibrated("poor", seed, rig)
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
        assert [maps[0][row, column], maps[1][row, column]] == pytest.approx(shown(camera, near), abs=1e-3)
    assert pixels[0][1] == pytest.approx(pixels[1][1], abs=1e-9)
    assert pixels[0][0] > pixels[1][0]


def test_cameras_that_are_not_exported_are_told_of_with_the_reason():
    assert left_out(PAIR, list(PAIR)) == []
    (alone,) = left_out(PAIR, ["cam_left"])
    assert alone.startswith("left out: cam_right: the layout has one pair, of cameras of one size, parallel to 3 deg")
    assert alone.endswith("cam_left has none such to its right")
    (ahead,) = left_out(PAIR, ["cam_left"], {"cam_right": "15.0 deg off its x axis"})
    assert ahead.endswith("; cam_right is 15.0 deg off its x axis; cam_left has none such to its right")
    (third,) = left_out((*PAIR, "cam_front"), list(PAIR))
    assert third.endswith("cam_left and cam_right are that pair")


@pytest.mark.parametrize(
    ("changes", "fault"),
    [
        ({}, ""),
        ({"width": 100}, "of another size"),
        ({"T_base_cam": transform(np.eye(3), np.array([0.12, 0.0, 0.032]))}, "14.9 deg off its x axis"),
        ({"T_base_cam": transform(np.eye(3), np.array([-0.12, 0.0, 0.0]))}, "not to its right"),
        ({"T_base_cam": transform(np.diag([1.0, -1.0, -1.0]), np.array([0.12, 0.0, 0.0]))}, "turned by 180.0 deg"),
    ],
)
def test_what_keeps_cameras_from_being_a_pair_is_told(changes, fault):
    left = replace(calibrated("exact", 1, "survey-stereo").cameras["cam_left"], T_base_cam=np.eye(4))
    right = replace(left, T_base_cam=transform(np.eye(3), np.array([0.12, 0.0, 0.0])))
    assert unpaired(left, replace(right, **changes)) == fault


def test_a_pair_that_is_parallel_is_left_as_it_is():
    for turn in rectify(calibrated("exact", 1, "survey-stereo"), PAIR):
        assert np.array_equal(turn, np.eye(3))
