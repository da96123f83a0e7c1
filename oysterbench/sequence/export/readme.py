"""README.txt of an exported folder: units and conventions of its files, and what they have no place for."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path

from oysterbench.core.geometry import Array, invert
from oysterbench.sequence.export.parts import number, write_lines
from oysterbench.sequence.types import CameraCalibration, ImuCalibration, Sequence
from oysterbench.version import VERSION

README = "README.txt"

NAMES = {
    "k1 k2 p1 p2 of OpenCV, without k3": {
        "EuRoC": "radial-tangential",
        "ROS": "plumb_bob",
        "Kalibr, OpenVINS": "radtan",
        "OKVIS2": "radialtangential",
        "ORB-SLAM3": "PinHole with k1 k2 p1 p2",
        "VINS-Fusion": "PINHOLE",
        "DSO": "RadTan",
        "COLMAP": "OPENCV",
        "Basalt": "pinhole-radtan8",
    },
    "k1 k2 p1 p2 k3 of OpenCV; with k4 k5 k6, if a model has them, 0": {
        "EuRoC": "radial-tangential",
        "ROS": "plumb_bob",
        "Kalibr, OpenVINS, DSO": "none, as their models have no k3; undistort",
        "OKVIS2": "radialtangential8",
        "ORB-SLAM3": "PinHole with k1 k2 p1 p2 k3",
        "VINS-Fusion": "PINHOLE_FULL",
        "COLMAP": "FULL_OPENCV",
        "Basalt": "pinhole-radtan8",
    },
    "k1 k2 k3 k4 of OpenCV's fisheye": {
        "EuRoC, ROS, Kalibr, OpenVINS, OKVIS2": "equidistant",
        "ORB-SLAM3": "KannalaBrandt8",
        "VINS-Fusion": "KANNALA_BRANDT",
        "DSO": "EquiDistant",
        "COLMAP": "OPENCV_FISHEYE",
        "Basalt": "kb4",
    },
}
"""Coefficients of a lens -> systems -> what they call its model in their configurations."""


def write_readme(
    sequence: Sequence, folder: Path, layout: str, cameras: Mapping[str, str], truth: bool, further: Iterable[str]
) -> None:
    """Write README.txt. cameras: label of a camera in the layout -> its name; truth: with what the given calibration
    does not know; further: lines specific to the layout"""
    true = sequence.truly_calibrated() if truth else sequence
    T_imu_base = invert(sequence.imu_calibration.T_base_imu)
    lines = [head(sequence, layout), ""]
    for label, name in cameras.items():
        camera = sequence.cameras[name]
        lines += camera_lines(label, name, camera, T_imu_base @ camera.T_base_cam)
        late_s = true.cameras[name].time_offset_s
        if late_s != camera.time_offset_s:
            lines.append(f"  in truth they are late by {number(late_s)} s, which methods are not told")
        lines.append("")
    for coefficients in dict.fromkeys(_coefficients(sequence.cameras[name]) for name in cameras.values()):
        lines.append(f"Names of this distortion ({coefficients}):")
        lines += [*(f"  {systems}: {name}" for systems, name in NAMES[coefficients].items()), ""]
    absent = [] if sequence.has_imu else ["There are no inertial measurements of this sequence here."]
    write_lines(folder / README, [*lines, *_imu(sequence.imu_calibration), *absent, "", *further])


def _coefficients(camera: CameraCalibration) -> str:
    """Key of NAMES for a camera."""
    without_k3, with_k3, fisheye = NAMES
    if camera.distortion_model == "equidistant":
        return fisheye
    return with_k3 if any(camera.distortion[4:]) else without_k3


def head(sequence: Sequence, layout: str) -> str:
    """First line of README.txt."""
    return f"{sequence.name} in the layout of {layout}, by oysterbench {VERSION}."


def truth_line(truth: bool, place: str) -> str:
    """Line on where the ground truth is. place: also tells what it is of."""
    return f"The truth is in {place}." if truth else "The truth was left out."


def camera_lines(label: str, name: str, camera: CameraCalibration, T_imu_cam: Array) -> list[str]:
    """Lines on a camera: its lens, its stamps, and where it is mounted. label: its name in the layout."""
    distorted = any(camera.distortion)
    coefficients = " ".join(number(value) for value in camera.distortion)
    matrix = camera.matrix
    return [
        f"{label}: {name}, {camera.width} x {camera.height}, {camera.rate_hz:g} Hz",
        "  fx fy cx cy: " + " ".join(number(matrix[at]) for at in ((0, 0), (1, 1), (0, 2), (1, 2))) + " px",
        f"  distortion: {coefficients if distorted else 'none'}",
        f"  {_stamps(camera.time_offset_s)}, by the given calibration: Kalibr's",
        f"  timeshift_cam_imu is {number(0.0 - camera.time_offset_s)}, with t_imu = t_cam + timeshift",
        "  T_imu_cam, which takes points of the camera into the IMU (T_BS, where the body is the IMU):",
        *("    " + " ".join(f"{value: .9f}" for value in row) for row in T_imu_cam),
        *(f"  {line}" for line in shutter_lines(camera)),
    ]


def shutter_lines(camera: CameraCalibration) -> list[str]:
    """Lines on a rolling shutter: how long it takes, and which row stamps belong to; none for a global shutter."""
    if not camera.readout_s:
        return []
    whole_s, every_s = (number(time_s) for time_s in (camera.readout_s, camera.readout_s / camera.height))
    return [
        f"rolling shutter: {camera.height} rows are read in {whole_s} s (readout_s), the top one first,",
        f"one every {every_s} s (Kalibr's line_delay); stamps are those of the middle row",
    ]


def _stamps(late_s: float) -> str:
    """How the stamps of a camera relate to the clock of the IMU."""
    if late_s == 0:
        return "its stamps have no time offset"
    return f"its stamps are {number(abs(late_s))} s {'late' if late_s > 0 else 'early'}"


def _imu(unit: ImuCalibration) -> list[str]:
    return [
        f"IMU: {unit.rate_hz:g} Hz; rad/s and m/s^2; gravity is {number(unit.gravity)} m/s^2",
        f"  gyroscope: noise {number(unit.gyro_noise_density)} rad/s/sqrt(Hz), "
        f"random walk of its bias {number(unit.gyro_random_walk)} rad/s^2/sqrt(Hz)",
        f"  accelerometer: noise {number(unit.accel_noise_density)} m/s^2/sqrt(Hz), "
        f"random walk of its bias {number(unit.accel_random_walk)} m/s^3/sqrt(Hz)",
    ]
