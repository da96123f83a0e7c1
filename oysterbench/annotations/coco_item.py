"""Annotations and results in COCO files, one at a time: score, state, box, mask. Whatever is wrong is named with its
place."""

from __future__ import annotations

import math
import re
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from oysterbench.core.errors import LabelError
from oysterbench.evaluate.detection import Instance
from oysterbench.evaluate.detection.instances import OUTSIDE, Runs, mask_tools, numpy_2, part_boxes
from oysterbench.evaluate.detection.states import ALIVE

PACKED = re.compile(rb"([P-o]{0,6}[0-O])+")
"""Compressed run lengths: each number is characters of 5 bits from '0' on, all but its last with a sixth bit set. Seven
hold any run of an image; pycocotools trusts that no number has more."""

UNSAID = (None, "", "__undefined__")
"""States of an oyster of which none was chosen; the last is CVAT's."""

ROUNDING = 0.01
"""By how much a fraction of width or height may be off 0 to 1."""


class CocoItem(NamedTuple):
    """An annotation or result, and where it is in the file. kind: state by its category, if this tells one."""

    where: str
    values: Mapping[str, Any]
    kind: str = "unknown"

    def score(self, default: float | None = None) -> float:
        """Return the score. Raises LabelError if there is none, and no default, or it is not from 0 to 1."""
        score = self.number("score", default)
        if not 0 <= score <= 1:
            raise LabelError(
                f"{self.where}: expected 'score' from 0 to 1, got {score:g}; divide percentages by 100, or apply a "
                "sigmoid to logits"
            )
        return score

    def number(self, key: str, default: float | None = None) -> float:
        """Return the number under a key. Raises LabelError if it is missing, or no finite float64."""
        value = self.values.get(key, default)
        if not _is_number(value):
            raise LabelError(f"{self.where}: expected {key!r}, a number, got {value!s:.60}")
        return float(value)

    @property
    def crowd(self) -> bool:
        """Whether it is a region to be ignored. Raises LabelError if `iscrowd` is neither 0 nor 1."""
        value = self.values.get("iscrowd")
        if value not in (None, 0, 1):
            raise LabelError(f"{self.where}: expected 'iscrowd', 0 or 1 as a number, got {value!r:.60}")
        return bool(value)

    @property
    def state(self) -> str:
        """State given under `state`, or there among the `attributes` that CVAT writes: live, dead or unknown; empty
        where none is. Raises LabelError for other texts."""
        value, further = self.values.get("state"), self.values.get("attributes")
        if value in UNSAID and isinstance(further, dict):
            value = further.get("state")
        found = "" if value in UNSAID else str(value).strip().casefold()
        if found not in ("live", "dead", "unknown", ""):
            raise LabelError(
                f"{self.where}: expected 'state', live, dead or unknown, got {value!r:.60}: write one of these, or "
                "rename an attribute that says something else"
            )
        return found


def check_px(path: Path, items: Sequence[CocoItem]) -> None:
    """Refuse a file whose boxes, or corners of polygons, are all fractions of width and height: each oyster would be
    one pixel. Raises LabelError."""
    boxes = [item.values["bbox"] for item in items if isinstance(item.values.get("bbox"), list)]
    masks = [item.values["segmentation"] for item in items if isinstance(item.values.get("segmentation"), list)]
    polygons = [polygon for mask in masks for polygon in mask if isinstance(polygon, list)]
    for what, lists in (("'bbox'", boxes), ("corners of polygons", polygons)):
        if not all(_is_number(value, -ROUNDING, 1 + ROUNDING) for values in lists for value in values):
            continue
        fractions = next((values for values in lists if any(0 < value < 1 for value in values)), None)
        if fractions is not None:
            raise LabelError(
                f"{path}: expected {what} in px, got fractions of width and height, {fractions!s:.60}: multiply x by "
                "the width of the image and y by its height"
            )


def _is_number(value: Any, low: float = -sys.float_info.max, high: float = sys.float_info.max) -> bool:
    """Whether a value is a number from low to high: not NaN, not infinite, and no integer too large for a float64."""
    return isinstance(value, int | float) and not isinstance(value, bool) and low <= value <= high


def _is_place(value: Any, size: int) -> bool:
    """Whether a value is a coordinate in or near an image with a width or height of `size` px."""
    return _is_number(value, -OUTSIDE * size, (1 + OUTSIDE) * size)


def instance_of(item: CocoItem, height: int, width: int, scored: bool) -> Instance:
    """Instance that an item of an image describes; scored: as an estimate. Raises LabelError if it is wrong."""
    values, tools = item.values, mask_tools()
    runs = run_lengths(item, height, width) if values.get("segmentation") else None
    crowd = not scored and item.crowd
    with numpy_2():
        given = values["bbox"] if "bbox" in values else tools.toBbox(runs).tolist()
        box = _box(item.where, given, height, width)
        area = float(tools.area(runs)) if runs is not None else box[2] * box[3]
        parts = part_boxes(tools.decode(runs)) if crowd and runs is not None else ()
    live = live_of(item)
    if scored:
        return Instance(box, runs, area, item.score(), live=live)
    return Instance(box, runs, item.number("area", area), crowd=crowd, live=live, parts=parts)


def live_of(item: CocoItem) -> float:
    """Probability that an item is alive, from the key `live`; where `state` is given, 1 if live or 0 if dead unless the
    probability says the same, as states are corrected by hand, and NaN if unknown. Without either, 1 or 0 by its
    category, or NaN."""
    value = item.values.get("live")
    if value is not None and not _is_number(value, 0, 1):
        raise LabelError(f"{item.where}: expected 'live', a probability, got {value!s:.60}")
    live = math.nan if value is None else float(value)
    state = item.state
    if not state and value is not None:
        return live
    state = state or item.kind
    if state == "unknown":
        return math.nan
    alive = state == "live"
    return live if value is not None and (live >= ALIVE) == alive else float(alive)


def _box(where: str, box: Any, height: int, width: int) -> tuple[float, float, float, float]:
    if isinstance(box, list) and len(box) == 4 and all(map(_is_number, box)):
        x, y, w, h = map(float, box)
        corners = ((x, width), (x + w, width), (y, height), (y + h, height))
        if w >= 0 and h >= 0 and all(_is_place(*corner) for corner in corners):
            return x, y, w, h
    raise LabelError(
        f"{where}: expected 'bbox' as [x, y, width, height] in px, in or near the image of {width} x {height}, got "
        f"{box!s:.60}"
    )


def run_lengths(item: CocoItem, height: int, width: int) -> Runs:
    """Encode the mask of an item for pycocotools: from polygons, of which it is the union, or run lengths, compressed
    or not. Raises LabelError if it is not a mask (H, W): pycocotools does not check its input."""
    where, segmentation, tools = item.where, item.values["segmentation"], mask_tools()
    if isinstance(segmentation, list):
        for polygon in segmentation:
            if not isinstance(polygon, list) or len(polygon) < 6 or len(polygon) % 2:
                count = len(polygon) if isinstance(polygon, list) else 0
                raise LabelError(f"{where}: expected polygons of at least three corners x y, got {count} numbers")
            if not all(_is_place(v, height if k % 2 else width) for k, v in enumerate(polygon)):
                raise LabelError(
                    f"{where}: expected the corners of polygons as numbers, in or near the image of {width} x "
                    f"{height} px, got {polygon!s:.60}"
                )
        with numpy_2():
            return dict(tools.merge(tools.frPyObjects(segmentation, height, width)))
    size = segmentation.get("size") if isinstance(segmentation, dict) else None
    if size != [height, width]:
        raise LabelError(f"{where}: expected run lengths of the size [{height}, {width}], got {size}")
    counts = segmentation.get("counts")
    wanted = f"{where}: expected run lengths that add up to {height * width} pixels, got"
    if isinstance(counts, list):
        known = all(type(n) is int and 0 <= n <= height * width for n in counts)
        if not known or sum(counts) != height * width:
            raise LabelError(f"{wanted} {sum(counts) if known else counts!s:.60}")
        with numpy_2():
            return dict(tools.frPyObjects({"size": [height, width], "counts": counts}, height, width))
    data = counts.encode("utf-8", "replace") if isinstance(counts, str) else b""
    # pycocotools refuses runs longer than the image, but reads beyond the end of shorter ones.
    if not PACKED.fullmatch(data) or not _fits(data, height * width) or _fits(data, height * width - 1):
        raise LabelError(f"{wanted} {counts!a:.40}")
    return {"size": [height, width], "counts": data}


def _fits(data: bytes, pixels: int) -> bool:
    """Whether compressed run lengths add up to at most so many pixels."""
    try:
        with numpy_2():
            mask_tools().decode({"size": [pixels, 1], "counts": data})
    except ValueError:
        return False
    return True
