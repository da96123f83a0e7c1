"""Kalibr's files of cameras and inertial unit."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import yaml

import oysterbench
from oysterbench.core.geometry import invert
from oysterbench.sequence.export import export_sequence
from oysterbench.sequence.export.kalibr import write_calibration
from tests.helpers import hand_made_dive as dive

T_BASE_IMU = np.array(dive.calibration()["imu"]["T_base_imu"])


def test_kalibr_chains_imu_and_cameras(sequence, folders):
    chain = yaml.safe_load((folders["kalibr"] / "camchain-imucam.yaml").read_text())
    point_imu = np.array([1.0, 0.2, -0.4, 1.0])
    point_base = T_BASE_IMU @ point_imu
    for key, name in (("cam0", "cam_left"), ("cam1", "cam_right")):
        entry = chain[key]
        there = invert(sequence.cameras[name].T_base_cam) @ point_base
        np.testing.assert_allclose(np.array(entry["T_cam_imu"]) @ point_imu, there, atol=1e-12)
        assert entry["intrinsics"] == [60.0, 60.0, 31.5, 23.5]
        assert entry["rostopic"] == f"/{name}/image"
        assert (entry["camera_model"], entry["distortion_model"]) == ("pinhole", "radtan")
    assert [chain[key]["cam_overlaps"] for key in ("cam0", "cam1")] == [[1], [0]]
    T_right_left = np.array(chain["cam1"]["T_cn_cnm1"])
    np.testing.assert_allclose(T_right_left[:3, 3], [-0.12, 0, 0], atol=1e-12)
    unit = yaml.safe_load((folders["kalibr"] / "imu.yaml").read_text())
    assert unit == {
        "accelerometer_noise_density": 1e-3,
        "accelerometer_random_walk": 1e-4,
        "gyroscope_noise_density": 1e-4,
        "gyroscope_random_walk": 1e-5,
        "rostopic": "/imu",
        "update_rate": 100.0,
    }


def test_cameras_that_look_elsewhere_overlap_with_none(sequence, tmp_path):
    turned = oysterbench.open(sequence.path)
    right = sequence.cameras["cam_right"]
    T_base_back = right.T_base_cam @ np.diag([-1.0, 1.0, -1.0, 1.0])
    turned.cameras = {**sequence.cameras, "cam_right": replace(right, T_base_cam=T_base_back)}
    write_calibration(turned, tmp_path, ["/left", "/back"], "/imu")
    chain = yaml.safe_load((tmp_path / "camchain-imucam.yaml").read_text())
    assert [chain[key]["cam_overlaps"] for key in ("cam0", "cam1")] == [[], []]


@pytest.mark.parametrize("truth", [True, False])
def test_kalibr_has_the_given_offset_whatever_the_clocks_of_the_rig(sequence, tmp_path, truth):
    folder, _ = export_sequence(sequence, "kalibr", tmp_path / "out", truth)
    chain = yaml.safe_load((folder / "camchain-imucam.yaml").read_text())
    assert b"clock_offset_ms" in sequence.attachments["rig.toml"]
    assert [chain[cam]["timeshift_cam_imu"] for cam in ("cam0", "cam1")] == [0.0, 0.0]
