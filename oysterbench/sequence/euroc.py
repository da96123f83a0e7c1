"""A folder in EuRoC/ASL layout as a sequence: mav0/cam*/, mav0/imu0/, and the ground truth if there is one."""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, TypeVar

import cv2
import numpy as np
from numpy.typing import NDArray

from oysterbench.core.errors import NoTruthError, SequenceError
from oysterbench.core.geometry import Array, is_rigid
from oysterbench.core.measurements import Image, ImuMeasurement
from oysterbench.core.names import counted
from oysterbench.core.pictures import decode_picture, used_bits
from oysterbench.core.places import leads_out
from oysterbench.core.text import as_unicode
from oysterbench.core.trajectory import ReadOptions, Trajectory, read_trajectory
from oysterbench.core.trajectory.frames import poses_of_body
from oysterbench.core.trajectory.read import EUROC_TRUTH
from oysterbench.sensors.camera import KIND as CAMERA
from oysterbench.sensors.imu import KIND as IMU
from oysterbench.sequence.inertial_table import SEPARATORS, check_inertial_table, headers_above
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

POSE = re.compile(
    r"^([ \t]*)T_BS:(.*?)(?=^(?!\1[ \t]+\S)[ \t]*(?!(?:rows|cols|dt|data)\b)(?:[^\s\d.+\-\[\],]|\.{3}|-{3})|\Z)",
    re.M | re.S,
)
"""T_BS with all that is nested in it: up to the next key that is not indented further, or the document's end."""

GRAVITY = 9.81  # m/s^2; used where the folder has no key for it, which is not part of the layout
LEAST_GRAVITY, MOST_GRAVITY = 9.0, 11.0  # m/s^2: another sign, unit or planet is a mistake


class EurocSequence(Sequence):
    """A sequence read from a folder that holds `mav0`. The body frame is the IMU's, as the layout defines it."""

    def __init__(self, folder: str | os.PathLike[str]) -> None:
        self.folder = Path(folder)
        self._root = root = self.folder / "mav0"
        self._bits: dict[str, int] = {}
        self.name = as_unicode(self.folder.resolve().name)
        self.metadata = {"sequence": self.name, "format": "euroc"}
        samples = root / "imu0" / "data.csv"
        if not samples.is_file():
            inside = sorted([*self.folder.glob("*.mcap"), *self.folder.glob("*/*.mcap")])
            raise SequenceError(
                f"{self.folder}: expected a sequence file (.mcap) or an EuRoC folder with mav0/imu0/data.csv, "
                + (f"got a folder of {counted(len(inside), 'file')} such as {inside[0]}" if inside else "found neither")
            )
        check_inertial_table(samples, headers_above(_lines(samples)), _stamps(samples))
        self.cameras = {
            path.name: _read_sensor(path / "sensor.yaml", _camera) for path in sensor_folders(self.folder)[1:]
        }
        self.imu_calibration = _read_sensor(root / "imu0" / "sensor.yaml", _imu)

    def images(self, camera: str, start_ns: int | None = None, end_ns: int | None = None) -> Iterator[Image]:
        if camera not in self.cameras:
            raise SequenceError(f"{self.folder}: no camera {camera!r}; cameras: {', '.join(self.cameras)}")
        calibration = self.cameras[camera]
        for stamp, path, where in self._pictures(camera):
            if not _within(stamp, start_ns, end_ns):
                continue
            pixels = _decoded(path)
            if pixels is None:
                raise SequenceError(
                    f"{path}: expected an image, could not read one: {_fault_of(path)}; restore it, or delete "
                    f"{where.rpartition(', ')[2]} of {camera}/data.csv"
                )
            if pixels.dtype not in (np.uint8, np.uint16):
                raise SequenceError(f"{path}: expected an image of 8 or 16 bits, got {pixels.dtype}; save it as one")
            height, width = pixels.shape[:2]
            if (width, height) != (calibration.width, calibration.height):
                raise SequenceError(
                    f"{path}: expected {calibration.width} x {calibration.height} px, as sensor.yaml says, got {width} "
                    f"x {height}; correct `resolution` and `intrinsics` there"
                )
            if pixels.dtype == np.uint16:
                pixels = (pixels >> (self._bits_of(camera) - 8)).astype(np.uint8)
            yield Image(stamp, camera, pixels)

    def _pictures(self, camera: str) -> Iterator[tuple[int, Path, str]]:
        """Yield the stamp of each image of a camera, ns, its file, and where it is listed."""
        for stamp, fields, where in _rows(self._root / camera / "data.csv"):
            if not fields or leads_out(fields[0]):
                raise SequenceError(f"{where}: expected a stamp, and the name of a file in data/, got {fields!s:.80}")
            yield stamp, self._root / camera / "data" / fields[0], where

    def _bits_of(self, camera: str) -> int:
        """Bits of a camera whose images are stored in 16: by all of them, since a dark one by itself may use fewer."""
        if camera not in self._bits:
            bits = 8
            for _, path, _ in self._pictures(camera):
                pixels = _decoded(path)
                if pixels is not None and pixels.dtype == np.uint16:
                    bits = max(bits, used_bits(int(pixels.max())))
                if bits == 16:  # there are no more
                    break
            self._bits[camera] = bits
        return self._bits[camera]

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
        for name in ("imu0", *self.cameras):  # of the cameras only where there are no inertial samples
            stamps = [stamp for stamp, _, _ in _rows(self._root / name / "data.csv")]
            if stamps:
                return (stamps[-1] - stamps[0]) * 1e-9
        return 0.0

    def contents(self) -> list[tuple[str, str, int]]:
        files = [(self._root / "imu0", "imu"), *((self._root / name, "camera") for name in self.cameras)]
        return [(folder.name, kind, _count(folder / "data.csv")) for folder, kind in files]

    def rates(self) -> dict[str, float | None]:
        """Each over the time from the sensor's own first row to its last."""
        return {name: _rate(self._root / name / "data.csv") for name, _, _ in self.contents()}

    @property
    def has_truth(self) -> bool:
        return (self.folder / EUROC_TRUTH).is_file()

    def truth(self) -> Trajectory:
        return true_poses(self.folder)


def true_poses(folder: Path, options: ReadOptions | None = None) -> Trajectory:
    """Ground truth of a folder in EuRoC layout, whatever else is in it; options: how its file is read, where its frame
    is not that of T_BS if they say another. Raises NoTruthError where there is none, TrajectoryError or SequenceError
    where it cannot be read."""
    path = folder / EUROC_TRUTH
    if not path.is_file():
        raise NoTruthError(f"{folder} has no ground truth: {path} is absent")
    states, sensor = read_trajectory(path, options), path.with_name("sensor.yaml")
    framed = options is not None and (options.T_body_estimate is not None or options.frame is not None)
    T_body_sensor = _read_sensor(sensor, _pose_if_given) if sensor.is_file() and not framed else np.eye(4)
    if np.array_equal(T_body_sensor, np.eye(4)):
        return states
    # The poses are those of the sensor that measured them, such as a marker: p_RS_R, q_RS.
    told = (
        "the true poses are those of a sensor apart from the body, by T_BS of sensor.yaml beside them, and were taken"
    )
    moved = poses_of_body(states, T_body_sensor)
    note = f"{as_unicode(folder.resolve().name)}: {told} to the body"
    return replace(moved, T_body_estimate=None, notes=(*moved.notes, note))


def _within(stamp_ns: int, start_ns: int | None, end_ns: int | None) -> bool:
    return (start_ns is None or stamp_ns >= start_ns) and (end_ns is None or stamp_ns < end_ns)


def _decoded(path: Path) -> NDArray[Any] | None:
    """Decode an image file to (H, W, 3) RGB of the depth that it is stored in; None where it cannot be read."""
    # Not directly as RGB: for a 16-bit TIFF, OpenCV 5.0 then returns uninitialised memory.
    pixels = decode_picture(path.read_bytes() if path.is_file() else b"", cv2.IMREAD_COLOR | cv2.IMREAD_ANYDEPTH)
    return None if pixels is None else np.ascontiguousarray(pixels[..., ::-1])


def _fault_of(picture: Path) -> str:
    if not picture.is_file():
        return "there is no such file"
    return "the file is damaged, or no image" if picture.stat().st_size else "the file is empty"


def _count(path: Path) -> int:
    """Number of rows of a data.csv, valid or not; 0 where it is absent, as of a camera that nobody uses."""
    return sum(1 for _ in _fields(path)) if path.exists() else 0


def _rate(path: Path) -> float | None:
    """Mean number of rows of a data.csv per second; None where all are of one instant, or there are none."""
    stamps = list(_stamps(path)) if path.exists() else []
    span_s = 1e-9 * (stamps[-1] - stamps[0]) if stamps else 0.0
    return (len(stamps) - 1) / span_s if span_s > 0 else None


def _stamps(path: Path) -> Iterator[int]:
    """Yield the stamps of a data.csv that are whole numbers."""
    return (int(first) for _, (first, *_) in _fields(path) if STAMP.fullmatch(first))


def _rows(path: Path) -> Iterator[tuple[int, list[str], str]]:
    """Yield the stamp of each row of a data.csv, in ns, its other fields, and where it is.

    Raises SequenceError where there is no such file, or stamps are not whole numbers that increase.
    """
    before: int | None = None
    for number, (first, *fields) in _fields(path):
        where = f"{path}, line {number}"
        stamp = int(first) if STAMP.fullmatch(first) else None
        if stamp is None or (before is not None and stamp <= before):
            after = "" if before is None else f" above {before}"
            mend = (
                "separate the fields by commas" if re.search(r"[;\s]", first) else "correct, delete or sort the lines"
            )
            raise SequenceError(f"{where}: expected a stamp in whole ns{after}, got {first!r:.40}; {mend}")
        yield stamp, fields, where
        before = stamp


def _fields(path: Path) -> Iterator[tuple[int, list[str]]]:
    """Yield the number of each row of a data.csv and its fields: between commas or, where the first row has none,
    semicolons or tabs."""
    separator = ""
    for number, line in enumerate(_lines(path), start=1):
        if not line.strip() or line.lstrip().startswith("#"):
            continue
        if number == 1 and line.lstrip()[:1].isalpha():  # the names of the columns, without the layout's #
            continue
        separator = separator or next((mark for mark in SEPARATORS if mark in line), ",")
        yield number, [field.strip() for field in line.split(separator)]


def _read_sensor(path: Path, read: Callable[[Mapping[str, str]], C]) -> C:
    """Read a calibration from an ASL sensor.yaml. Raises SequenceError naming the file and what is wrong in it."""
    # Lists may span lines.
    text = re.sub(r"#.*", "", "".join(_lines(path)))
    found = re.findall(r"^\s*(\w+):[ \t]*(\[[^\]]*\]|[^\n\[]*)", text, re.M)
    settings = {key: value.strip().strip("\"'") for key, value in found}
    if (pose := POSE.search(text)) is not None:
        settings["T_BS"] = pose[2]
    try:
        return read(settings)
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
            "rate_hz": _above_zero(settings, "rate_hz", 20.0),
            "matrix": [[fx, 0, cx], [0, fy, cy], [0, 0, 1]],
            "distortion": _coefficients(settings, lens),
            "T_base_cam": _pose(settings),
            "time_offset_s": 0.0 - _scalar(settings, "timeshift_cam_imu", 0.0),
            "readout_s": _scalar(settings, "readout_s", 0.0),
            "distortion_model": LENSES[lens],
        }
    )


def _pose(settings: Mapping[str, str]) -> Array:
    """T_BS (4, 4): by `rows`, `cols` and `data`, as a plain list, or by rows. Raises ValueError where it is no rigid
    transform."""
    if "T_BS" not in settings:
        raise ValueError("missing key 'T_BS'")
    text = re.sub(r"!!\S+|\b(?!data\b)\w+\s*:\s*(\[[^\]]*\]|\w+)|\bdata\s*:", " ", settings["T_BS"])
    words = [word for word in re.split(r"[\s,\[\]{}\"']+", text) if word.strip("-")]
    try:
        matrix = np.array(words, dtype=float).reshape(4, 4)
    except ValueError:
        matrix = np.full((4, 4), np.nan)
    if not np.isfinite(matrix).all():
        got = " ".join(words)
        raise ValueError(f"T_BS, data: expected 16 finite numbers, got {len(words)}: {got:.60}")
    if is_rigid(matrix):
        return matrix
    rotation = matrix[:3, :3]
    if not np.allclose(matrix[3], [0, 0, 0, 1]):
        found = f"the last row {' '.join(f'{value:g}' for value in matrix[3])} in place of 0 0 0 1"
    elif np.linalg.det(rotation) < 0:
        found = f"a reflection (determinant {np.linalg.det(rotation):.3g}); is the sign of an axis wrong?"
    else:
        off = np.abs(rotation.T @ rotation - np.eye(3)).max()
        found = f"axes that are not at right angles or not of length 1 (off by {off:.2g})"
    raise ValueError(f"T_BS: expected a rigid transform (4, 4), from the sensor to the body, got {found}")


def _pose_if_given(settings: Mapping[str, str]) -> Array:
    """T_BS (4, 4); the identity where it is absent, or said to be none."""
    return np.eye(4) if settings.get("T_BS", "").strip() in ("", "null", "~", "[]") else _pose(settings)


def _coefficients(settings: Mapping[str, str], lens: str) -> list[float]:
    """Distortion coefficients of a camera: zeros where it has no distortion and lists none."""
    key = "distortion_coefficients"
    if lens == "none" and not settings.get(key, "").strip("[] \n"):
        return [0.0] * 4
    return _numbers(settings, key)


def _imu(settings: Mapping[str, str]) -> ImuCalibration:
    """IMU from the keys of its sensor.yaml. Raises ValueError where one is missing or no number, or no IMU has it."""
    noises = {}
    for name, unit in (("gyroscope", "gyro"), ("accelerometer", "accel")):
        for key in ("noise_density", "random_walk"):
            noises[f"{unit}_{key}"] = value = _scalar(settings, f"{name}_{key}")
            if value < 0:
                raise ValueError(f"{name}_{key}: expected zero or more, got {value:g}")
    gravity = _scalar(settings, "gravity", GRAVITY)
    if not LEAST_GRAVITY < gravity < MOST_GRAVITY:
        raise ValueError(f"gravity: expected its magnitude in m/s^2, about {GRAVITY}, got {gravity:g}")
    return IMU.read_calibration(
        {
            "rate_hz": _above_zero(settings, "rate_hz", 200.0),
            **noises,
            "gyro_turn_on": 0.1,
            "accel_turn_on": 0.1,
            "gravity": gravity,
            "T_base_imu": _pose_if_given(settings),
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


def _above_zero(settings: Mapping[str, str], key: str, default: float | None = None) -> float:
    value = _scalar(settings, key, default)
    if not value > 0:
        raise ValueError(f"{key}: expected a number above zero, got {value:g}")
    return value


def _scalar(settings: Mapping[str, str], key: str, default: float | None = None) -> float:
    if key not in settings and default is not None:
        return default
    return _numbers(settings, key, 1)[0]
