"""Calibrations as measured: drawn errors against the covariance that is stated of them, and who is told what."""

from __future__ import annotations

import json

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

import oysterbench
from oysterbench.core.errors import MethodError, RecipeError
from oysterbench.core.ros import TF_STATIC, decode
from oysterbench.core.streams import Streams
from oysterbench.recipe import SiteRecipe, load_split, parse_split, with_rig
from oysterbench.sensors.registry import calibrate_rig, rig_calibration
from oysterbench.sensors.uncertainty import GOOD, POOR, Uncertainty
from oysterbench.sequence.cut import cut_public
from oysterbench.sequence.export import export_sequence
from oysterbench.sequence.read import TRUE_CALIBRATION, read_messages
from oysterbench.simulation.conditions import conditions
from oysterbench.simulation.generate import generate_split
from tests.helpers.tiny import TINY_RIG, TINY_SPLIT
from tests.simulation.test_sensor_simulation import SENSORS

DRAWS = 200
SITE = SiteRecipe()


@pytest.fixture(scope="module")
def rig():
    return with_rig(load_split("slam-val"), "survey-stereo", "").rig


@pytest.fixture(scope="module")
def draws(rig):
    return [calibrate_rig(rig, SITE, "poor", Streams(seed)) for seed in range(DRAWS)]


def test_drawn_errors_have_the_covariance_that_the_file_states(draws):
    """The sum of squared Mahalanobis distances is chi-square, in all and sensor by sensor."""
    stated = Uncertainty.from_entry(draws[0].given["uncertainty"])
    errors = np.array([list(draw.errors.values()) for draw in draws])
    assert tuple(draws[0].errors) == stated.parameters
    for names in (stated.parameters, *({n for n in stated.parameters if n.startswith(s)} for s in ("cam_left", "dvl"))):
        at = [k for k, name in enumerate(stated.parameters) if name in names]
        sigmas = np.sqrt(np.diag(stated.covariance))[at]
        scaled = stated.covariance[np.ix_(at, at)] / np.outer(sigmas, sigmas)
        values = errors[:, at] / sigmas
        total = np.einsum("ni,ij,nj->", values, np.linalg.inv(scaled), values)
        low, high = chi2.ppf([0.001, 0.999], DRAWS * len(at))
        assert low < total < high
    correlation = np.corrcoef(errors.T)
    scale = np.sqrt(np.diag(stated.covariance))
    np.testing.assert_allclose(correlation, stated.covariance / np.outer(scale, scale), atol=0.3)


def test_what_is_given_is_the_truth_plus_the_error(draws, rig):
    exact = rig_calibration(rig, SITE)
    for draw in draws[:5]:
        given, true, errors = draw.given["cameras"]["cam_left"], exact["cameras"]["cam_left"], draw.errors
        assert given["matrix"][0][0] - true["matrix"][0][0] == pytest.approx(errors["cam_left.focal_x_px"], abs=1e-9)
        assert given["matrix"][1][2] - true["matrix"][1][2] == pytest.approx(
            errors["cam_left.principal_y_px"], abs=1e-9
        )
        turned = Rotation.from_matrix(np.array(true["T_base_cam"])[:3, :3].T @ np.array(given["T_base_cam"])[:3, :3])
        wanted = [errors[f"cam_left.rotation_{axis}_rad"] for axis in "xyz"]
        np.testing.assert_allclose(turned.as_rotvec(), wanted, atol=1e-9)
        shift = np.array(given["T_base_cam"])[:3, 3] - np.array(true["T_base_cam"])[:3, 3]
        np.testing.assert_allclose(shift, [errors[f"cam_left.position_{axis}_m"] for axis in "xyz"], atol=1e-11)
        assert draw.true["cameras"]["cam_left"]["matrix"] == true["matrix"]
        assert draw.given["imu"] == exact["imu"]  # what all else is calibrated against


def test_errors_are_as_large_as_the_sea_makes_them(draws):
    """Of the standard rig: 0.5 % of the focal length, 3.5 px, some 0.5 deg and 5 mm, 20 ms; 1 % and 1 deg."""
    stated = Uncertainty.from_entry(draws[0].given["uncertainty"])
    camera, dvl = stated.of("cam_left"), stated.of("dvl")
    focal = draws[0].true["cameras"]["cam_left"]["matrix"][0][0]
    assert camera.sigma("focal_x_px") / focal == pytest.approx(0.005, rel=0.02)
    assert camera.sigma("principal_x_px") == 3.5
    assert np.degrees(camera.sigma("rotation_y_rad")) == pytest.approx(0.5, abs=0.03)
    assert camera.sigma("position_x_m") == pytest.approx(0.005, rel=0.1)
    assert stated.sigma("cameras.time_offset_s") == 0.02
    assert dvl.sigma("scale") == 0.01
    assert np.degrees(dvl.sigma("rotation_z_rad")) == pytest.approx(1.0)
    with pytest.raises(KeyError, match="focal_x_px"):
        camera.sigma("focal")
    for name in ("focal_share", "principal_px", "camera_deg", "time_offset_s", "dvl_scale", "hard_iron_ut"):
        assert getattr(GOOD, name) < getattr(POOR, name)


def test_a_pair_stays_a_pair(draws):
    """However far both cameras are off, rows of the one are rows of the other to a pixel or two, as calibrated pairs'
    are: the principal points err by 3.5 px each, but the poses found along with them make up for it."""
    rows = []
    for draw in draws:
        pair = [draw.given["cameras"][name] for name in ("cam_left", "cam_right")]
        true = [draw.true["cameras"][name] for name in ("cam_left", "cam_right")]
        point = np.array(true[0]["T_base_cam"]) @ [0.1, -0.1, 1.0, 1.0]
        seen = []
        for given, exact in zip(pair, true, strict=True):
            x, y, z, _ = np.linalg.inv(exact["T_base_cam"]) @ point
            pixel = np.array(exact["matrix"]) @ [x / z, y / z, 1.0]  # where it truly is in the picture
            ray = np.linalg.inv(given["matrix"]) @ pixel
            seen.append(np.array(given["T_base_cam"])[:3, :3] @ ray)
        rows.append(np.cross(*seen) @ (np.array(pair[1]["T_base_cam"]) - pair[0]["T_base_cam"])[:3, 3])
        rows[-1] *= pair[0]["matrix"][1][1] / 0.12  # px, at a base of 120 mm
    assert 0.1 < np.std(rows) < 2.0


def test_exact_is_the_rigs_own_calibration(rig):
    found = calibrate_rig(rig, SITE, "exact", Streams(1))
    assert found.given == found.true == rig_calibration(rig, SITE)
    assert not found.errors


def test_a_quality_that_there_is_not_is_refused():
    with pytest.raises(RecipeError, match=r"key 'sequence.calibration': expected one of exact, good, poor, got 'bad'"):
        tiny("bad")


def tiny(calibration):
    text = TINY_SPLIT.replace("duration_s = 2.5", f'duration_s = 1.5\ncalibration = "{calibration}"')
    return parse_split(text, "tiny.toml", TINY_RIG + SENSORS)


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    folder = tmp_path_factory.mktemp("calibrated")
    return {name: generate_split(tiny(name), folder / name)["tiny-01"] for name in ("exact", "poor")}


def test_camera_info_frames_and_calibration_agree(files):
    sequence = oysterbench.open(files["poor"])
    camera = sequence.cameras["cam_front"]
    (message, *_) = read_messages(files["poor"], ["/cam_front/camera_info"])
    info = decode(message.data, "sensor_msgs/msg/CameraInfo")
    np.testing.assert_array_equal(np.reshape(info.k, (3, 3)), camera.matrix)
    np.testing.assert_array_equal(info.d[:4], camera.distortion)
    (message,) = read_messages(files["poor"], [TF_STATIC])
    frames = {t.child_frame_id: t.transform for t in decode(message.data, "tf2_msgs/msg/TFMessage").transforms}
    for frame, T in (
        ("cam_front_optical_frame", camera.T_base_cam),
        ("dvl_link", sequence.dvl_calibration.T_base_sensor),
    ):
        place, turn = frames[frame].translation, frames[frame].rotation
        np.testing.assert_allclose([place.x, place.y, place.z], T[:3, 3], atol=1e-12)
        rotation = Rotation.from_quat([turn.x, turn.y, turn.z, turn.w]).as_matrix()
        np.testing.assert_allclose(rotation, T[:3, :3], atol=1e-9)
    exact = oysterbench.open(files["exact"]).cameras["cam_front"]
    assert not np.array_equal(camera.matrix, exact.matrix)


@pytest.mark.slow
def test_the_same_dive_is_calibrated_with_the_same_errors_all_through_its_file(tmp_path):
    text = TINY_SPLIT.replace("duration_s = 2.5", 'duration_s = 1.0\ncalibration = "poor"\nsame_dive_as = "other"')
    text += text[text.index("[[sequence]]") :].replace("tiny-01", "other").replace('same_dive_as = "other"', "")
    split = parse_split(text, "tiny.toml", TINY_RIG + SENSORS)
    files = generate_split(split, tmp_path)
    given = [oysterbench.open(file).cameras["cam_front"].matrix for file in files.values()]
    np.testing.assert_array_equal(given[0], given[1])
    for file in files.values():
        (message, *_) = read_messages(file, ["/cam_front/camera_info"])
        info = decode(message.data, "sensor_msgs/msg/CameraInfo")
        np.testing.assert_array_equal(np.reshape(info.k, (3, 3)), given[0])


def test_the_pictures_are_those_of_the_exact_dive_and_their_stamps_are_not(files):
    exact, poor = (list(oysterbench.open(files[name]).images("cam_front")) for name in ("exact", "poor"))
    for a, b in zip(exact, poor, strict=True):
        assert np.array_equal(a.pixels, b.pixels)
    late = np.array([b.stamp_ns - a.stamp_ns for a, b in zip(exact, poor, strict=True)]) * 1e-9
    true = oysterbench.open(files["poor"]).truly_calibrated().cameras["cam_front"]
    assert np.mean(late) == pytest.approx(true.time_offset_s, abs=0.003)
    assert 0.0005 < np.std(late) < 0.008
    assert oysterbench.open(files["poor"]).cameras["cam_front"].time_offset_s == 0.0


def test_errors_of_readings_are_in_the_readings(files):
    exact, poor = (oysterbench.open(files[name]) for name in ("exact", "poor"))
    true = poor.truly_calibrated()
    scale = true.dvl_calibration.scale
    assert poor.dvl_calibration.scale == 1.0 != scale
    for a, b in zip(exact.dvl(), poor.dvl(), strict=True):
        np.testing.assert_allclose(b.velocity, scale * a.velocity, atol=3e-4)  # the noise is not scaled
    given, iron = poor.magnetometer_calibration, true.magnetometer_calibration
    for a, b in zip(exact.magnetometer(), poor.magnetometer(), strict=True):
        bent = (iron.soft_iron - np.eye(3)) @ a.field + iron.hard_iron_t
        np.testing.assert_allclose(b.field, a.field + bent, atol=5e-8)
    np.testing.assert_array_equal(given.soft_iron, np.eye(3))
    assert 0 < np.abs(iron.hard_iron_t - given.hard_iron_t).max() < 1e-5


def test_methods_are_told_the_covariance_and_never_the_truth(files, tmp_path):
    poor = oysterbench.open(files["poor"])
    given = poor.for_method()
    assert given.uncertainty.of("cam_front").sigma("focal_x_px") > 0.1
    np.testing.assert_array_equal(given.cameras["cam_front"].matrix, poor.cameras["cam_front"].matrix)
    with pytest.raises(MethodError, match="truth"):
        given.truly_calibrated()
    assert oysterbench.open(files["exact"]).uncertainty is None
    assert TRUE_CALIBRATION not in oysterbench.open(files["exact"]).attachments
    document = json.loads(poor.attachments[TRUE_CALIBRATION])
    assert set(document["errors"]) == set(given.uncertainty.parameters)
    public = tmp_path / "public.mcap"
    with open(public, "wb") as file:
        cut_public(files["poor"], file)
    shown = oysterbench.open(public)
    assert TRUE_CALIBRATION not in shown.attachments
    assert shown.uncertainty.parameters == given.uncertainty.parameters


def test_qualities_share_their_draws_and_nothing_else_changes(rig):
    """Each cause has a stream of its own: a poor calibration errs the same way as a good one, farther."""
    good, poor = (calibrate_rig(rig, SITE, name, Streams(3)).errors for name in ("good", "poor"))
    assert np.sign(good["dvl.scale"]) == np.sign(poor["dvl.scale"])
    assert poor["dvl.scale"] / good["dvl.scale"] == pytest.approx(POOR.dvl_scale / GOOD.dvl_scale, rel=1e-6)


def test_exported_poses_are_where_the_camera_truly_was_and_its_lens_as_it_is_given(files, tmp_path):
    sequence = oysterbench.open(files["poor"])
    folder, _ = export_sequence(sequence, "tum", tmp_path / "tum")
    written = np.loadtxt(folder / "groundtruth.txt")[:, 1:4]
    truth = sequence.truth()
    true = sequence.truly_calibrated().cameras["cam_front"]
    places = truth.matrices @ np.append(true.T_base_cam[:3, 3], 1.0)
    np.testing.assert_allclose(written, places[:, :3], atol=1e-6)
    focal = np.loadtxt(folder / "calibration.txt", comments="#")[0]
    assert focal == pytest.approx(sequence.cameras["cam_front"].matrix[0, 0])
    assert focal != pytest.approx(true.matrix[0, 0])


def test_conditions_say_how_well_a_dive_was_calibrated():
    assert conditions(tiny("poor"), "tiny-01")["calibration"] == "poor"
    assert "calibration" not in conditions(tiny("exact"), "tiny-01")
