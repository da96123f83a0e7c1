"""The configuration of VINS-Fusion: the authors' own for EuRoC, with the calibration of the sequence in it."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

import numpy as np

from oysterbench.core.errors import MethodError
from oysterbench.core.geometry import invert
from oysterbench.methods.systems.launch import Launch
from oysterbench.sequence import CameraCalibration, Sequence
from oysterbench_baselines.external.common.yaml import opencv_matrix, replace_block, replace_values

CONFIGURATION = "vins.yaml"
LEAST_RATE_HZ = 10.0
"""Of optimisations: "at least 10Hz for good estimation", says the authors' file."""

EUROC_NOISE = {"acc_n": 2.0e-3, "acc_w": 3.0e-3, "gyr_n": 1.6968e-4, "gyr_w": 1.9393e-5}
"""Noise densities of EuRoC's inertial unit (its imu0/sensor.yaml), SI units, by the authors' keys for theirs."""
EUROC_RATE_HZ = 200.0
"""Rate of that unit, for which the authors' values are: they are sigmas of a sample, and not densities."""


def command(launch: Launch) -> list[str]:
    """Write what VINS-Fusion reads; its command line."""
    cameras = list(launch.cameras.values())
    example = f"euroc_{'stereo' if len(cameras) > 1 else 'mono'}_imu_config.yaml"
    authors = (launch.source / "config" / "euroc" / example).read_text(encoding="utf-8")
    text = configuration(authors, launch.sequence, cameras, launch.options)
    (launch.folder / CONFIGURATION).write_text(text, encoding="utf-8")
    for index, camera in enumerate(cameras):
        (launch.folder / f"cam{index}.yaml").write_text(camera_file(camera), encoding="utf-8")
    program = [launch.build / "vins_fusion", launch.folder / CONFIGURATION, launch.given, launch.out]
    return [str(word) for word in program]


def configuration(
    authors: str, sequence: Sequence, cameras: list[CameraCalibration], options: Mapping[str, Any]
) -> str:
    """The authors' file for as many cameras with what depends on the sequence, and the options. Raises MethodError
    where the pictures of two cameras differ in size."""
    unit = sequence.imu_calibration
    sizes = [f"{camera.width} x {camera.height}" for camera in cameras]
    if len(set(sizes)) > 1:
        raise MethodError(
            f"VINS-Fusion has one size for all pictures, got {sequence.name} with {' and '.join(sizes)}; run "
            "vins_fusion_mono"
        )
    values: dict[str, Any] = {
        "cam0_calib": "cam0.yaml",
        "cam1_calib": "cam1.yaml",
        "image_width": cameras[0].width,
        "image_height": cameras[0].height,
        "g_norm": unit.gravity,
        "td": 0.0 - cameras[0].time_offset_s,
        # With it each second picture is optimised: 10 Hz of EuRoC's 20, the least that the authors advise.
        "multiple_thread": int(cameras[0].rate_hz >= 2 * LEAST_RATE_HZ),
        "max_solver_time": 10.0,  # an optimisation ends with its iterations, not after 40 ms of a busy machine
        "show_track": 0,  # draws what nobody sees
    }
    ours = {
        "acc_n": unit.accel_noise_density,
        "acc_w": unit.accel_random_walk,
        "gyr_n": unit.gyro_noise_density,
        "gyr_w": unit.gyro_random_walk,
    }
    per_sample = float(np.sqrt(unit.rate_hz / EUROC_RATE_HZ))
    for key, density in ours.items():
        values[key] = number(authors, key) * density / EUROC_NOISE[key] * per_sample
    text = replace_values(authors, {**values, **options})
    for index, camera in enumerate(cameras):
        lines = opencv_matrix(invert(unit.T_base_imu) @ camera.T_base_cam)
        text = replace_block(text, f"body_T_cam{index}", [line.replace("dt: f", "dt: d") for line in lines])
    return text


def number(text: str, key: str) -> float:
    """The value of a key of a flat file. Raises MethodError where it has none."""
    found = re.search(rf"^{key}:[ \t]*([-+.\deE]+)", text, re.M)
    if found is None:
        raise MethodError(f"the authors' configuration has no number {key!r}")
    return float(found[1])


def camera_file(camera: CameraCalibration) -> str:
    """Intrinsics as camera_models reads them: its models PINHOLE, PINHOLE_FULL and KANNALA_BRANDT."""
    K = camera.matrix
    k = np.append(camera.distortion, np.zeros(5))
    if camera.distortion_model == "equidistant":
        model, bent = "KANNALA_BRANDT", {}
        projection = {f"k{2 + index}": k[index] for index in range(4)}
        projection |= {"mu": K[0, 0], "mv": K[1, 1], "u0": K[0, 2], "v0": K[1, 2]}
    elif camera.distortion_model == "plumb_bob":
        model, bent = "PINHOLE", {"k1": k[0], "k2": k[1], "p1": k[2], "p2": k[3]}
        projection = {"fx": K[0, 0], "fy": K[1, 1], "cx": K[0, 2], "cy": K[1, 2]}
        if k[4]:
            model, bent = "PINHOLE_FULL", {**bent, "k3": k[4], "k4": 0.0, "k5": 0.0, "k6": 0.0}
    else:
        raise MethodError(f"VINS-Fusion: expected cameras plumb_bob or equidistant, got {camera.distortion_model}")
    lines = ["%YAML:1.0", "---", f"model_type: {model}", "camera_name: camera"]
    lines += [f"image_width: {camera.width}", f"image_height: {camera.height}"]
    for key, block in (("distortion_parameters", bent), ("projection_parameters", projection)):
        lines += [f"{key}:", *(f"   {name}: {float(value)!r}" for name, value in block.items())] if block else []
    return "\n".join(lines) + "\n"
