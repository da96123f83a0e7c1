"""From the pixels of a picture to metres on the bottom, which is taken to be flat.

What is counted of a picture is a region: the whole picture, or what lies in a quadrat. Points are (x, y) in px from the
corner of the first pixel, whose middle lies at (0.5, 0.5).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any, Protocol

import cv2
import numpy as np
from numpy.typing import NDArray

from oysterbench.core.errors import LabelError, OptionError
from oysterbench.core.geometry import Array
from oysterbench.counting.lens import Lens

BORDER_PX = 16.0
"""Between points of a picture's border, where a lens bends it."""

LEAST_QUADRAT_PX = 8.0
"""Side of the smallest square that a quadrat may cover in a picture: less is no quadrat but a slip."""

LEAST_SEEN = 0.4
"""Share of a quadrat that its picture shows at least: less, and the corners are of a picture of another size."""

LARGEST_QUADRAT_M = 10.0
"""More is a size in centimetres: no diver carries such a frame, and no picture under water shows it."""

FLAT = 1000
"""Pixels along a side of a quadrat that is seen from straight above: a millimetre for one of a metre."""


class Scale(Protocol):
    """What tells metres in a picture."""

    def fitted(self, shape: tuple[int, int]) -> Scale:
        """The same for a picture (H, W). Raises SequenceError or LabelError where it does not fit one."""
        ...

    def region(self, shape: tuple[int, int]) -> Array:
        """(K, 2) px: the corners, going round, of what is counted of a picture (H, W)."""
        ...

    def to_ground(self, points: Array) -> Array:
        """(N, 2) m on the bottom of points (N, 2) px."""
        ...

    def as_dict(self) -> dict[str, Any]:
        """What it is, for records."""
        ...


@dataclass(frozen=True)
class PlainScale:
    """A picture straight down, without a lens's distortion, of which a length is known."""

    mm_per_px: float

    def __post_init__(self) -> None:
        _above_zero("--mm-per-px", self.mm_per_px, "millimetres")

    def fitted(self, shape: tuple[int, int]) -> PlainScale:
        """Whatever its size."""
        return self

    def region(self, shape: tuple[int, int]) -> Array:
        """The whole picture."""
        return border(shape)

    def to_ground(self, points: Array) -> Array:
        """Millimetres per pixel, everywhere."""
        return np.asarray(points, dtype=float) * self.mm_per_px * 1e-3

    def as_dict(self) -> dict[str, Any]:
        """Kind and value."""
        return {"kind": "plain", "mm_per_px": self.mm_per_px}


@dataclass(frozen=True)
class AltitudeScale:
    """A picture straight down, from so many metres above the bottom, by a calibrated camera."""

    lens: Lens
    altitude_m: float

    def __post_init__(self) -> None:
        _above_zero("--altitude", self.altitude_m, "metres")

    def fitted(self, shape: tuple[int, int]) -> AltitudeScale:
        """With the lens of pictures of its size."""
        return replace(self, lens=self.lens.resized(shape[1], shape[0]))

    def region(self, shape: tuple[int, int]) -> Array:
        """The whole picture."""
        return border(shape)

    def to_ground(self, points: Array) -> Array:
        """Rays to a plane at right angles to the axis."""
        return self.lens.rays(np.asarray(points, dtype=float) - 0.5) * self.altitude_m

    def as_dict(self) -> dict[str, Any]:
        """Kind, altitude and calibration."""
        lens = self.lens
        return {
            "kind": "altitude",
            "altitude_m": self.altitude_m,
            "resolution": [lens.width, lens.height],
            "matrix": lens.matrix.tolist(),
            "distortion": lens.distortion.tolist(),
            "model": lens.model,
        }


class QuadratScale:
    """A square of known size that lies on the bottom: a homography from its four corners, so that the picture may be
    oblique. Only what lies in it is counted.

    corners: (4, 2) px, in any order. Raises OptionError where the size is no length of a quadrat, and LabelError,
    beginning with `where`, where they are no corners of a square seen from above.
    """

    def __init__(self, size_m: float, corners: Array, where: str = "quadrat") -> None:
        check_quadrat(size_m)
        self._where = where
        self.size_m = size_m
        self.corners = _going_round(np.asarray(corners, dtype=float), where)
        square = np.array([[0, 0], [1, 0], [1, 1], [0, 1]]) * size_m
        self._matrix = cv2.getPerspectiveTransform(self.corners.astype(np.float32), square.astype(np.float32))

    def fitted(self, shape: tuple[int, int]) -> QuadratScale:
        """Its corners are of one picture, of any size. Raises LabelError where that shows too little of the quadrat."""
        seen = polygon_area(self.region(shape)) / polygon_area(self.corners)
        if seen < LEAST_SEEN:
            raise LabelError(
                f"{self._where}: expected corners within the image of {shape[1]} x {shape[0]} px, got "
                f"{_listed(self.corners)}: are they of a copy of another size?"
            )
        return self

    def region(self, shape: tuple[int, int]) -> Array:
        """The part of the quadrat that the picture shows; (0, 2) for none."""
        height, width = shape
        whole = np.array([[0, 0], [width, 0], [width, height], [0, height]], dtype=np.float32)
        _, part = cv2.intersectConvexConvex(self.corners.astype(np.float32), whole)
        return np.empty((0, 2)) if part is None else np.asarray(part, dtype=float).reshape(-1, 2)

    def to_ground(self, points: Array) -> Array:
        """Metres from a corner, along the quadrat's sides."""
        given = np.asarray(points, dtype=float).reshape(-1, 1, 2)
        if not len(given):
            return np.empty((0, 2))
        return np.asarray(cv2.perspectiveTransform(given, self._matrix), dtype=float).reshape(-1, 2)

    def flattened(self, plane: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """(FLAT, FLAT) as seen from straight above, of a plane (H, W) of the picture; 0 where that does not reach."""
        to_flat = np.diag([FLAT / self.size_m, FLAT / self.size_m, 1.0]) @ self._matrix
        # Of OpenCV, the middle of the first pixel lies at (0, 0).
        half = np.array([[1.0, 0.0, 0.5], [0.0, 1.0, 0.5], [0.0, 0.0, 1.0]])
        matrix = np.linalg.inv(half) @ to_flat @ half
        return np.asarray(cv2.warpPerspective(plane, matrix, (FLAT, FLAT), flags=cv2.INTER_NEAREST), dtype=np.uint8)

    def as_dict(self) -> dict[str, Any]:
        """Kind, size and corners."""
        return {"kind": "quadrat", "size_m": self.size_m, "corners_px": self.corners.tolist()}


def check_quadrat(size_m: float) -> None:
    """Raises OptionError for what is no side of a quadrat in metres."""
    _above_zero("--quadrat", size_m, "metres")
    if size_m > LARGEST_QUADRAT_M:
        unit, each = ("cm", 100) if size_m < 200 else ("mm", 1000)
        raise OptionError(
            f"--quadrat: expected the side in metres, at most {LARGEST_QUADRAT_M:g}, got {size_m:g}: {size_m:g} {unit} "
            f"are --quadrat {size_m / each:g}"
        )


def border(shape: tuple[int, int]) -> Array:
    """(K, 2) px: points around a picture (H, W), close to each other, going round."""
    height, width = shape
    across = np.linspace(0, width, max(2, math.ceil(width / BORDER_PX) + 1))
    down = np.linspace(0, height, max(2, math.ceil(height / BORDER_PX) + 1))
    sides = (
        (across[:-1], np.zeros(len(across) - 1)),
        (np.full(len(down) - 1, width), down[:-1]),
        (across[:0:-1], np.full(len(across) - 1, height)),
        (np.zeros(len(down) - 1), down[:0:-1]),
    )
    return np.concatenate([np.stack(side, axis=1) for side in sides]).astype(float)


def area_m2(scale: Scale, shape: tuple[int, int]) -> float:
    """Of the bottom, of what is counted of a picture (H, W)."""
    return polygon_area(scale.to_ground(scale.region(shape)))


def polygon_area(corners: Array) -> float:
    """Of a polygon (K, 2) that does not cross itself: the shoelace formula."""
    x, y = np.asarray(corners, dtype=float).reshape(-1, 2).T
    return abs(float(np.dot(x, np.roll(y, -1)) - np.dot(y, np.roll(x, -1)))) / 2


def length_and_width_mm(scale: Scale, hull: Array) -> tuple[float, float]:
    """Sides of the smallest rectangle around an oyster on the bottom; hull: (N, 2) px."""
    ground = scale.to_ground(hull) * 1e3
    _, sides, _ = cv2.minAreaRect((ground - ground.mean(axis=0)).astype(np.float32))
    return max(sides), min(sides)


def _going_round(corners: Array, where: str) -> Array:
    """The same corners in the order in which one goes round them. Four points that each stick out have one such order,
    up to where it begins and its sense, which neither areas nor lengths depend on."""
    if corners.shape != (4, 2) or not np.isfinite(corners).all():
        raise LabelError(f"{where}: expected four corners x, y in px, got {corners.tolist()}")
    if corners.min() >= 0 and corners.max() <= 1:
        raise LabelError(
            f"{where}: expected corners in px of the upright image, got fractions of its size, "
            f"{_listed(corners)}: multiply x by its width and y by its height"
        )
    outline = cv2.convexHull(corners.astype(np.float32)).reshape(-1, 2).astype(float)
    if len(outline) < 4 or polygon_area(outline) < LEAST_QUADRAT_PX**2:
        raise LabelError(f"{where}: expected the four corners of a convex quadrat, got {_listed(corners)}")
    return outline


def _listed(corners: Array) -> str:
    return ", ".join(f"({x:g}, {y:g})" for x, y in corners)


def _above_zero(option: str, value: float, unit: str) -> None:
    if not 0 < value < math.inf:  # NaN fails as well
        raise OptionError(f"{option}: expected {unit} above 0, got {value:g}")
