"""A folder in EuRoC/ASL layout as a sequence: mav0/cam*/, mav0/imu0/, and the ground truth if there is one."""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import TypeVar

import cv2
import numpy as np

from oysterbench.core.errors import SequenceError
from oysterbench.core.files import leads_out
from oysterbench.core.measurements import Image, ImuMeasurement
from oysterbench.core.pictures import decode_picture
from oysterbench.core.trajectory import Trajectory, read_trajectory
from oysterbench.sensors.camera import KIND as CAMERA
from oysterbench.sensors.imu import KIND as IMU
from oysterbench.sequence.state import sensor_folders
from oysterbench.sequence.types import CameraCalibration, ImuCalibration, Sequence

C = TypeVar("C")

STAMP = re.compile(r"-?[0-9]{1,18}|[1-8][0-9]{18}")
"""Stamp in ns, which fits an int64."""

LENSES = {
    "radial-tangential": "plumb_bob",
    "radtan": "plumb_bob",
    "plumb_bob": "plumb_bob",
    "none": "plumb_bob",
    "equidistant": "equidistant",
    "fisheye": "equidistant",
}
"""Distortion model in a sensor.yaml -> that of `CameraCalibration`."""

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
        self.cameras = {
            path.name: _read_sensor(path / "sensor.yaml", _camera) for path in sensor_folders(self.folder)[1:]
        }
        self.imu_calibration = _read_sensor(root / "imu0" / "sensor.yaml", _imu)

    def images(self, camera: str, start_ns: int | None = None, end_ns: int | None = None) -> Iterator[Image]:
        if camera not in self.cameras:
            raise SequenceError(f"{self.folder}: no camera {camera!r}; cameras: {', '.join(self.cameras)}")
        calibration = self.cameras[camera]
        for stamp, fields, where in _rows(self._root / camera / "data.csv"):
            if not _within(stamp, start_ns, end_ns):
                continue
            if not fields or leads_out(fields[0]):
                raise SequenceError(f"{where}: expected a stamp, and the name of a file in data/, got {fields!s:.80}")
            path = self._root / camera / "data" / fields[0]
            pixels = decode_picture(path.read_bytes() if path.is_file() else b"", cv2.IMREAD_COLOR_RGB)
            if pixels is None:
                raise SequenceError(f"{path}: expected an image, could not read one")
            height, width = pixels.shape[:2]
            if (width, height) != (calibration.width, calibration.height):
                raise SequenceError(
                    f"{path}: expected {calibration.width} x {calibration.height} px, as sensor.yaml says, got {width} "
                    f"x {height}; correct `resolution` and `intrinsics` there"
                )
            yield Image(stamp, camera, pixels)

    def imu(self, start_ns: int | None = None, end_ns: int | None = None) -> Iterator[ImuMeasurement]:
        columns = 0
        for stamp, fields, where in _rows(self._root / "imu0" / "data.csv"):
            # Further columns, as of a temperature, are none of ours. A line with more or fewer of them than the first
            # is not whole, or two in one: its numbers may be in other columns.
            columns = columns or len(fields)
            if not _within(stamp, start_ns, end_ns):
                continue
            try:
                values = np.array(fields[:6], dtype=float)
            except ValueError:
                values = np.empty(0)
            if len(values) != 6 or len(fields) != columns or not np.isfinite(values).all():
                raise SequenceError(
                    f"{where}: expected a stamp and 6 finite numbers (angular rate, specific force), and as many "
                    f"columns as in the first sample ({columns + 1}), got {len(fields) + 1}: {fields!s:.80}; correct "
                    "or delete the line"
                )
            yield ImuMeasurement(stamp, values[:3], values[3:])

    @property
    def duration_s(self) -> float:
        stamps = [stamp for stamp, _, _ in _rows(self._root / "imu0" / "data.csv")]
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


def _rows(path: Path) -> Iterator[tuple[int, list[str], str]]:
    """Yield the stamp of each row of a data.csv, in ns, its other fields, and where it is.

    Raises SequenceError where there is no such file, or stamps are not whole numbers that increase.
    """
    before: int | None = None
    for number, line in enumerate(_lines(path), start=1):
        if not line.strip() or line.startswith("#"):
            continue
        first, *fields = (field.strip() for field in line.split(","))
        if number == 1 and first[:1].isalpha():  # the names of the columns, without the layout's #
            continue
        where = f"{path}, line {number}"
        stamp = int(first) if STAMP.fullmatch(first) else None
        if stamp is None or (before is not None and stamp <= before):
            after = "" if before is None else f" above {before}"
            raise SequenceError(
                f"{where}: expected a stamp in whole ns{after}, got {first!r:.40}; correct, delete or sort the lines"
            )
        yield stamp, fields, where
        before = stamp


def _read_sensor(path: Path, read: Callable[[Mapping[str, str]], C]) -> C:
    """Read a calibration from an ASL sensor.yaml. Raises SequenceError naming the file and what is wrong in it."""
    # Nested keys go by their own name; lists may span lines.
    text = re.sub(r"#.*", "", "".join(_lines(path)))
    found = re.findall(r"^\s*(\w+):[ \t]*(\[[^\]]*\]|[^\n\[]*)", text, re.M)
    try:
        return read({key: value.strip().strip("\"'") for key, value in found})
    except ValueError as error:
        raise SequenceError(f"{path}: {error}") from None


def _lines(path: Path) -> Iterator[str]:
    """Yield the lines of a text file, with or without a byte order mark. Raises SequenceError where there is none."""
    try:
        # Other encodings than UTF-8 matter only in comments: what is read are numbers and words in ASCII.
        with open(path, encoding="utf-8-sig", errors="replace") as file:
            yield from file
    except OSError as error:
        raise SequenceError(f"{path}: expected this file of the EuRoC layout, got: {error.strerror}") from None


def _camera(settings: Mapping[str, str]) -> CameraCalibration:
    """Camera from the keys of its sensor.yaml. Raises ValueError where they describe none that is supported."""
    model, lens = settings.get("camera_model", "pinhole"), settings.get("distortion_model", "radial-tangential")
    if model != "pinhole":
        raise ValueError(f"camera_model: expected pinhole, got {model:.40}")
    if lens not in LENSES:
        raise ValueError(f"distortion_model: expected one of {', '.join(LENSES)}, got {lens:.40}")
    fx, fy, cx, cy = _numbers(settings, "intrinsics", 4)
    width, height = _numbers(settings, "resolution", 2)
    return CAMERA.read_calibration(
        {
            "width": width,
            "height": height,
            "rate_hz": _scalar(settings, "rate_hz", 20.0),
            "matrix": [[fx, 0, cx], [0, fy, cy], [0, 0, 1]],
            "distortion": _coefficients(settings, lens),
            "T_base_cam": np.reshape(_numbers(settings, "data", 16), (4, 4)),
            "time_offset_s": 0.0 - _scalar(settings, "timeshift_cam_imu", 0.0),
            "distortion_model": LENSES[lens],
        }
    )


def _coefficients(settings: Mapping[str, str], lens: str) -> list[float]:
    """Distortion coefficients of a camera: zeros where it has no distortion and lists none."""
    key = "distortion_coefficients"
    if lens == "none" and not settings.get(key, "").strip("[] \n"):
        return [0.0] * 4
    return _numbers(settings, key)


def _imu(settings: Mapping[str, str]) -> ImuCalibration:
    """IMU from the keys of its sensor.yaml. Raises ValueError where one is missing or no number."""
    return IMU.read_calibration(
        {
            "rate_hz": _scalar(settings, "rate_hz", 200.0),
            "gyro_noise_density": _scalar(settings, "gyroscope_noise_density"),
            "gyro_random_walk": _scalar(settings, "gyroscope_random_walk"),
            "gyro_turn_on": 0.1,
            "accel_noise_density": _scalar(settings, "accelerometer_noise_density"),
            "accel_random_walk": _scalar(settings, "accelerometer_random_walk"),
            "accel_turn_on": 0.1,
            "gravity": _scalar(settings, "gravity", GRAVITY),
            "T_base_imu": np.eye(4),
        }
    )


def _numbers(settings: Mapping[str, str], key: str, count: int | None = None) -> list[float]:
    """Numbers of a key, as many as `count` says. Raises ValueError where they are not."""
    if key not in settings:
        raise ValueError(f"missing key {key!r}")
    try:
        found = [float(item) for item in settings[key].strip("[]").split(",")]
    except ValueError:
        found = []
    if not np.isfinite(found).all() or len(found) != (count or len(found)) or not found:
        raise ValueError(f"{key}: expected {f'{count} ' if count else ''}finite numbers, got {settings[key]:.60}")
    return found


def _scalar(settings: Mapping[str, str], key: str, default: float | None = None) -> float:
    if key not in settings and default is not None:
        return default
    return _numbers(settings, key, 1)[0]
