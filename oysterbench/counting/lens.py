"""Calibrated camera lenses: from pixels to rays, read from the usual calibration files."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from oysterbench.core.errors import SequenceError
from oysterbench.core.geometry import Array
from oysterbench.core.lens import undistort
from oysterbench.sequence import open_sequence

EXPECTED = (
    "Kalibr's camchain.yaml, EuRoC's sensor.yaml, ROS's camera_info as YAML (camera_calibration writes it), or a "
    "sequence (.mcap, EuRoC folder)"
)
UNDONE_PX = 0.5
"""Maximum error of a pixel after undistortion and redistortion, px; if it is greater, undistortion failed."""
FOLD_STEPS = 33
"""Number of places on the way from the axis to a ray at which its distortion is examined."""


@dataclass(frozen=True)
class Lens:
    """Intrinsic calibration. matrix: (3, 3) in px; distortion as in sensor_msgs/CameraInfo: k1, k2, p1, p2[, k3] for
    plumb_bob, k1 to k4 for equidistant. width, height: px, of the images that it was calibrated with."""

    width: int
    height: int
    matrix: Array
    distortion: Array
    model: str = "plumb_bob"

    def rays(self, points: Array) -> Array:
        """Rays (N, 2), x, y at unit distance along the axis, of pixels (N, 2) x, y, with pixel centres at whole
        numbers. Raises SequenceError if the distortion cannot be undone, as outside the calibrated area."""
        found = undistort(points, self.matrix, self.distortion, self.model == "equidistant")
        again = self._pixels(found)
        with np.errstate(invalid="ignore"):
            missed = float(np.abs(again - points).max(initial=0.0))
        if not (missed < UNDONE_PX and self._is_before_the_fold(found)):  # NaN fails as well
            raise SequenceError(
                f"calibration: its distortion cannot be undone at the edge of an image of {self.width} x {self.height} "
                "px: calibrate with the target in the image corners as well"
            )
        return found

    def _is_before_the_fold(self, rays: Array) -> bool:
        """Whether pixels lie further out the further out their rays (N, 2) do, all the way from the axis: beyond a
        fold of the distortion, other rays have the same pixels."""
        steps = np.linspace(0.0, 1.0, FOLD_STEPS)
        pixels = self._pixels((rays[:, None] * steps[:, None]).reshape(-1, 2)).reshape(len(rays), FOLD_STEPS, 2)
        across = pixels[:, 1:] - pixels[:, :-1]
        outwards = pixels[:, -1:] - pixels[:, :1]
        return bool((np.sum(across * outwards, axis=2) >= 0).all())

    def _pixels(self, rays: Array) -> Array:
        ahead = np.concatenate([rays, np.ones((len(rays), 1))], axis=1).reshape(-1, 1, 3)
        still = np.zeros(3)
        if self.model == "equidistant":
            found = cv2.fisheye.projectPoints(ahead, still, still, self.matrix, self.distortion)[0]
        else:
            found = cv2.projectPoints(ahead, still, still, self.matrix, self.distortion)[0]
        return np.asarray(found, dtype=float).reshape(-1, 2)

    def resized(self, width: int, height: int, stored_width: int | None = None) -> Lens:
        """Return the lens for the same images at another size, or in portrait if it was calibrated in landscape, and
        vice versa (`turned`). Raises SequenceError if the aspect ratio differs.

        stored_width: px, of images whose pixels were not square and have been made so: a lens may have been calibrated
        with the images as they are stored, too.
        """
        if not self._fits(width, height) and stored_width is not None and self._fits(stored_width, height):
            return self.resized(stored_width, height)._scaled(width, height)
        if not self._fits(width, height):
            raise SequenceError(
                f"calibration: of images of {self.width} x {self.height} px, got one of {width} x {height}: expected "
                "the same aspect ratio, lying or upright, since cameras crop differently in other modes"
            )
        return (self if _alike(width, height, self.width, self.height) else self.turned())._scaled(width, height)

    def _fits(self, width: int, height: int) -> bool:
        """Whether images of a size have the aspect ratio of those that it was calibrated with, lying or upright."""
        return any(_alike(width, height, *size) for size in ((self.width, self.height), (self.height, self.width)))

    def _scaled(self, width: int, height: int) -> Lens:
        """Return the lens for the same images at another size, whatever its aspect ratio."""
        if (width, height) == (self.width, self.height):
            return self
        across, down = width / self.width, height / self.height
        matrix = self.matrix.copy()
        matrix[0, 0], matrix[1, 1] = matrix[0, 0] * across, matrix[1, 1] * down
        matrix[0, 2], matrix[1, 2] = (matrix[0, 2] + 0.5) * across - 0.5, (matrix[1, 2] + 0.5) * down - 0.5
        return replace(self, width=width, height=height, matrix=matrix)

    def turned(self) -> Lens:
        """Return the lens for images rotated clockwise by 90 deg. For those rotated the other way, lengths differ only
        as far as the principal point is off centre and there is tangential distortion."""
        (fx, _, cx), (_, fy, cy), _ = self.matrix
        matrix = np.array([[fy, 0.0, self.height - 1 - cy], [0.0, fx, cx], [0.0, 0.0, 1.0]])
        distortion = self.distortion.copy()
        if self.model == "plumb_bob":
            distortion[2], distortion[3] = self.distortion[3], -self.distortion[2]
        return Lens(self.height, self.width, matrix, distortion, self.model)


def _alike(width: int, height: int, of_width: int, of_height: int) -> bool:
    """Whether two sizes have the same aspect ratio, up to rounding to a pixel."""
    return abs(width * of_height - height * of_width) <= max(width, height)


def read_lens(path: Path, camera: str | None = None) -> Lens:
    """Read a lens from a calibration; camera: which of several, by default the first. Raises SequenceError naming the
    file."""
    lenses = _of_sequence(path) if path.is_dir() or path.suffix == ".mcap" else _of_yaml(path)
    name = camera or next(iter(lenses))
    if name not in lenses:
        raise SequenceError(f"{path}: no camera {name!r}; its cameras: {', '.join(lenses)}")
    return lenses[name]


def _of_sequence(path: Path) -> dict[str, Lens]:
    found = {}
    for name, one in open_sequence(path).cameras.items():
        if one.port_m is not None:
            raise SequenceError(f"{path}: {name} looks through a flat port: expected a camera calibrated in water")
        found[name] = Lens(one.width, one.height, one.matrix, one.distortion, one.distortion_model)
    if not found:
        raise SequenceError(f"{path}: has no camera")
    return found


def _of_yaml(path: Path) -> dict[str, Lens]:
    from ruamel.yaml import YAML
    from ruamel.yaml.error import YAMLError

    try:
        content = YAML(typ="safe", pure=True).load(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, YAMLError, ValueError) as error:
        why = error.strerror if isinstance(error, OSError) else "not YAML"
        raise SequenceError(f"{path}: {why}; expected a calibration: {EXPECTED}") from None
    if not isinstance(content, Mapping):
        raise SequenceError(f"{path}: expected a calibration: {EXPECTED}")
    chain = {key: one for key, one in content.items() if re.fullmatch(r"cam\d+", str(key))} or {"cam0": content}
    try:
        return {str(key): _camera(one) for key, one in chain.items()}
    except (KeyError, TypeError, ValueError) as error:
        raise SequenceError(f"{path}: {_why(error)}; expected a calibration: {EXPECTED}") from None


def _why(error: Exception) -> str:
    return f"key {error.args[0]!r} is missing" if isinstance(error, KeyError) else str(error)


def _camera(values: Mapping[str, Any]) -> Lens:
    """Lens from the values of Kalibr, EuRoC (`intrinsics`), or ROS (`camera_matrix`)."""
    if values.get("camera_model", "pinhole") != "pinhole":
        raise ValueError(f"camera_model: expected pinhole, got {values['camera_model']}")
    said = str(values.get("distortion_model", "plumb_bob"))
    if said not in ("plumb_bob", "radtan", "radial-tangential", "equidistant", "fisheye", "none"):
        raise ValueError(f"distortion_model: expected plumb_bob, radtan or equidistant, got {said}")
    model = "equidistant" if said in ("equidistant", "fisheye") else "plumb_bob"
    if "camera_matrix" in values:
        matrix = _numbers(values["camera_matrix"]["data"], (9,)).reshape(3, 3)
        distortion = _numbers(values["distortion_coefficients"]["data"], (4, 5))
        width, height = values["image_width"], values["image_height"]
    else:
        fx, fy, cx, cy = _numbers(values["intrinsics"], (4,))
        matrix = np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])
        key = "distortion_coeffs" if "distortion_coeffs" in values else "distortion_coefficients"
        given = (values.get(key) or [0.0] * 4) if said == "none" else values[key]
        distortion = _numbers(given, (4, 5))
        width, height = values["resolution"]
    if not (matrix[0, 0] > 0 and matrix[1, 1] > 0 and int(width) > 0 and int(height) > 0):
        raise ValueError("expected focal lengths and a resolution above zero")
    return Lens(int(width), int(height), matrix, distortion, model)


def _numbers(values: Any, counts: tuple[int, ...]) -> Array:
    found = np.asarray(values, dtype=float).ravel()
    if len(found) not in counts or not np.isfinite(found).all():
        raise ValueError(f"expected {' or '.join(map(str, counts))} numbers, got {str(values)[:60]}")
    return found
