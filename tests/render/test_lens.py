"""Lenses against OpenCV: what the depth image says lies at a pixel is projected onto that pixel."""

from __future__ import annotations

import dataclasses

import cv2
import numpy as np
import pytest
from scipy.ndimage import map_coordinates

from oysterbench.core.errors import RecipeError
from oysterbench.recipe import parse_split, vary_split
from oysterbench.recipe.lens import PORT_INDEX
from oysterbench.render.lens import pixel_rays, project
from oysterbench.sensors.camera import KIND
from oysterbench.sensors.camera_messages import camera_info, coefficients
from oysterbench.sensors.registry import rig_calibration
from tests.helpers.reefs import CAMERA, FLAT, SPLIT, noise, pose, renderer_of, small_reef

BROWN = dataclasses.replace(CAMERA, lens="brown-conrady", distortion=(-0.21, 0.06, 1.5e-3, -8e-4, -0.01))
FISHEYE = dataclasses.replace(CAMERA, lens="fisheye", hfov_deg=130.0, distortion=(0.03, -0.012, 0.004, -0.0008))
PORT = dataclasses.replace(CAMERA, port_mm=40.0)


def calibration(camera):
    return KIND.read_calibration(KIND.true_calibration(camera, SPLIT.sequence[0].site))


def opencv_pixels(points, camera):
    """Pixels (N, 2) of points (N, 3) in the optical frame, by OpenCV and the calibration that travels in a sequence."""
    known = calibration(camera)
    project_points = cv2.fisheye.projectPoints if known.distortion_model == "equidistant" else cv2.projectPoints
    pixels, _ = project_points(points[:, None], np.zeros(3), np.zeros(3), known.matrix, known.distortion)
    return pixels.reshape(-1, 2)


@pytest.mark.parametrize("camera", [CAMERA, BROWN, FISHEYE], ids=["pinhole", "brown-conrady", "fisheye"])
def test_the_rays_of_pixels_are_those_of_opencv(camera):
    rays = pixel_rays(camera)[1:-1, 1:-1].astype(float).reshape(-1, 3)
    points = np.column_stack([rays[:, :2], np.ones(len(rays))]) * 2.5
    rows, columns = np.mgrid[0 : camera.height, 0 : camera.width]
    expected = np.column_stack([columns.ravel(), rows.ravel()])
    assert np.abs(opencv_pixels(points, camera) - expected).max() < 1e-4
    assert np.abs(project(points, camera) - expected).max() < 1e-4
    assert np.all(rays[:, 2] == 0)


@pytest.mark.parametrize("camera", [CAMERA, BROWN, FISHEYE], ids=["pinhole", "brown-conrady", "fisheye"])
def test_points_of_a_rendered_plane_project_onto_their_pixels(camera):
    flat = small_reef(FLAT)
    T_map_cam = pose(0.1, -0.2, -2.0, 30, 60)
    depth = renderer_of(flat, camera).render(T_map_cam, noise()).depth
    generator = np.random.default_rng(3)
    points = np.column_stack([generator.uniform(-1.5, 1.5, (2000, 2)), np.full(2000, -3.0)])
    seen = (points - T_map_cam[:3, 3]) @ T_map_cam[:3, :3]
    seen = seen[seen[:, 2] > 0.3]
    pixels = opencv_pixels(seen, camera)
    inside = np.all((pixels > 1) & (pixels < [camera.width - 2, camera.height - 2]), axis=1)
    inside &= np.hypot(*(seen[:, :2] / seen[:, 2:]).T) < 2.0  # a polynomial folds far outside the picture
    assert inside.sum() > 200
    # The inverse depth of a plane is nearly linear over a pixel.
    inverse = map_coordinates(1.0 / np.where(depth > 0, depth, np.inf), pixels[inside][:, ::-1].T, order=1)
    assert 1.0 / inverse == pytest.approx(seen[inside, 2], rel=1e-3)


def test_rays_behind_a_flat_port_bend_by_snells_law():
    rays = pixel_rays(PORT)[1:-1, 1:-1].astype(float)
    known = calibration(PORT)
    rows, columns = np.mgrid[0 : PORT.height, 0 : PORT.width]
    air = np.hypot(columns - known.matrix[0, 2], rows - known.matrix[1, 2]) / known.matrix[0, 0]
    water = np.hypot(rays[..., 0], rays[..., 1])
    sine_air, sine_water = np.sin(np.arctan(air)), np.sin(np.arctan(water))
    assert sine_air == pytest.approx(PORT_INDEX * sine_water, abs=1e-6)
    assert 0.04 * air == pytest.approx((0.04 - rays[..., 2]) * water, abs=1e-7), (
        "the ray leaves the port where it met it"
    )
    points = np.stack([rays[..., 0] * 1.5, rays[..., 1] * 1.5, rays[..., 2] + 1.5], axis=-1).reshape(-1, 3)
    assert np.abs(project(points, PORT) - np.column_stack([columns.ravel(), rows.ravel()])).max() < 1e-3
    edge = np.arctan(water[:, -1].min())
    assert 2 * np.rad2deg(edge) == pytest.approx(PORT.hfov_deg, abs=1.0)


def test_depth_behind_a_port_counts_from_the_pupil():
    flat = small_reef(FLAT)
    frame = renderer_of(flat, PORT).render(pose(0.0, 0.0, -2.0, 0, 90), noise())
    assert frame.depth == pytest.approx(1.0, abs=2e-4)


@pytest.mark.parametrize(
    ("camera", "model", "n"), [(CAMERA, "plumb_bob", 5), (BROWN, "plumb_bob", 5), (FISHEYE, "equidistant", 4)]
)
def test_the_distortion_travels_in_the_messages(camera, model, n):
    message = camera_info(1, "test", calibration(camera))
    assert model.encode() in message.data
    assert len(coefficients(calibration(camera))) == n
    assert coefficients(calibration(camera))[: len(camera.distortion)] == pytest.approx(camera.distortion)


def test_a_lens_that_folds_its_picture_is_refused():
    with pytest.raises(RecipeError, match=r"camera test: key 'camera.distortion'.*folds"):
        pixel_rays(dataclasses.replace(CAMERA, lens="brown-conrady", distortion=(-2.0, 0.0, 0.0, 0.0)))


@pytest.mark.parametrize(
    ("hfov_deg", "distortion", "message"),
    [
        (150.0, [-0.5, 0.0, 0.0, 0.0], r"'camera\.hfov_deg': distortion = \[-0\.5.*\] folds the image over 47 deg"),
        (150.0, [-0.3, 0.0, 0.0, 0.0], r"folds the image over 60 degrees from the axis.*, got 150$"),
        (
            145.0,
            [0.0] * 4,
            r"the corners would look 89\.9 degrees or more.*expected at most 143\.[0-9] for 640 x 480 px",
        ),
    ],
)
def test_a_fisheye_whose_corners_see_nothing_is_refused_with_the_recipe(hfov_deg, distortion, message):
    changes = {"camera.lens": "fisheye", "camera.hfov_deg": hfov_deg, "camera.distortion": distortion}
    with pytest.raises(RecipeError, match=message) as caught:
        vary_split(SPLIT, {**changes, "camera.width": 640, "camera.height": 480}, "mine.toml")
    assert str(caught.value).startswith("mine.toml")


@pytest.mark.parametrize("port_mm", [None, 10.0])
def test_every_fisheye_that_is_accepted_has_the_field_of_view_that_was_asked_for(port_mm):
    generator = np.random.default_rng(4)
    accepted = 0
    for _ in range(60):
        distortion = tuple(generator.normal(0.0, [0.2, 0.05, 0.02, 0.005]).tolist())
        hfov_deg = float(generator.uniform(40.0, 95.0 if port_mm else 160.0))
        known = {"width": 32, "height": 24, "lens": "fisheye", "hfov_deg": hfov_deg, "port_mm": port_mm}
        camera = dataclasses.replace(CAMERA, distortion=distortion, layer_rate_hz=0.0, **known)
        try:
            camera.check("here")
        except RecipeError:
            continue
        accepted += 1
        rays = pixel_rays(camera).astype(float)
        assert np.isfinite(rays).all()
        steps = np.hypot(*np.diff(rays[12, 17:, :2], axis=0).T)
        assert (steps > 0).all()
        before, after = np.rad2deg(np.arctan(np.hypot(rays[12, 32:34, 0], rays[12, 32:34, 1])))
        assert before < hfov_deg / 2 < after  # the edge lies between the last pixel and the border
    assert accepted > 15


def test_a_view_too_wide_for_a_port_is_refused():
    with pytest.raises(RecipeError, match=r"key 'camera.hfov_deg'.*flat port"):
        rig_calibration(
            dataclasses.replace(SPLIT.rig, camera=(dataclasses.replace(PORT, hfov_deg=120.0),)), SPLIT.sequence[0].site
        )


@pytest.mark.parametrize(("lens", "coefficients"), [("pinhole", [0.1]), ("fisheye", [0.1, 0.0, 0.0])])
def test_a_lens_with_the_wrong_number_of_coefficients_is_refused(lens, coefficients):
    with pytest.raises(RecipeError, match=r"key 'camera.distortion': expected \d coefficients"):
        vary_split(SPLIT, {"camera.lens": lens, "camera.distortion": coefficients}, "here")


@pytest.mark.parametrize(
    ("rig", "cameras"),
    [("bluerov2-views", {"cam_front", "cam_down", "cam_third"}), ("bluerov2-stereo", {"cam_left", "cam_right"})],
)
def test_the_rigs_of_several_cameras_can_be_used_by_any_split(rig, cameras):
    split = parse_split(SPLIT.source.replace('rig = "bluerov2"', f'rig = "{rig}"'), "split.toml")
    known = rig_calibration(split.rig, split.sequence[0].site)["cameras"]
    assert set(known) == cameras
    for camera in split.rig.camera:
        assert np.isfinite(pixel_rays(camera)).all()
    if rig == "bluerov2-stereo":
        left, right = (np.array(known[name]["T_base_cam"]) for name in ("cam_left", "cam_right"))
        assert (np.linalg.inv(left) @ right)[:3, 3] == pytest.approx([0.12, 0.0, 0.0])
