"""Counts and measurements of the oysters in an image."""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from oysterbench.core.geometry import Array
from oysterbench.counting.least import EVERY_SIZE, Least
from oysterbench.counting.oysters import Oyster, Oysters
from oysterbench.counting.scale import QuadratScale, Scale, area_m2, border, length_and_width_mm, polygon_area

UNLIKE = 1.0
"""Novelty above which an image is unlike a method's training data (`methods.images.Segmentation`)."""

CUT_WEIGHT = 0.5
"""Weight, in a density without a quadrat, of an oyster cut by the image's edge: half of those have their centre
inside."""


@dataclass(frozen=True)
class OysterRow:
    """One oyster, for a table; None for an unknown value.

    counted: whether its centre lies in the counted region, and it is large enough; small: whether it lies there and is
    too small; cut: by the edge of the image, so that its sizes are those of a part. Boxes and areas in px, sizes in mm.
    """

    number: int
    counted: bool
    cut: bool
    box: tuple[float, float, float, float]
    area_px: float | None
    score: float | None
    live: float | None
    state: str
    length_mm: float | None = None
    width_mm: float | None = None
    small: bool = False


@dataclass(frozen=True)
class PictureCount:
    """Counts of an image, or of a frame of a video.

    name, file:  name of the image; path of its file
    width, height: px; index, time_s: of a frame of a video
    oysters:     number of those that are large enough, with their centre in the counted region; cut: how many of these
                 the edge of the image cuts
    live, dead:  how many of these; the method does not tell for the rest
    cover:       share of the counted region covered by oysters, of the ground in a quadrat, else of the pixels; None if
                 there are only boxes
    area_m2:     of the counted region; None without a scale
    measured:    how many of the oysters have sizes and are not cut; length_mm: their mean length
    novelty:     see `Segmentation`
    small:       how many more there would be if none were too small
    parts:       whether they are connected parts of a mask (`oysters.Oysters`)
    quadrat:     whether the counted region is a quadrat: of an oyster with its centre in it, no half lies elsewhere
    """

    name: str
    file: str
    width: int
    height: int
    oysters: int
    cut: int
    live: int
    dead: int
    cover: float | None
    area_m2: float | None
    novelty: float | None
    measured: int = 0
    length_mm: float | None = None
    index: int | None = None
    time_s: float | None = None
    small: int = 0
    parts: bool = False
    quadrat: bool = False

    @property
    def said(self) -> str:
        """The count in words: number of oysters, or of parts."""
        noun = "part" if self.parts else "oyster"
        return f"{self.oysters} {noun}{'' if self.oysters == 1 else 's'}"

    @property
    def unlike(self) -> bool:
        """Whether the image is unlike the method's training data."""
        return self.novelty is not None and self.novelty > UNLIKE

    @property
    def weighed(self) -> float:
        """Number of oysters, with those cut by the edge weighted by a half, if they are not those of a quadrat."""
        return self.oysters if self.quadrat else self.oysters - (1 - CUT_WEIGHT) * self.cut

    @property
    def per_m2(self) -> float | None:
        """Oysters per square metre; None without a scale."""
        return self.weighed / self.area_m2 if self.area_m2 else None

    @property
    def video(self) -> bool:
        """Whether it is a frame of a video."""
        return self.index is not None


def measure(
    found: Oysters, name: str, file: str, shape: tuple[int, int], scale: Scale | None, least: Least = EVERY_SIZE
) -> tuple[PictureCount, list[OysterRow]]:
    """Count and measure the oysters of an image (H, W). Those that are too small do not count towards cover either."""
    region = border(shape) if scale is None else scale.region(shape)
    smallest = least.for_image(shape, found.parts, scale is not None)
    rows = [_row(one, region, scale, *smallest) for one in found.each]
    counted = [row for row in rows if row.counted]
    small = [row.number for row in rows if row.small]
    lengths = [row.length_mm for row in counted if row.length_mm is not None and not row.cut]
    picture = PictureCount(
        name,
        file,
        shape[1],
        shape[0],
        oysters=len(counted),
        cut=sum(row.cut for row in counted),
        live=sum(row.state == "live" for row in counted),
        dead=sum(row.state == "dead" for row in counted),
        cover=None if found.numbers is None else _cover(without(found.numbers, small) > 0, scale, region),
        area_m2=None if scale is None else area_m2(scale, shape),
        novelty=_known(found.novelty),
        measured=len(lengths),
        length_mm=math.fsum(lengths) / len(lengths) if lengths else None,
        small=len(small),
        parts=found.parts,
        quadrat=isinstance(scale, QuadratScale),
    )
    return picture, rows


def _row(one: Oyster, region: Array, scale: Scale | None, shortest_mm: float, fewest_px: float) -> OysterRow:
    inside = len(region) > 2 and polygon_holds(region, one.centre)
    # Outside the quadrat, a point may be near the horizon of the homography.
    length_mm, width_mm = (None, None) if scale is None or not inside else length_and_width_mm(scale, one.hull)
    area_px = one.box[2] * one.box[3] if math.isnan(one.area_px) else one.area_px
    small = inside and (area_px < fewest_px or (length_mm is not None and length_mm < shortest_mm))
    return OysterRow(
        one.number,
        inside and not small,
        one.cut,
        one.box,
        _known(one.area_px),
        _known(one.score),
        _known(one.live),
        one.state,
        length_mm,
        width_mm,
        small,
    )


def without(numbers: NDArray[np.uint16], left_out: list[int]) -> NDArray[np.uint16]:
    """Numbers (H, W) of oysters, 0 for those that are left out."""
    kept = np.arange(int(numbers.max(initial=0)) + 1, dtype=np.uint16)
    kept[[number for number in left_out if number < len(kept)]] = 0
    return np.asarray(kept[numbers])


def polygon_holds(region: Array, point: Array) -> bool:
    """Whether a point (2,) lies in a polygon (K, 2), or on its border."""
    x, y = (float(value) for value in point)
    return cv2.pointPolygonTest(region.astype(np.float32).reshape(-1, 1, 2), (x, y), measureDist=False) >= 0


def _cover(mask: NDArray[np.bool_], scale: Scale | None, region: Array) -> float | None:
    if not isinstance(scale, QuadratScale):
        return float(mask.mean())
    inside = np.zeros(mask.shape, np.uint8)
    if polygon_area(region) == 0:
        return None
    cv2.fillConvexPoly(inside, np.round(region - 0.5).astype(np.int32), 1)
    ground, oysters = scale.flattened(inside), scale.flattened(inside & mask)
    return float(oysters.sum() / ground.sum()) if ground.any() else None


def _known(value: float) -> float | None:
    return None if math.isnan(value) else float(value)
