"""COLMAP reads the folder as it is: its options go to `reconstruct.py`."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from oysterbench.core.errors import MethodError
from oysterbench.methods.systems.launch import Launch
from oysterbench.sequence import CameraCalibration

MODELS = {"plumb_bob": "OPENCV", "equidistant": "OPENCV_FISHEYE"}
FIRST_PIXEL = 0.5
"""Coordinate of the centre of the first pixel, which in our camera matrices is at 0."""


def command(launch: Launch) -> list[str]:
    """Write options and camera as JSON; the command line of the script, under the interpreter that has pycolmap."""
    name, camera = next(iter(launch.cameras.items()))
    model, parameters = lens_of(camera)
    task = {
        **launch.options,
        "camera": name,
        "camera_model": model,
        "camera_params": parameters,
        "frame_rate_hz": camera.rate_hz,
        "shift_ns": -round(1e9 * camera.time_offset_s),
        "seed": launch.number,
    }
    (launch.folder / "task.json").write_text(json.dumps(task, indent=1), encoding="utf-8")
    script = Path(__file__).with_name("reconstruct.py")
    words = [launch.build.parent / "venv" / "bin" / "python", script]
    return [str(word) for word in (*words, launch.folder / "task.json", launch.given, launch.out)]


def lens_of(camera: CameraCalibration) -> tuple[str, list[float]]:
    """A camera's model in COLMAP, and its parameters fx, fy, cx, cy, k1 and so on in px of its image coordinates.

    Raises MethodError for a model that it does not have.
    """
    coefficients = np.append(camera.distortion, np.zeros(5))
    if camera.distortion_model not in MODELS or coefficients[5:].any():
        raise MethodError(
            f"COLMAP: expected at most five coefficients of {' or '.join(MODELS)}, got {len(camera.distortion)} of "
            f"{camera.distortion_model}"
        )
    model, used = MODELS[camera.distortion_model], coefficients[:4]
    if coefficients[4]:  # k3
        model, used = "FULL_OPENCV", np.append(coefficients[:5], np.zeros(3))
    K = camera.matrix
    centre = (K[0, 2] + FIRST_PIXEL, K[1, 2] + FIRST_PIXEL)
    return model, [float(value) for value in (K[0, 0], K[1, 1], *centre, *used)]
