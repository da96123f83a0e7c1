"""The configuration of Basalt, the authors' own for EuRoC, and the calibration of the sequence in its form."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from oysterbench.core.errors import MethodError
from oysterbench.core.geometry import Array, invert
from oysterbench.methods.systems.launch import Launch
from oysterbench.sequence import CameraCalibration, Sequence

CONFIGURATION, CALIBRATION = "config.json", "calibration.json"
MODELS = {
    "plumb_bob": ("pinhole-radtan8", ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")),
    "equidistant": ("kb4", ("k1", "k2", "k3", "k4")),
}


def command(launch: Launch) -> list[str]:
    """Write configuration and calibration; the command line."""
    cameras = list(launch.cameras.values())
    authors = (launch.source / "data" / "euroc_config.json").read_text(encoding="utf-8")
    options = dict(launch.options)
    noise = options.pop("noise_factor")
    written = [launch.folder / CONFIGURATION, launch.folder / CALIBRATION]
    texts = [configuration(authors, options), calibration(launch.sequence, cameras, noise)]
    for path, text in zip(written, texts, strict=True):
        path.write_text(text, encoding="utf-8")
    program = [launch.build / "basalt", *written, launch.given, launch.out]
    return [str(word) for word in (*program, launch.sequence.imu_calibration.gravity)]


def configuration(authors: str, options: Mapping[str, Any]) -> str:
    """The authors' file with the options. Raises MethodError for a key that it lacks."""
    found = json.loads(authors)
    for key, value in options.items():
        if f"config.{key}" not in found["value0"]:
            raise MethodError(f"the authors' configuration has no key {key!r}")
        kind = type(found["value0"][f"config.{key}"])
        found["value0"][f"config.{key}"] = kind(value)
    return json.dumps(found, indent=4) + "\n"


def calibration(sequence: Sequence, cameras: list[CameraCalibration], noise: float = 1.0) -> str:
    """A calibration as Basalt reads it: T_imu_cam takes points of a camera into the unit, t_imu = t_cam + offset.

    noise: times the densities of the unit
    Its constant biases, scales and turns of axes are zero, as nobody calibrated them; its odometry uses no vignette.
    """
    unit = sequence.imu_calibration
    values = {
        "T_imu_cam": [pose(invert(unit.T_base_imu) @ camera.T_base_cam) for camera in cameras],
        "intrinsics": [intrinsics(camera) for camera in cameras],
        "resolution": [[camera.width, camera.height] for camera in cameras],
        "calib_accel_bias": [0.0] * 9,
        "calib_gyro_bias": [0.0] * 12,
        "imu_update_rate": unit.rate_hz,
        "accel_noise_std": [noise * unit.accel_noise_density] * 3,
        "gyro_noise_std": [noise * unit.gyro_noise_density] * 3,
        "accel_bias_std": [noise * unit.accel_random_walk] * 3,
        "gyro_bias_std": [noise * unit.gyro_random_walk] * 3,
        "cam_time_offset_ns": -round(1e9 * cameras[0].time_offset_s),
        "vignette": [],
    }
    return json.dumps({"value0": values}, indent=4) + "\n"


def pose(T: Array) -> dict[str, float]:
    """A pose (4, 4) by its position and quaternion."""
    quaternion = Rotation.from_matrix(T[:3, :3]).as_quat(canonical=True)
    names = ("px", "py", "pz", "qx", "qy", "qz", "qw")
    return dict(zip(names, map(float, (*T[:3, 3], *quaternion)), strict=True))


def intrinsics(camera: CameraCalibration) -> dict[str, Any]:
    """The lens. Raises MethodError for a model that Basalt has not."""
    if camera.distortion_model not in MODELS:
        raise MethodError(f"Basalt: expected a camera of {' or '.join(MODELS)}, got {camera.distortion_model}")
    model, names = MODELS[camera.distortion_model]
    K = camera.matrix
    values = {"fx": K[0, 0], "fy": K[1, 1], "cx": K[0, 2], "cy": K[1, 2]}
    values |= dict(zip(names, np.append(camera.distortion, np.zeros(len(names))), strict=False))
    if model == "pinhole-radtan8":
        values["rpmax"] = -1.0  # where the lens folds back: Basalt is to find out
    return {"camera_type": model, "intrinsics": {key: float(value) for key, value in values.items()}}
