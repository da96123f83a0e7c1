"""The camera of DSO, in its own form; its settings are those of its program."""

from __future__ import annotations

import numpy as np

from oysterbench.core.errors import MethodError
from oysterbench.methods.systems.launch import Launch
from oysterbench.sequence import CameraCalibration

CAMERA = "camera.txt"
LEVELS = 16
"""Sides of the pictures are multiples of it, as DSO halves them while they are even."""


def command(launch: Launch) -> list[str]:
    """Write the camera; the command line."""
    camera = next(iter(launch.cameras.values()))
    (launch.folder / CAMERA).write_text(camera_file(camera), encoding="utf-8")
    shift_s = 0.0 - camera.time_offset_s
    program = [launch.build / "dso", launch.folder / CAMERA, launch.given, launch.out, shift_s]
    return [*map(str, program), *(f"{key}={value}" for key, value in launch.options.items())]


def camera_file(camera: CameraCalibration) -> str:
    """Model, size of the pictures, how they are undistorted, and to what size: cropped to where all is seen."""
    K = camera.matrix
    k = np.append(camera.distortion, np.zeros(5))
    if camera.distortion_model not in ("plumb_bob", "equidistant") or (camera.distortion_model == "plumb_bob" and k[4]):
        raise MethodError(
            f"DSO: expected a camera equidistant or plumb_bob with k1, k2, p1, p2; got {camera.distortion_model} with "
            f"{camera.distortion.tolist()}"
        )
    model = "RadTan" if camera.distortion_model == "plumb_bob" else "KannalaBrandt"
    numbers = [K[0, 0], K[1, 1], K[0, 2], K[1, 2], *k[:4]]
    width, height = (side - side % LEVELS for side in (camera.width, camera.height))
    # Without any coefficients only a pinhole leaves the images as they are: `none` passes them through.
    pinhole = camera.distortion_model == "plumb_bob" and not k.any()
    straight = pinhole and (width, height) == (camera.width, camera.height)
    lines = [f"{model} {' '.join(repr(float(number)) for number in numbers)}", f"{camera.width} {camera.height}"]
    return "\n".join([*lines, "none" if straight else "crop", f"{width} {height}"]) + "\n"
