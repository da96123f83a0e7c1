"""Kalibr's files: the camera chain and the IMU. T_cam_imu takes points of the IMU into the camera."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import numpy as np

from oysterbench.core.geometry import Array, invert
from oysterbench.sequence.export.parts import number, numbers, port_notes, unpaired, write_lines
from oysterbench.sequence.export.readme import write_readme
from oysterbench.sequence.export.steps import Steps
from oysterbench.sequence.types import CameraCalibration, Sequence

DISTORTION_MODELS = {"plumb_bob": "radtan", "equidistant": "equidistant"}


def write(sequence: Sequence, folder: Path, truth: bool, steps: Steps) -> list[str]:
    """Write camchain-imucam.yaml, imu.yaml and README.txt, for the topics of a sequence file."""
    topics = {name: f"/{name}/image" for name in sequence.cameras}
    notes = write_calibration(sequence, folder, topics.values(), "/imu")
    own = "T_cam_imu in camchain-imucam.yaml is the inverse of T_imu_cam."
    write_readme(sequence, folder, "Kalibr", {topic: name for name, topic in topics.items()}, truth, [own])
    return notes


def write_calibration(sequence: Sequence, folder: Path, image_topics: Iterable[str], imu_topic: str) -> list[str]:
    """Write Kalibr's files for any topics: of the cameras, in their order, and of the IMU."""
    notes = port_notes(sequence, sequence.cameras)
    lines: list[str] = []
    cameras = list(sequence.cameras.values())
    previous: Array | None = None
    for index, ((name, camera), topic) in enumerate(zip(sequence.cameras.items(), image_topics, strict=True)):
        if camera.distortion_model == "plumb_bob" and np.any(camera.distortion[4:]):
            notes.append(f"{name}: Kalibr's radtan has no k3: its {camera.distortion[4]:g} was left out")
        lines += [f"cam{index}:", *(f"  {line}" for line in _camera(sequence, camera, previous))]
        # Of Kalibr's own chains: cameras that see the same, which its validator rectifies as pairs.
        overlaps = [at for at, other in enumerate(cameras) if not (unpaired(camera, other) and unpaired(other, camera))]
        lines += [f"  cam_overlaps: [{', '.join(map(str, overlaps))}]"]
        lines += [f"  rostopic: {topic}", f"  timeshift_cam_imu: {number(0.0 - camera.time_offset_s)}"]
        if camera.readout_s:  # as kalibr_calibrate_rs_cameras writes it
            lines += ["  # s from one row to the next; stamps are those of the middle row, not of the first"]
            lines += [f"  line_delay: {number(camera.readout_s / camera.height)}"]
        previous = camera.T_base_cam
    write_lines(folder / "camchain-imucam.yaml", lines)
    unit = sequence.imu_calibration
    write_lines(
        folder / "imu.yaml",
        [
            f"accelerometer_noise_density: {number(unit.accel_noise_density)}",
            f"accelerometer_random_walk: {number(unit.accel_random_walk)}",
            f"gyroscope_noise_density: {number(unit.gyro_noise_density)}",
            f"gyroscope_random_walk: {number(unit.gyro_random_walk)}",
            f"rostopic: {imu_topic}",
            f"update_rate: {number(unit.rate_hz)}",
        ],
    )
    return notes


def _camera(sequence: Sequence, camera: CameraCalibration, previous: Array | None) -> list[str]:
    T_cam_base, matrix = invert(camera.T_base_cam), camera.matrix
    lines = ["T_cam_imu:", *_rows(T_cam_base @ sequence.imu_calibration.T_base_imu)]
    if previous is not None:
        lines += ["T_cn_cnm1:", *_rows(T_cam_base @ previous)]
    return [
        *lines,
        "camera_model: pinhole",
        f"distortion_coeffs: {numbers(camera.distortion[:4])}",
        f"distortion_model: {DISTORTION_MODELS[camera.distortion_model]}",
        f"intrinsics: {numbers([matrix[0, 0], matrix[1, 1], matrix[0, 2], matrix[1, 2]])}",
        f"resolution: [{camera.width}, {camera.height}]",
    ]


def _rows(matrix: Array) -> list[str]:
    return [f"- {numbers(row)}" for row in matrix]
