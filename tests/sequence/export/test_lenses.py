"""Exports of cameras with lenses: pictures undistorted, rays through the middle of pixels."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from oysterbench.sequence.calibration import CameraCalibration
from oysterbench.sequence.export.parts import undistorting_maps
from oysterbench.sequence.export.ply import pixel_rays

MATRIX = np.array([[90.0, 0, 79.5], [0, 92.0, 59.5], [0, 0, 1.0]])


def camera(model: str, coefficients) -> CameraCalibration:
    return CameraCalibration(160, 120, 10.0, MATRIX, np.array(coefficients), np.eye(4), model)


LENSES = [
    camera("plumb_bob", [0.12, 0.06, 0.0004, -0.0003]),
    camera("plumb_bob", [-0.1, 0.02, 0.001, 0.0005, -0.002]),
    camera("equidistant", [0.05, -0.01, 0.002, -0.0005]),
]


def project(lens: CameraCalibration, points: np.ndarray) -> np.ndarray:
    """Pixels (N, 2) of points (N, 3), by OpenCV."""
    if lens.distortion_model == "equidistant":
        pixels, _ = cv2.fisheye.projectPoints(points[:, None], np.zeros(3), np.zeros(3), MATRIX, lens.distortion)
    else:
        pixels, _ = cv2.projectPoints(points, np.zeros(3), np.zeros(3), MATRIX, lens.distortion)
    return pixels.reshape(-1, 2)


@pytest.mark.parametrize("lens", LENSES)
def test_a_pixels_ray_projects_onto_its_centre(lens):
    rays = pixel_rays(lens)
    columns, rows = np.meshgrid(np.arange(160), np.arange(120))
    pixels = project(lens, rays.reshape(-1, 3))
    np.testing.assert_allclose(pixels, np.column_stack([columns.ravel(), rows.ravel()]), atol=1e-5)


@pytest.mark.parametrize("lens", LENSES)
def test_an_undistorted_picture_is_that_of_a_pinhole(lens):
    """A smooth pattern on a plane, drawn through the lens and undistorted, is the one drawn through a pinhole."""

    def pattern(rays):
        x, y = rays[..., 0] / rays[..., 2], rays[..., 1] / rays[..., 2]
        return np.rint(127 + 100 * np.sin(6 * x) * np.cos(7 * y)).astype(np.uint8)

    drawn = pattern(pixel_rays(lens))
    expected = pattern(pixel_rays(camera("plumb_bob", [0.0, 0, 0, 0])))
    got = cv2.remap(drawn, *undistorting_maps(lens, MATRIX), cv2.INTER_LINEAR)
    inner = np.s_[15:105, 20:140]
    assert np.abs(got[inner].astype(int) - expected[inner]).max() <= 3
    assert np.abs(drawn[inner].astype(int) - expected[inner]).max() > 6


def test_a_pinhole_needs_no_undistorting():
    assert undistorting_maps(camera("plumb_bob", [0.0, 0, 0, 0]), MATRIX) is None


def test_a_pixel_that_the_lens_cannot_fill_has_no_ray():
    """A barrel that never reaches the corners."""
    rays = pixel_rays(camera("plumb_bob", [-0.3, 0.0, 0.0, 0.0]))
    assert np.isnan(rays[0, 0, :2]).all()
    assert np.isfinite(rays[60, 80]).all()
