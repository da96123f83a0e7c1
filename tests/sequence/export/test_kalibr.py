"""Kalibr's files of cameras and inertial unit."""

from __future__ import annotations

import numpy as np
import pytest
import yaml

from oysterbench.core.geometry import invert
from oysterbench.sequence.export import export_sequence
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
    T_right_left = np.array(chain["cam1"]["T_cn_cnm1"])
    np.testing.assert_allclose(T_right_left[:3, 3], [-0.12, 0, 0], atol=1e-12)
    # The IMU's stamps are 1 ms late, the left camera's 4 ms: t_imu = t_cam + shift.
    assert chain["cam0"]["timeshift_cam_imu"] == pytest.approx(-0.003)
    assert chain["cam1"]["timeshift_cam_imu"] == pytest.approx(0.001)
    unit = yaml.safe_load((folders["kalibr"] / "imu.yaml").read_text())
    assert unit == {
        "accelerometer_noise_density": 1e-3,
        "accelerometer_random_walk": 1e-4,
        "gyroscope_noise_density": 1e-4,
        "gyroscope_random_walk": 1e-5,
        "rostopic": "/imu",
        "update_rate": 100.0,
    }


def test_kalibr_without_truth_knows_no_offset_that_was_not_measured(sequence, tmp_path):
    folder, _ = export_sequence(sequence, "kalibr", tmp_path / "blind", truth=False)
    chain = yaml.safe_load((folder / "camchain-imucam.yaml").read_text())
    assert [chain[cam]["timeshift_cam_imu"] for cam in ("cam0", "cam1")] == [0.0, 0.0]
