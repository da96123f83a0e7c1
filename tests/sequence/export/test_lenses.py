"""Exports of cameras with lenses: pictures undistorted, rays through the middle of pixels."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest

from oysterbench.recipe import CameraRecipe
from oysterbench.render.lens import pixel_rays as render_rays
from oysterbench.render.lens import project as render_project
from oysterbench.scene.rig import camera_matrix
from oysterbench.sensors.camera import KIND as CAMERA
from oysterbench.sequence.export.parts import undistorting_maps
from oysterbench.sequence.export.ply import pixel_rays, points_at
from oysterbench.sequence.types import CameraCalibration

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
    assert not rays[..., 2].any()
    pixels = project(lens, points_at(rays.reshape(-1, 3), np.full(rays[..., 0].size, 1.7)))
    np.testing.assert_allclose(pixels, np.column_stack([columns.ravel(), rows.ravel()]), atol=1e-5)


@pytest.mark.parametrize("lens", LENSES)
def test_an_undistorted_picture_is_that_of_a_pinhole(lens):
    """A smooth pattern on a plane, drawn through the lens and undistorted, is the one drawn through a pinhole."""

    def pattern(rays):
        x, y = rays[..., 0], rays[..., 1]
        return np.rint(127 + 100 * np.sin(6 * x) * np.cos(7 * y)).astype(np.uint8)

    drawn = pattern(pixel_rays(lens))
    expected = pattern(pixel_rays(camera("plumb_bob", [0.0, 0, 0, 0])))
    got = cv2.remap(drawn, *undistorting_maps(lens, MATRIX), cv2.INTER_LINEAR)
    inner = np.s_[15:105, 20:140]
    assert np.abs(got[inner].astype(int) - expected[inner]).max() <= 3
    assert np.abs(drawn[inner].astype(int) - expected[inner]).max() > 6


@pytest.mark.parametrize("k", [0.0, -0.02])
def test_what_a_fisheye_sees_beyond_90_degrees_has_no_ray_to_the_front(k):
    matrix = np.array([[30.0, 0, 79.5], [0, 30.0, 59.5], [0, 0, 1]])
    rays = pixel_rays(replace(camera("equidistant", [k, 0.0, 0, 0]), matrix=matrix))
    rows, columns = np.indices((120, 160))
    angles = np.linspace(0.0, 2.5, 10_000)
    angle = np.interp(np.hypot(columns - 79.5, rows - 59.5) / 30.0, angles + k * angles**3, angles)
    assert np.isnan(rays[angle > np.pi / 2, 0]).all()
    seen = angle < np.pi / 2 - 0.02
    assert np.hypot(*rays[seen, :2].T) == pytest.approx(np.tan(angle[seen]), rel=1e-3)


def test_rays_behind_a_flat_port_are_those_that_the_picture_was_drawn_with():
    """Of the renderer, which is written independently; and Snell's law sends the outer ones through no common point."""
    recipe = CameraRecipe(name="c", width=160, height=120, hfov_deg=60.0, rate_hz=1.0, port_mm=80.0)
    entry = {
        "width": 160,
        "height": 120,
        "rate_hz": 1.0,
        "matrix": camera_matrix(recipe),
        "distortion": [0.0, 0, 0, 0],
        "T_base_cam": np.eye(4),
        "port": {"distance_m": 0.08, "index": 1.33},
    }
    rays = pixel_rays(CAMERA.read_calibration(entry))
    np.testing.assert_allclose(rays, render_rays(recipe)[1:-1, 1:-1], atol=2e-7)
    assert rays[0, 0, 2] < rays[60, 80, 2] < -0.02
    pixels = render_project(points_at(rays.reshape(-1, 3), np.full(rays[..., 0].size, 1.3)), recipe)
    columns, rows = np.meshgrid(np.arange(160), np.arange(120))
    np.testing.assert_allclose(pixels, np.column_stack([columns.ravel(), rows.ravel()]), atol=1e-4)


def test_a_pinhole_needs_no_undistorting():
    assert undistorting_maps(camera("plumb_bob", [0.0, 0, 0, 0]), MATRIX) is None


def test_a_pixel_that_the_lens_cannot_fill_has_no_ray():
    """A barrel that never reaches the corners."""
    rays = pixel_rays(camera("plumb_bob", [-0.3, 0.0, 0.0, 0.0]))
    assert np.isnan(rays[0, 0, :2]).all()
    assert np.isfinite(rays[60, 80]).all()
