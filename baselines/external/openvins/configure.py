"""The configuration of OpenVINS: the authors' own for EuRoC, with the calibration of the sequence in it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from oysterbench.core.errors import MethodError
from oysterbench.core.geometry import invert
from oysterbench.methods.systems.launch import Launch
from oysterbench.sequence import Sequence
from oysterbench_baselines.external.common.yaml import matrix, replace_values

ESTIMATOR, IMU, CAMERAS = "estimator_config.yaml", "kalibr_imu_chain.yaml", "kalibr_imucam_chain.yaml"
MODELS = {"plumb_bob": "radtan", "equidistant": "equidistant"}


def command(launch: Launch) -> list[str]:
    """Write the three files that OpenVINS reads; its command line."""
    cameras = list(launch.cameras)
    authors = (launch.source / "config" / "euroc_mav" / ESTIMATOR).read_text(encoding="utf-8")
    (launch.folder / ESTIMATOR).write_text(
        estimator(authors, launch.sequence, cameras, launch.options), encoding="utf-8"
    )
    (launch.folder / IMU).write_text(imu_chain(launch.sequence), encoding="utf-8")
    (launch.folder / CAMERAS).write_text(camera_chain(launch.sequence, cameras), encoding="utf-8")
    return [str(launch.build / "openvins"), str(launch.folder / ESTIMATOR), str(launch.given), str(launch.out)]


def estimator(authors: str, sequence: Sequence, cameras: list[str], options: Mapping[str, Any]) -> str:
    """The authors' estimator_config.yaml with what depends on the sequence, and the options."""
    rate_hz = max(sequence.cameras[name].rate_hz for name in cameras)
    ours: dict[str, Any] = {
        "max_cameras": len(cameras),
        "use_stereo": len(cameras) > 1,
        "gravity_mag": sequence.imu_calibration.gravity,
        "track_frequency": rate_hz + 1.0,  # every picture, as 21 is for EuRoC's 20 Hz
        # The first adjustment ends when it has converged. The authors end it after 50 ms of their own machine, in six
        # threads: on a busy one it ends too early, and the same dive is tracked once and lost another time.
        "init_dyn_mle_max_time": 5.0,
        "init_dyn_mle_max_threads": 1,
    }
    return replace_values(authors, {**ours, **options})


def imu_chain(sequence: Sequence) -> str:
    """kalibr_imu_chain.yaml: noise of the inertial unit, whose own axes are the body's."""
    unit = sequence.imu_calibration
    lines = ["%YAML:1.0", "", "imu0:", "  T_i_b:", *matrix(np.eye(4))]
    for key, value in (
        ("accelerometer_noise_density", unit.accel_noise_density),
        ("accelerometer_random_walk", unit.accel_random_walk),
        ("gyroscope_noise_density", unit.gyro_noise_density),
        ("gyroscope_random_walk", unit.gyro_random_walk),
    ):
        lines.append(f"  {key}: {value:.9e}")
    lines += ["  rostopic: /imu0", "  time_offset: 0.0", f"  update_rate: {unit.rate_hz:.1f}", '  model: "kalibr"']
    for key in ("Tw", "R_IMUtoGYRO", "Ta", "R_IMUtoACC"):
        lines += [f"  {key}:", *matrix(np.eye(3))]
    return "\n".join([*lines, "  Tg:", *matrix(np.zeros((3, 3)))]) + "\n"


def camera_chain(sequence: Sequence, cameras: list[str]) -> str:
    """kalibr_imucam_chain.yaml. T_imu_cam takes points of a camera into the inertial unit; t_imu = t_cam + shift.

    Raises MethodError for a camera whose model OpenVINS has not, or of more than four coefficients.
    """
    lines = ["%YAML:1.0", ""]
    for index, name in enumerate(cameras):
        camera = sequence.cameras[name]
        K = camera.matrix
        coefficients = np.append(camera.distortion, np.zeros(4))
        if camera.distortion_model not in MODELS or coefficients[4:].any():
            raise MethodError(
                f"OpenVINS: expected four coefficients of {' or '.join(MODELS)}, got {len(camera.distortion)} of "
                f"{camera.distortion_model}"
            )
        lines += [
            f"cam{index}:",
            "  T_imu_cam:",
            *matrix(invert(sequence.imu_calibration.T_base_imu) @ camera.T_base_cam),
            f"  cam_overlaps: [{', '.join(str(other) for other in range(len(cameras)) if other != index)}]",
            "  camera_model: pinhole",
            f"  distortion_coeffs: [{', '.join(f'{value:.12g}' for value in coefficients[:4])}]",
            f"  distortion_model: {MODELS[camera.distortion_model]}",
            f"  intrinsics: [{K[0, 0]:.9f}, {K[1, 1]:.9f}, {K[0, 2]:.9f}, {K[1, 2]:.9f}]",
            f"  resolution: [{camera.width}, {camera.height}]",
            f"  rostopic: /cam{index}/image_raw",
            f"  timeshift_cam_imu: {0.0 - camera.time_offset_s:.9f}",
        ]
    return "\n".join(lines) + "\n"
