"""Single oysters in an image: the truth's, and what a method says."""

from __future__ import annotations

import math
import warnings
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from oysterbench.core.arrays import truth_values
from oysterbench.core.errors import LabelError

OUTSIDE = 1.0
"""Widths or heights of the image by which a box or a corner may lie outside, as after a crop."""

Runs = Mapping[str, Any]
"""A mask as run lengths: `size` [H, W] and compressed `counts`, as pycocotools has them."""


def mask_tools() -> Any:
    """pycocotools' functions on masks. Raises LabelError where it is not installed."""
    try:
        from pycocotools import mask
    except ImportError:
        raise LabelError(
            "reading COCO masks and matching oysters need pycocotools, which is not installed: pip install "
            "'oysterbench[score]'"
        ) from None
    return mask


@contextmanager
def numpy_2() -> Iterator[None]:
    """pycocotools 2.0.11 hands its arrays to numpy in the way of numpy 1, which numpy 2 warns of, and does."""
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "__array__ implementation", DeprecationWarning)
        yield


@dataclass(frozen=True)
class Instance:
    """One oyster.

    box:   x, y, width, height in px
    mask:  None where only the box is known
    area:  px, by which COCO calls it small, medium or large
    score: of an estimate, greater is surer; NaN of the truth
    crowd: of the truth: a region that is to be ignored
    live:  probability that it is alive, 1 or 0 of the truth; NaN where that is not known
    """

    box: tuple[float, float, float, float]
    mask: Runs | None
    area: float
    score: float = math.nan
    crowd: bool = False
    live: float = math.nan


@dataclass(frozen=True)
class ImageInstances:
    """The oysters of one image, H x W px; footprint_m2: how much of the seabed, seen from above, it shows."""

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
    """The same plane (H, W), of numbers of instances: integers from 0, for none, that an int32 holds. Raises
    LabelError."""
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
    """An instance of a mask (H, W) that has at least a pixel."""
    tools = mask_tools()
    with numpy_2():
        runs = tools.encode(np.asfortranarray(truth_values(mask, "mask").view(np.uint8)))
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
    """The instances of a plane (H, W) of numbers, 0 for none; scores, live: by number, the latter where it is known;
    ignore (H, W) becomes a crowd region.

    Each is cut out of its box before it is encoded, as encoding the whole plane for each takes most of the time.
    """
    found = []
    height, width = numbers.shape
    for number, (top, left, part) in pieces(numbers).items():
        whole = np.zeros((height, width), dtype=bool)
        whole[top : top + part.shape[0], left : left + part.shape[1]] = part
        alive = (live or {}).get(number, math.nan)
        found.append(from_mask(whole, math.nan if scores is None else scores[number], live=alive))
    if ignore is not None and ignore.any():
        found.append(from_mask(ignore, crowd=True))
    return ImageInstances(name, height, width, tuple(found), footprint_m2)


def pieces(numbers: NDArray[np.integer]) -> dict[int, tuple[int, int, NDArray[np.bool_]]]:
    """Top, left and mask of each number of a plane (H, W) but 0, the mask cut to its box."""
    from scipy.ndimage import find_objects

    found = {}
    for k, box in enumerate(find_objects(numbers.astype(np.int32)), start=1):
        if box is not None:
            found[k] = (box[0].start, box[1].start, numbers[box] == k)
    return found
