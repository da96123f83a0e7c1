"""Calibration errors of cameras: intrinsics, the pose relative to the IMU, and the clock."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from oysterbench.sensors.uncertainty import DIGITS, RADIAL_RATIO, REFERENCE_PX, ErrorModel, Quality, axes

K2_SHARE = 0.3  # independent error of k2, as a share of k1's error
SHARED = "cameras"  # prefix of errors that all cameras of a rig share: they sit on one frame and have one trigger


def camera_errors(entry: Mapping[str, Any], quality: Quality) -> ErrorModel:
    """Error model of a camera's entry in calibration.json.

    A calibration that puts the principal point e px too far to the right also turns the camera by e / f to the right,
    since it saw its targets where they were: the two errors are correlated, as in any bundle adjustment. All cameras
    share a rotation and a displacement relative to the IMU, about the origin of base_link, and each adds a little.
    """
    matrix, T = np.array(entry["matrix"]), np.array(entry["T_base_cam"])
    fx, fy = matrix[0, 0], matrix[1, 1]
    principal = quality.principal_px * entry["width"] / REFERENCE_PX
    errors: dict[str, dict[str, float]] = {
        "focal_x_px": {"focal": fx * quality.focal_share, "aspect": 0.5 * fx * quality.aspect_share},
        "focal_y_px": {"focal": fy * quality.focal_share, "aspect": -0.5 * fy * quality.aspect_share},
        "principal_x_px": {"principal_x": principal},
        "principal_y_px": {"principal_y": principal},
        "k1": {"radial": quality.radial},
        "k2": {"radial": RADIAL_RATIO * quality.radial, "k2": K2_SHARE * quality.radial},
    }
    if entry["distortion_model"] == "plumb_bob":
        errors |= {"p1": {"p1": quality.tangential}, "p2": {"p2": quality.tangential}}
    turn, pair = np.radians([quality.camera_deg, quality.pair_deg])
    # Rotation vectors in base_link, expressed in the camera's frame, and how they displace a camera at p: theta x p.
    turning, (x, y, z) = T[:3, :3].T, T[:3, 3]
    moving = np.array([[0.0, z, -y], [-z, 0.0, x], [y, -x, 0.0]])
    making_up = {0: {"principal_y": -principal / fy}, 1: {"principal_x": principal / fx}}
    for k, (rotation, position) in enumerate(zip(axes("rotation", "rad"), axes("position", "m"), strict=True)):
        together = {f"{SHARED}.rotation_{axis}": (turn * turning[k, j], turn * moving[k, j]) for j, axis in _XYZ}
        errors[rotation] = {cause: sizes[0] for cause, sizes in together.items()} | {rotation: pair}
        errors[rotation] |= making_up.get(k, {})
        errors[position] = {cause: sizes[1] for cause, sizes in together.items()} | {position: quality.pair_m}
        errors[position][f"{SHARED}.position_{'xyz'[k]}"] = quality.camera_m
    errors[f"{SHARED}.time_offset_s"] = {f"{SHARED}.time_offset_s": quality.time_offset_s}
    return ErrorModel.of(errors)


_XYZ = tuple(enumerate("xyz"))


def with_errors(entry: Mapping[str, Any], errors: Mapping[str, float]) -> dict[str, Any]:
    """Matrix and distortion of an entry, with the errors added."""
    matrix = np.array(entry["matrix"], dtype=float)
    for row, axis in enumerate("xy"):
        matrix[row, row] += errors[f"focal_{axis}_px"]
        matrix[row, 2] += errors[f"principal_{axis}_px"]
    names = ("k1", "k2", "p1", "p2") if entry["distortion_model"] == "plumb_bob" else ("k1", "k2")
    distortion = np.array(entry["distortion"], dtype=float)
    distortion[: len(names)] += [errors[name] for name in names]
    return {"matrix": np.round(matrix, DIGITS).tolist(), "distortion": np.round(distortion, DIGITS).tolist()}
