"""TUM's layout of RGB-D sequences."""

from __future__ import annotations

import json
from dataclasses import replace

import cv2
import numpy as np
from evo.core import metrics, sync
from evo.tools import file_interface

from oysterbench.core.trajectory import read_trajectory
from oysterbench.sequence.export import export_sequence
from oysterbench.sequence.export.port import lens_centre_m
from oysterbench.sequence.types import imu_arrays
from tests.helpers import hand_made_dive as dive

T_BASE_LEFT = np.array(dive.calibration()["cameras"]["cam_left"]["T_base_cam"])


def png(path):
    """Pixels as they are in the file; colour as RGB."""
    pixels = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
    return cv2.cvtColor(pixels, cv2.COLOR_BGR2RGB) if pixels.ndim == 3 else pixels


def rows(path):
    return [line.split() for line in path.read_text().splitlines() if not line.startswith("#")]


def test_tum_images_and_depth_are_equal(sequence, folders):
    root = folders["tum"]
    colour, depth = rows(root / "rgb.txt"), rows(root / "depth.txt")
    images, maps = list(sequence.images("cam_left")), list(sequence.layer("cam_left", "depth"))
    assert len(colour) == len(images) == 20
    assert len(depth) == len(maps) == 4
    for (stamp, file), image in zip(colour, images, strict=True):
        assert stamp.replace(".", "") == str(image.stamp_ns)
        assert np.array_equal(png(root / file), image.pixels)
    for (stamp, file), image in zip(depth, maps, strict=True):
        steps = png(root / file)
        assert steps.dtype == np.uint16
        assert stamp.replace(".", "") == str(image.stamp_ns)
        far = image.pixels > 65535 / 5000
        np.testing.assert_allclose(steps[~far] / 5000, image.pixels[~far], atol=1e-6)
        assert not steps[far].any()
        assert (steps > 0).mean() > 0.9


def test_tum_ground_truth_is_the_camera_and_loads_in_evo(sequence, folders):
    path = folders["tum"] / "groundtruth.txt"
    poses = sequence.truth().matrices @ T_BASE_LEFT
    back = read_trajectory(path)
    assert np.array_equal(back.stamps_ns, sequence.truth().stamps_ns)
    np.testing.assert_allclose(back.matrices, poses, atol=1e-9)
    loaded = file_interface.read_tum_trajectory_file(str(path))
    np.testing.assert_allclose(loaded.positions_xyz, poses[:, :3, 3], atol=1e-9)
    pair = sync.associate_trajectories(loaded, loaded)
    error = metrics.APE(metrics.PoseRelation.full_transformation)
    error.process_data(pair)
    assert error.get_statistic(metrics.StatisticsType.max) < 1e-9


def test_tum_accelerometer_is_the_imus(sequence, folders):
    table = rows(folders["tum"] / "accelerometer.txt")
    _, _, accel = imu_arrays(sequence.imu())
    assert np.array_equal(np.array([row[1:] for row in table], dtype=float), accel)


def test_the_lists_have_three_lines_before_the_first_row(folders):
    """ORB-SLAM2 and ORB-SLAM3 skip three of rgb.txt, so that with fewer they would never see the first image."""
    for name in ("rgb", "depth", "accelerometer", "groundtruth"):
        lines = (folders["tum"] / f"{name}.txt").read_text().splitlines()
        assert [line.startswith("# ") for line in lines[:5]] == [True, True, True, False, False]
        assert lines[2].startswith("# timestamp ")


def test_tum_without_truth_has_neither_poses_nor_depth(sequence, tmp_path):
    folder, notes = export_sequence(sequence, "tum", tmp_path / "blind", truth=False)
    assert sorted(path.name for path in folder.iterdir()) == [
        "README.txt",
        "accelerometer.txt",
        "calibration.txt",
        "rgb",
        "rgb.txt",
    ]
    assert any("depth is truth" in note for note in notes)


def test_behind_a_flat_port_the_folder_says_where_depth_is_measured_from(sequence, tmp_path, monkeypatch):
    true = dive.calibration()
    left = true["cameras"]["cam_left"]
    shift = np.array(left["T_base_cam"])
    shift[:3, 3] += 0.005 * shift[:3, 2]  # along the optical axis, by an error of the calibration
    true["cameras"]["cam_left"] = left | {"T_base_cam": shift.tolist(), "port": {"distance_m": 0.01, "index": 1.33}}
    known = {**sequence.attachments, "truth/calibration.json": json.dumps(true).encode()}
    monkeypatch.setattr(sequence, "attachments", known)
    text = (export_sequence(sequence, "tum", tmp_path / "port")[0] / "README.txt").read_text()
    behind = lens_centre_m(replace(sequence.cameras["cam_left"], port_m=0.01, port_index=1.33))
    assert f"Depth and poses are those of its pupil, {-1e3 * behind:.2f} mm in front of" in text
    blind = export_sequence(sequence, "tum", tmp_path / "blind", truth=False)[0]
    assert "flat port" not in (blind / "README.txt").read_text()
