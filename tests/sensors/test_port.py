"""What is handed out of a camera behind a flat port, against the refracted rays themselves."""

from __future__ import annotations

import dataclasses

import cv2
import numpy as np
import pytest

from oysterbench.core.geometry import invert
from oysterbench.recipe import CameraRecipe, SiteRecipe, load_split
from oysterbench.render import lens
from oysterbench.render.lens import project
from oysterbench.sensors.camera import KIND
from oysterbench.sensors.port import fit_in_water
from oysterbench.sequence.export.ply import pixel_rays, points_at
from oysterbench.sequence.export.port import lens_centre_m

PORT = CameraRecipe(name="cam", width=640, height=480, hfov_deg=69.0, rate_hz=10.0, port_mm=10.0, pitch_deg=40.0)
SITE = SiteRecipe()
LENS = {"lens": "brown-conrady", "distortion": (-0.05, 0.01, 4e-4, -3e-4)}


@pytest.mark.parametrize("port_mm", [2.0, 10.0, 30.0])
def test_the_fitted_lens_misses_true_projections_by_what_it_states(port_mm):
    camera = dataclasses.replace(PORT, port_mm=port_mm)
    given, true = KIND.calibrate(camera, SITE), KIND.true_calibration(camera, SITE)
    calibration = KIND.read_calibration(given)
    generator = np.random.default_rng(1)
    depth = generator.uniform(0.5, 2.0, 4000)
    points = np.column_stack([generator.uniform(-0.68, 0.68, 4000), generator.uniform(-0.5, 0.5, 4000), np.ones(4000)])
    points = points * depth[:, None]
    seen = project(points, camera)
    T_given_true = np.linalg.inv(calibration.T_base_cam) @ np.array(true["T_base_cam"])
    moved = points @ T_given_true[:3, :3].T + T_given_true[:3, 3]
    found, _ = cv2.fisheye.projectPoints(
        moved[:, None], np.zeros(3), np.zeros(3), calibration.matrix, calibration.distortion
    )
    inside = np.all((seen >= 0) & (seen <= [639, 479]), axis=1)
    miss = np.hypot(*(found[:, 0] - seen)[inside].T)
    assert np.sqrt(np.mean(miss**2)) < 1.2 * given["fitted"]["rms_px"]
    assert miss.max() < 1.2 * given["fitted"]["worst_px"]


def test_only_the_truth_knows_the_port_and_its_residual_grows_with_it():
    given, true = KIND.calibrate(PORT, SITE), KIND.true_calibration(PORT, SITE)
    assert true["port"] == {"distance_m": 0.01, "index": 1.33}
    assert "port" not in given
    assert KIND.read_calibration(given).port_m is None
    assert KIND.read_calibration(true).port_m == 0.01
    rms = [KIND.calibrate(dataclasses.replace(PORT, port_mm=d), SITE)["fitted"]["rms_px"] for d in (2.0, 10.0, 30.0)]
    assert rms[0] < rms[1] < rms[2] < 1.0


@pytest.mark.parametrize(
    "changes",
    [
        {},
        {"port_mm": 2.0},
        {"port_mm": 30.0},
        {"hfov_deg": 80.0},
        {"hfov_deg": 96.0},
        {"hfov_deg": 90.0, "port_mm": 100.0},
        LENS,
    ],
)
def test_the_centre_of_the_fitted_lens_follows_from_the_true_calibration(changes):
    camera = dataclasses.replace(PORT, **changes)
    true = KIND.read_calibration(KIND.true_calibration(camera, SITE))
    assert lens_centre_m(true) == pytest.approx(fit_in_water(camera).axial_m, rel=0.02)


def test_the_fitted_focal_length_is_that_in_air_times_the_index():
    air = np.array(KIND.true_calibration(PORT, SITE)["matrix"])[0, 0]
    assert KIND.calibrate(PORT, SITE)["matrix"][0][0] == pytest.approx(1.33 * air, rel=0.02)


def test_without_a_port_a_perfect_calibration_is_the_truth():
    camera = dataclasses.replace(PORT, port_mm=None)
    assert KIND.calibrate(camera, SITE) == KIND.true_calibration(camera, SITE)


@pytest.mark.parametrize("edge", [0, -5, 10**300])
def test_a_calibration_whose_pictures_cannot_be_is_refused(edge):
    with pytest.raises(ValueError, match="expected a width and height of 1 to 65535 px"):
        KIND.read_calibration({**KIND.calibrate(PORT, SITE), "height": edge})


@pytest.mark.parametrize("seed", range(4))
def test_the_last_bits_of_a_processor_do_not_show_in_the_fit(seed, monkeypatch):
    generator = np.random.default_rng(seed)

    def roughly(points, camera):
        return exactly(points, camera) * (1.0 + 1e-15 * generator.standard_normal(points.shape))

    expected, exactly = fit_in_water(PORT), lens.distort
    monkeypatch.setattr(lens, "distort", roughly)
    found = fit_in_water.__wrapped__(PORT)
    np.testing.assert_array_equal(found.matrix, expected.matrix)
    assert dataclasses.astuple(found)[1:] == dataclasses.astuple(expected)[1:]


def test_depth_is_from_the_true_pupil_and_the_given_lens_needs_its_distance_added():
    camera = load_split("slam-val").rig.camera[0]
    entries = (KIND.calibrate(camera, SITE), KIND.true_calibration(camera, SITE))
    given, true = map(KIND.read_calibration, entries)
    ahead = (invert(given.T_base_cam) @ true.T_base_cam)[2, 3]
    assert ahead == pytest.approx(0.00665, abs=5e-5)  # as the documentation says
    inner = np.s_[24:-24:12, 24:-24:12]
    depth = np.full((camera.height, camera.width), 1.0)[inner].ravel()
    points = points_at(pixel_rays(true)[inner].reshape(-1, 3), depth)
    rays = pixel_rays(given)[inner].reshape(-1, 3)
    added = rays[:, :2] * (depth + ahead)[:, None]
    assert np.hypot(*(added - points[:, :2]).T).max() < 1.2e-3  # residuals of the fit
    assert np.hypot(*(rays[:, :2] * depth[:, None] - points[:, :2]).T).max() > 4e-3
