"""Conversion from pixels of an image to metres on the bottom, which is assumed to be flat.

The region of an image that is counted is the whole image, or what lies in a quadrat. Points are (x, y) in px from the
corner of the first pixel, whose centre is at (0.5, 0.5).
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
"""Spacing of points along an image's border, which a lens bends on the ground."""

LEAST_QUADRAT_PX = 8.0
"""Side of a square with the minimum area of a quadrat in an image, px: anything smaller is a mistake."""

LEAST_SEEN = 0.4
"""Minimum share of a quadrat that its image shows: with less, the corners are of an image of another size."""

LARGEST_QUADRAT_M = 10.0
"""Maximum side of a quadrat; a larger value is in centimetres: no diver carries such a frame, no image shows it."""

FLAT = 1000
"""Pixels along the side of a rectified quadrat: one per millimetre for a side of a metre."""


class Scale(Protocol):
    """Scale of an image: maps its points to metres on the bottom."""

    def fitted(self, shape: tuple[int, int], stored_width: int | None = None) -> Scale:
        """Return the scale for an image (H, W). Raises SequenceError or LabelError if it does not fit the image.

        stored_width: px, of an image that was widened or narrowed until its pixels were square.
        """
        ...

    def region(self, shape: tuple[int, int]) -> Array:
        """Corners (K, 2) px, in order around it, of the region of an image (H, W) that is counted."""
        ...

    def to_ground(self, points: Array) -> Array:
        """Map points (N, 2) px to points (N, 2) m on the bottom. Origin and axes depend on the kind of scale: only
        lengths and areas are comparable."""
        ...

    def as_dict(self) -> dict[str, Any]:
        """Return the scale as a dict, for records."""
        ...


@dataclass(frozen=True)
class PlainScale:
    """Scale of an image taken straight down, without lens distortion, in which the size of a pixel is known."""

    mm_per_px: float

    def __post_init__(self) -> None:
        _above_zero("--mm-per-px", self.mm_per_px, "millimetres")

    def fitted(self, shape: tuple[int, int], stored_width: int | None = None) -> PlainScale:
        """Return the scale itself: it fits an image of any size."""
        return self

    def region(self, shape: tuple[int, int]) -> Array:
        """The whole image."""
        return border(shape)

    def to_ground(self, points: Array) -> Array:
        """Scale the points by the same factor everywhere: metres from the image's corner, along its sides."""
        return np.asarray(points, dtype=float) * self.mm_per_px * 1e-3

    def as_dict(self) -> dict[str, Any]:
        """Return kind and value."""
        return {"kind": "plain", "mm_per_px": self.mm_per_px}


@dataclass(frozen=True)
class AltitudeScale:
    """Scale of an image taken straight down by a calibrated camera, from a known altitude above the bottom."""

    lens: Lens
    altitude_m: float

    def __post_init__(self) -> None:
        _above_zero("--altitude", self.altitude_m, "metres")

    def fitted(self, shape: tuple[int, int], stored_width: int | None = None) -> AltitudeScale:
        """Return the scale with the lens resized to the image."""
        return replace(self, lens=self.lens.resized(shape[1], shape[0], stored_width))

    def region(self, shape: tuple[int, int]) -> Array:
        """The whole image."""
        return border(shape)

    def to_ground(self, points: Array) -> Array:
        """Intersect the rays of the points with a plane perpendicular to the axis: metres from their intersection."""
        return self.lens.rays(np.asarray(points, dtype=float) - 0.5) * self.altitude_m

    def as_dict(self) -> dict[str, Any]:
        """Return kind, altitude and calibration."""
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
    """Scale by a square of known size that lies on the bottom: a homography from its four corners, so that the image
    may be oblique. Only oysters inside it are counted.

    corners: (4, 2) px, in any order. Raises OptionError if the size is not that of a quadrat, and LabelError, starting
    with `where`, if the corners cannot be those of a square seen from above.
    """

    def __init__(self, size_m: float, corners: Array, where: str = "quadrat") -> None:
        check_quadrat(size_m)
        self._where = where
        self.size_m = size_m
        self.corners = _going_round(np.asarray(corners, dtype=float), where)
        square = np.array([[0, 0], [1, 0], [1, 1], [0, 1]]) * size_m
        self._matrix = cv2.getPerspectiveTransform(self.corners.astype(np.float32), square.astype(np.float32))

    def fitted(self, shape: tuple[int, int], stored_width: int | None = None) -> QuadratScale:
        """Return the scale itself: its corners are of one image. Raises LabelError if that shows too little of it."""
        seen = polygon_area(self.region(shape)) / polygon_area(self.corners)
        if seen < LEAST_SEEN:
            raise LabelError(
                f"{self._where}: expected corners within the image of {shape[1]} x {shape[0]} px, got "
                f"{_listed(self.corners)}: were they marked in a resized copy?"
            )
        return self

    def region(self, shape: tuple[int, int]) -> Array:
        """The part of the quadrat that the image shows; (0, 2) if it shows none."""
        height, width = shape
        whole = np.array([[0, 0], [width, 0], [width, height], [0, height]], dtype=np.float32)
        _, part = cv2.intersectConvexConvex(self.corners.astype(np.float32), whole)
        found = np.empty((0, 2)) if part is None else np.asarray(part, dtype=float).reshape(-1, 2)
        # Of polygons that only share a part of a side, OpenCV 5.0 returns points as far away as 1e38.
        within = np.all((found >= -1.0) & (found <= [width + 1.0, height + 1.0]))
        return found if within else np.empty((0, 2))

    def to_ground(self, points: Array) -> Array:
        """Metres from a corner, along the quadrat's sides; which corner is not defined."""
        given = np.asarray(points, dtype=float).reshape(-1, 1, 2)
        if not len(given):
            return np.empty((0, 2))
        return np.asarray(cv2.perspectiveTransform(given, self._matrix), dtype=float).reshape(-1, 2)

    def flattened(self, plane: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """Rectify a plane (H, W) of the image to the quadrat (FLAT, FLAT) seen from above; 0 outside the image."""
        to_flat = np.diag([FLAT / self.size_m, FLAT / self.size_m, 1.0]) @ self._matrix
        # In OpenCV, the centre of the first pixel is at (0, 0).
        half = np.array([[1.0, 0.0, 0.5], [0.0, 1.0, 0.5], [0.0, 0.0, 1.0]])
        matrix = np.linalg.inv(half) @ to_flat @ half
        return np.asarray(cv2.warpPerspective(plane, matrix, (FLAT, FLAT), flags=cv2.INTER_NEAREST), dtype=np.uint8)

    def as_dict(self) -> dict[str, Any]:
        """Return kind, size and corners, and how an oyster that the edge of the image cuts counts."""
        return {"kind": "quadrat", "size_m": self.size_m, "corners_px": self.corners.tolist(), "cut": "whole"}


def check_quadrat(size_m: float) -> None:
    """Refuse a size that cannot be the side of a quadrat in metres. Raises OptionError."""
    _above_zero("--quadrat", size_m, "metres")
    if size_m > LARGEST_QUADRAT_M:
        unit, each = ("cm", 100) if size_m < 200 else ("mm", 1000)
        raise OptionError(
            f"--quadrat: expected the side in metres, at most {LARGEST_QUADRAT_M:g}, got {size_m:g}: {size_m:g} {unit} "
            f"are --quadrat {size_m / each:g}"
        )


def border(shape: tuple[int, int]) -> Array:
    """Points (K, 2) px, closely spaced along the border of an image (H, W), in order around it."""
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
    """Area of the bottom, m^2, in the region of an image (H, W) that is counted."""
    return polygon_area(scale.to_ground(scale.region(shape)))


def polygon_area(corners: Array) -> float:
    """Area of a polygon (K, 2) that does not intersect itself, by the shoelace formula."""
    x, y = np.asarray(corners, dtype=float).reshape(-1, 2).T
    return abs(float(np.dot(x, np.roll(y, -1)) - np.dot(y, np.roll(x, -1)))) / 2


def length_and_width_mm(scale: Scale, hull: Array) -> tuple[float, float]:
    """Longer and shorter side, mm, of the smallest rectangle around an oyster on the bottom; hull: (N, 2) px."""
    ground = scale.to_ground(hull) * 1e3
    _, sides, _ = cv2.minAreaRect((ground - ground.mean(axis=0)).astype(np.float32))
    return max(sides), min(sides)


def _going_round(corners: Array, where: str) -> Array:
    """Sort the corners into their order around the quadrat. The corners of a convex quadrilateral have only one, up to
    its start and direction, on which neither areas nor lengths depend. Raises LabelError for anything else."""
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
