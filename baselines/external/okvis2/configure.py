"""The configuration of OKVIS2: the authors' own for EuRoC, with the calibration of the sequence in it."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

import numpy as np

from oysterbench.core.errors import MethodError
from oysterbench.core.geometry import Array, invert
from oysterbench.methods.systems.launch import Launch
from oysterbench.sequence import CameraCalibration, Sequence
from oysterbench_baselines.external.common.yaml import plain

CONFIGURATION = "config.yaml"
MODELS = {"plumb_bob": "radialtangential", "equidistant": "equidistant"}
ONE_THREAD = {"parallelise_detection": False, "num_matching_threads": 1}
WINDOWS = {"display_matches": False, "display_overhead": False}


def command(launch: Launch) -> list[str]:
    """Write the configuration; the command line."""
    cameras = list(launch.cameras.values())
    authors = (launch.source / "config" / "euroc.yaml").read_text(encoding="utf-8")
    written = launch.folder / CONFIGURATION
    written.write_text(configuration(authors, launch.sequence, cameras, launch.options), encoding="utf-8")
    program = [launch.build / "okvis2", written, launch.source / "resources"]
    return [str(word) for word in (*program, launch.given, launch.out, 0.0 - cameras[0].time_offset_s)]


def configuration(
    authors: str, sequence: Sequence, cameras: list[CameraCalibration], options: Mapping[str, Any]
) -> str:
    """The authors' file with what depends on the sequence, and the options."""
    unit = sequence.imu_calibration
    factor = options["noise_factor"]
    ours: dict[str, Any] = {
        "sync_cameras": list(range(len(cameras))),
        "sigma_g_c": factor * unit.gyro_noise_density,
        "sigma_a_c": factor * unit.accel_noise_density,
        "sigma_gw_c": factor * unit.gyro_random_walk,
        "sigma_aw_c": factor * unit.accel_random_walk,
        "g": unit.gravity,
        "a0": [0.0, 0.0, 0.0],  # the authors' is that of EuRoC's unit
    }
    asked = {key: value for key, value in options.items() if key != "noise_factor"}
    text = replace_nested(authors, {**ours, **ONE_THREAD, **WINDOWS, **asked})
    extrinsics = [camera_entry(camera, invert(unit.T_base_imu) @ camera.T_base_cam) for camera in cameras]
    return re.sub(
        r"^cameras:\n(?:[ \t].*\n|\n)+", lambda _: "cameras:\n" + "".join(extrinsics) + "\n", text, flags=re.M
    )


def camera_entry(camera: CameraCalibration, T_imu_cam: Array) -> str:
    """A camera as the authors write it. Raises MethodError for a model that OKVIS2 has not, or of five coefficients."""
    coefficients = np.append(camera.distortion, np.zeros(4))
    if camera.distortion_model not in MODELS or coefficients[4:].any():
        raise MethodError(
            f"OKVIS2: expected four coefficients of {' or '.join(MODELS)}, got {len(camera.distortion)} of "
            f"{camera.distortion_model}"
        )
    K = camera.matrix
    fields = {
        "T_SC": sequence_of(np.ravel(T_imu_cam)),
        "image_dimension": f"[{camera.width}, {camera.height}]",
        "distortion_coefficients": sequence_of(coefficients[:4]),
        "distortion_type": MODELS[camera.distortion_model],
        "focal_length": sequence_of([K[0, 0], K[1, 1]]),
        "principal_point": sequence_of([K[0, 2], K[1, 2]]),
        "camera_type": "gray",
        "slam_use": "okvis",
    }
    return "     - {" + ",\n        ".join(f"{key}: {value}" for key, value in fields.items()) + "}\n"


def replace_nested(text: str, values: Mapping[str, Any]) -> str:
    """A text of indented `key: value` lines with other values; comments stay. Raises MethodError for a key it lacks."""
    for key, value in values.items():
        found = list(re.finditer(rf"^[ \t]+{re.escape(key)}:[ \t]*(\[[^\]]*\]|[^#\s]+)", text, re.M))
        if len(found) != 1:
            raise MethodError(f"the authors' configuration has {len(found)} keys {key!r}; expected 1")
        (one,) = found
        written = sequence_of(value) if isinstance(value, list) else plain(value, "." in one[1])
        text = text[: one.start(1)] + written + text[one.end(1) :]
    return text


def sequence_of(values: Any) -> str:
    """Numbers in a row; whole ones stay whole."""
    return f"[{', '.join(repr(value) if isinstance(value, int) else repr(float(value)) for value in values)}]"
