"""A folder in EuRoC/ASL layout as a sequence: mav0/cam*/, mav0/imu0/, and the ground truth if there is one."""

from __future__ import annotations

import os
import re
from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np

from oysterbench.core.errors import SequenceError
from oysterbench.core.geometry import Array
from oysterbench.core.measurements import Image, ImuMeasurement
from oysterbench.core.pictures import decode_picture
from oysterbench.core.trajectory import Trajectory, read_trajectory
from oysterbench.sequence.types import CameraCalibration, ImuCalibration, Sequence

GRAVITY = 9.81  # m/s^2; used where the folder has no key for it, which is not part of the layout


class EurocSequence(Sequence):
    """A sequence read from a folder that holds `mav0`. The body frame is the IMU's, as the layout defines it."""

    def __init__(self, folder: str | os.PathLike[str]) -> None:
        self.folder = Path(folder)
        root = self.folder / "mav0"
        self._root = root
        self.name = self.folder.resolve().name
        self.metadata = {"sequence": self.name, "format": "euroc"}
        if not (root / "imu0" / "data.csv").is_file():
            raise SequenceError(f"{self.folder}: expected an EuRoC folder with mav0/imu0/data.csv, found none")
        folders = [path for path in root.glob("cam[0-9]*") if path.name[3:].isdigit()]
        self.cameras = {path.name: self._camera(path) for path in sorted(folders, key=lambda path: int(path.name[3:]))}
        settings = _read_yaml(root / "imu0" / "sensor.yaml")
        self.imu_calibration = ImuCalibration(
            rate_hz=_scalar(settings, "rate_hz", 200.0),
            gyro_noise_density=_scalar(settings, "gyroscope_noise_density"),
            gyro_random_walk=_scalar(settings, "gyroscope_random_walk"),
            gyro_turn_on=0.1,
            accel_noise_density=_scalar(settings, "accelerometer_noise_density"),
            accel_random_walk=_scalar(settings, "accelerometer_random_walk"),
            accel_turn_on=0.1,
            gravity=_scalar(settings, "gravity", GRAVITY),
            T_base_imu=np.eye(4),
        )

    def _camera(self, folder: Path) -> CameraCalibration:
        settings = _read_yaml(folder / "sensor.yaml")
        fx, fy, cx, cy = _numbers(settings, "intrinsics")
        width, height = _numbers(settings, "resolution")
        return CameraCalibration(
            width=int(width),
            height=int(height),
            rate_hz=_scalar(settings, "rate_hz", 20.0),
            matrix=np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1.0]]),
            distortion=_numbers(settings, "distortion_coefficients"),
            T_base_cam=_numbers(settings, "data").reshape(4, 4),
            time_offset_s=0.0 - _scalar(settings, "timeshift_cam_imu", 0.0),
            distortion_model="equidistant" if "equidistant" in settings.get("distortion_model", "") else "plumb_bob",
        )

    def images(self, camera: str, start_ns: int | None = None, end_ns: int | None = None) -> Iterator[Image]:
        if camera not in self.cameras:
            raise SequenceError(f"{self.folder}: no camera {camera!r}; cameras: {', '.join(self.cameras)}")
        for line in _rows(self._root / camera / "data.csv"):
            stamp, file = line.split(",")[:2]
            if not _within(int(stamp), start_ns, end_ns):
                continue
            path = self._root / camera / "data" / file.strip()
            pixels = decode_picture(path.read_bytes() if path.is_file() else b"", cv2.IMREAD_COLOR_RGB)
            if pixels is None:
                raise SequenceError(f"{path}: expected an image, could not read one")
            yield Image(int(stamp), camera, pixels)

    def imu(self, start_ns: int | None = None, end_ns: int | None = None) -> Iterator[ImuMeasurement]:
        for line in _rows(self._root / "imu0" / "data.csv"):
            fields = line.split(",")
            if not _within(int(fields[0]), start_ns, end_ns):
                continue
            values = np.array(fields[1:7], dtype=float)
            yield ImuMeasurement(int(fields[0]), values[:3], values[3:])

    @property
    def duration_s(self) -> float:
        stamps = [int(row.split(",")[0]) for row in _rows(self._root / "imu0" / "data.csv")]
        return (stamps[-1] - stamps[0]) * 1e-9 if stamps else 0.0

    def contents(self) -> list[tuple[str, str, int]]:
        files = [(self._root / "imu0", "imu"), *((self._root / name, "camera") for name in self.cameras)]
        return [(folder.name, kind, sum(1 for _ in _rows(folder / "data.csv"))) for folder, kind in files]

    def truth(self) -> Trajectory:
        path = self._root / "state_groundtruth_estimate0" / "data.csv"
        if not path.is_file():
            raise SequenceError(f"{self.folder} has no ground truth: {path} is absent")
        return read_trajectory(path)


def _within(stamp_ns: int, start_ns: int | None, end_ns: int | None) -> bool:
    return (start_ns is None or stamp_ns >= start_ns) and (end_ns is None or stamp_ns < end_ns)


def _rows(path: Path) -> Iterator[str]:
    with open(path, encoding="utf-8") as file:
        for line in file:
            if line.strip() and not line.startswith("#"):
                yield line


def _read_yaml(path: Path) -> dict[str, str]:
    """Read the `key: value` lines of an ASL sensor.yaml; lists may span lines. Nested keys go by their own name."""
    try:
        text = path.read_text(encoding="utf-8")
    except OSError:
        raise SequenceError(f"{path}: expected a sensor.yaml of the EuRoC layout, found none") from None
    text = re.sub(r"#.*", "", text)
    return {key: value.strip() for key, value in re.findall(r"^\s*(\w+):[ \t]*(\[[^\]]*\]|[^\n\[]*)", text, re.M)}


def _numbers(settings: dict[str, str], key: str) -> Array:
    if key not in settings:
        raise SequenceError(f"sensor.yaml: missing key {key!r}")
    return np.array([float(item) for item in settings[key].strip("[]").replace("\n", " ").split(",")])


def _scalar(settings: dict[str, str], key: str, default: float | None = None) -> float:
    if key not in settings and default is not None:
        return default
    return float(_numbers(settings, key)[0])
