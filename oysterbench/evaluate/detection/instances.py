"""Single oysters in an image: those of the truth, or of an estimate."""

from __future__ import annotations

import math
import warnings
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from oysterbench.core.errors import LabelError, MissingExtraError
from oysterbench.core.masks import as_mask

OUTSIDE = 1.0
"""Distance by which a box may extend beyond the image, as after a crop, in widths or heights of the image."""

Box = tuple[float, float, float, float]
"""x, y, width, height in px."""

Runs = Mapping[str, Any]
"""A run-length encoded mask as in pycocotools: `size` [H, W] and compressed `counts`."""


def mask_tools() -> Any:
    """Return pycocotools' mask module. Raises MissingExtraError if it is not installed: the machine's fault, which no
    result of a method may hold."""
    try:
        from pycocotools import mask
    except ImportError:
        raise MissingExtraError(
            "reading COCO masks and matching oysters need pycocotools, which is not installed; type: pip install "
            "'oysterbench[score]'",
            name="pycocotools",
        ) from None
    return mask


@contextmanager
def numpy_2() -> Iterator[None]:
    """Silence numpy 2's warning that pycocotools 2.0.11 passes arrays as numpy 1 expected, which still works."""
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "__array__ implementation", DeprecationWarning)
        yield


@dataclass(frozen=True)
class Instance:
    """One oyster.

    box:   of the whole
    mask:  None if only the box is known
    area:  px, which COCO's classes small, medium and large refer to
    score: confidence of an estimate; NaN for the truth
    crowd: true for a region of the truth that is to be ignored
    live:  probability that it is alive, 1 or 0 for the truth; NaN if unknown
    parts: boxes of the separate parts of a crowd whose mask has several, each of which is compared with boxes
    """

    box: Box
    mask: Runs | None
    area: float
    score: float = math.nan
    crowd: bool = False
    live: float = math.nan
    parts: tuple[Box, ...] = ()

    @property
    def boxes(self) -> tuple[Box, ...]:
        """Boxes to be compared with boxes: its own or, of a crowd, those of its parts."""
        return self.parts or (self.box,)


@dataclass(frozen=True)
class ImageInstances:
    """The oysters of one image, H x W px; footprint_m2: area of seabed that it shows, seen from above.

    Raises LabelError for a box that is not finite, or too far outside the image.
    """

    name: str
    height: int
    width: int
    instances: tuple[Instance, ...]
    footprint_m2: float | None = None

    def __post_init__(self) -> None:
        for k, one in enumerate(self.instances):
            x, y, w, h = one.box
            across, down = self.width * OUTSIDE, self.height * OUTSIDE
            # NaN fails as well.
            inside = -across <= x <= x + w <= self.width + across and -down <= y <= y + h <= self.height + down
            if not inside:
                raise LabelError(
                    f"{self.name}: instance {k}: expected a box x, y, width, height in px, in or near the image of "
                    f"{self.width} x {self.height}, got {', '.join(f'{v:g}' for v in one.box)}"
                )


def instance_numbers(values: NDArray[Any], where: str) -> NDArray[np.integer]:
    """Check a plane (H, W) of instance numbers and return it: integers from 0, for none, that fit an int32. Raises
    LabelError that starts with `where`."""
    most = np.iinfo(np.int32).max
    if values.ndim == 2 and values.dtype.kind in "iu" and 0 <= values.min(initial=0) <= values.max(initial=0) <= most:
        return values
    raise LabelError(
        f"{where}: expected oyster numbers as integers (H, W) from 0 (none) to {most}, got {values.dtype} of "
        f"shape {values.shape}"
    )


def from_mask(
    mask: NDArray[np.bool_], score: float = math.nan, crowd: bool = False, live: float = math.nan
) -> Instance:
    """Make an instance from a mask (H, W) with at least one pixel."""
    tools = mask_tools()
    with numpy_2():
        runs = tools.encode(np.asfortranarray(as_mask(mask, "mask").view(np.uint8)))
        x, y, width, height = (float(value) for value in tools.toBbox(runs))
    return Instance((x, y, width, height), runs, float(tools.area(runs)), score, crowd, live)


def from_planes(
    name: str,
    numbers: NDArray[np.integer],
    ignore: NDArray[np.bool_] | None = None,
    footprint_m2: float | None = None,
    scores: Mapping[int, float] | None = None,
    live: Mapping[int, float] | None = None,
) -> ImageInstances:
    """Extract the instances of a plane (H, W) of numbers, 0 for none; scores, live: by number, the latter where known;
    ignore (H, W) becomes a crowd region, whose parts are pixels connected by edges or corners.

    Each mask is taken from its bounding box, as comparing the whole plane for each would take most of the time.
    """
    found = []
    height, width = numbers.shape
    for number, (top, left, part) in pieces(numbers).items():
        whole = np.zeros((height, width), dtype=bool)
        whole[top : top + part.shape[0], left : left + part.shape[1]] = part
        alive = (live or {}).get(number, math.nan)
        found.append(from_mask(whole, math.nan if scores is None else scores[number], live=alive))
    if ignore is not None and ignore.any():
        found.append(replace(from_mask(ignore, crowd=True), parts=part_boxes(ignore)))
    return ImageInstances(name, height, width, tuple(found), footprint_m2)


def part_boxes(mask: NDArray[np.bool_] | NDArray[np.uint8]) -> tuple[Box, ...]:
    """Boxes of the parts of a mask (H, W) that are connected by edges or corners."""
    from scipy.ndimage import find_objects, label

    found = find_objects(label(mask, structure=np.ones((3, 3)))[0])
    return tuple(
        (float(columns.start), float(rows.start), float(columns.stop - columns.start), float(rows.stop - rows.start))
        for rows, columns in found
    )


def pieces(numbers: NDArray[np.integer]) -> dict[int, tuple[int, int, NDArray[np.bool_]]]:
    """Top, left and mask of each number of a plane (H, W) except 0, the mask cropped to its bounding box."""
    from scipy.ndimage import find_objects

    known, plane = renumbered(numbers)
    return {
        number: (box[0].start, box[1].start, plane[box] == k)
        for k, (number, box) in enumerate(zip(known.tolist(), find_objects(plane), strict=True), start=1)
    }


def renumbered(numbers: NDArray[np.integer]) -> tuple[NDArray[np.integer], NDArray[np.int32]]:
    """The numbers (N,) in a plane (H, W), except 0 and in order, and the plane with 1 to N in their place: numbers
    composed of colours, as panoptic tools write them, are too large for a list of all up to the greatest."""
    oysters = numbers > 0
    known = np.unique(numbers[oysters])
    plane = np.zeros(numbers.shape, np.int32)
    plane[oysters] = np.searchsorted(known, numbers[oysters]) + 1
    return known, plane
