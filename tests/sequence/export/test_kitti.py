"""KITTI's layout of odometry sequences."""

from __future__ import annotations

import json
from dataclasses import replace

import cv2
import numpy as np
import pytest
from evo.tools import file_interface

from oysterbench.core.geometry import invert, transform
from oysterbench.sequence.export import export_sequence
from oysterbench.sequence.export.kitti import _projections
from oysterbench.sequence.export.port import lens_centre_m
from tests.helpers import hand_made_dive as dive

T_BASE_LEFT = np.array(dive.calibration()["cameras"]["cam_left"]["T_base_cam"])


def test_kitti_is_a_stereo_pair_with_poses_of_the_left_camera(sequence, folders):
    root = folders["kitti"]
    place = root / "sequences" / "00"
    times = np.loadtxt(place / "times.txt")
    images = list(sequence.images("cam_left"))
    np.testing.assert_allclose(times, np.arange(20) * 0.1, atol=1e-9)
    for index, name in enumerate(("cam_left", "cam_right")):
        files = sorted((place / f"image_{index}").iterdir())
        assert [file.name for file in files] == [f"{k:06d}.png" for k in range(20)]
        whole = list(sequence.images(name))
        assert all(
            np.array_equal(cv2.imread(str(file), cv2.IMREAD_UNCHANGED), cv2.cvtColor(image.pixels, cv2.COLOR_RGB2GRAY))
            for file, image in zip(files, whole, strict=True)
        )
    loaded = file_interface.read_kitti_poses_file(str(root / "poses" / "00.txt"))
    stamps = np.array([image.stamp_ns for image in images])
    poses = sequence.truth().at(stamps[stamps <= sequence.truth().stamps_ns[-1]]).matrices @ T_BASE_LEFT
    np.testing.assert_allclose(np.array(loaded.poses_se3), invert(poses[0]) @ poses, atol=1e-9)
    np.testing.assert_allclose(loaded.poses_se3[0], np.eye(4), atol=1e-12)


def test_behind_a_flat_port_the_poses_are_those_of_the_lens_that_the_images_were_undistorted_with(
    sequence, folders, tmp_path, monkeypatch
):
    true = dive.calibration()
    left = true["cameras"]["cam_left"]
    behind = replace(sequence.cameras["cam_left"], port_m=0.01, port_index=1.33)
    assert -0.008 < lens_centre_m(behind) < -0.003
    pupil = T_BASE_LEFT @ transform(np.eye(3), np.array([0.0, 0.0, -lens_centre_m(behind)]))
    true["cameras"]["cam_left"] = left | {"T_base_cam": pupil.tolist(), "port": {"distance_m": 0.01, "index": 1.33}}
    known = {**sequence.attachments, "truth/calibration.json": json.dumps(true).encode()}
    monkeypatch.setattr(sequence, "attachments", known)
    poses, without = (
        np.loadtxt(root / "poses" / "00.txt")
        for root in (export_sequence(sequence, "kitti", tmp_path / "port")[0], folders["kitti"])
    )
    np.testing.assert_allclose(poses, without, atol=1e-8)


def test_kitti_numbers_images_by_their_stamps_where_one_is_repeated(sequence, folders, tmp_path, monkeypatch):
    read = sequence.images
    monkeypatch.setattr(sequence, "images", lambda name: (image for image in read(name) for _ in range(2)))
    folder, _ = export_sequence(sequence, "kitti", tmp_path / "repeated")
    place, once = (root / "sequences" / "00" for root in (folder, folders["kitti"]))
    assert (place / "times.txt").read_text() == (once / "times.txt").read_text()
    for index in (0, 1):
        written, expected = (
            {file.name: file.read_bytes() for file in (root / f"image_{index}").iterdir()} for root in (place, once)
        )
        assert written == expected


def test_kitti_projects_a_point_where_each_camera_sees_it(sequence, folders):
    text = (folders["kitti"] / "sequences" / "00" / "calib.txt").read_text()
    lines = [line.split() for line in text.splitlines()]
    assert [line[0] for line in lines] == ["P0:", "P1:", "P2:", "P3:", "Tr:"]
    T_left_base = np.vstack([np.array(lines[4][1:], dtype=float).reshape(3, 4), [0, 0, 0, 1]])
    np.testing.assert_allclose(T_left_base @ T_BASE_LEFT, np.eye(4), atol=1e-9)
    point = np.array([0.1, -0.05, 1.3, 1.0])  # in the left camera's frame
    for line, name in zip(lines, ("cam_left", "cam_right"), strict=False):
        camera = sequence.cameras[name]
        u = np.array(line[1:], dtype=float).reshape(3, 4) @ point
        here = invert(camera.T_base_cam) @ T_BASE_LEFT @ point
        v = camera.matrix @ here[:3]
        np.testing.assert_allclose(u[:2] / u[2], v[:2] / v[2], atol=1e-9)
    baseline = (float(lines[0][4]) - float(lines[1][4])) / float(lines[1][1])
    assert baseline == pytest.approx(0.12)


def test_kitti_opens_in_pykitti(sequence, folders):
    pykitti = pytest.importorskip("pykitti", reason="pykitti is not installed")
    loaded = pykitti.odometry(str(folders["kitti"]), "00")
    assert len(loaded) == len(loaded.cam0_files) == len(loaded.cam1_files) == 20
    assert loaded.calib.b_gray == pytest.approx(0.12)
    np.testing.assert_allclose(loaded.calib.T_cam0_velo @ T_BASE_LEFT, np.eye(4), atol=1e-9)
    np.testing.assert_allclose(loaded.calib.K_cam0, sequence.cameras["cam_left"].matrix)
    assert [time.total_seconds() for time in loaded.timestamps] == pytest.approx(np.arange(20) * 0.1, abs=1e-6)
    assert len(loaded.poses) == len(loaded.cam0_files)
    left, right = next(loaded.gray)
    whole = next(iter(sequence.images("cam_left"))).pixels
    assert np.array_equal(np.array(left), cv2.cvtColor(whole, cv2.COLOR_RGB2GRAY))
    assert right.size == left.size


def test_kitti_has_four_projections_of_a_camera_alone(sequence):
    lines = _projections(sequence, ["cam_left"], sequence.cameras["cam_left"].matrix)
    assert [line[:3] for line in lines] == ["P0:", "P1:", "P2:", "P3:"]
    assert len({line[3:] for line in lines}) == 1
