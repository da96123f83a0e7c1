"""Single oysters in an image, from whatever a method for images predicts."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from oysterbench.annotations.parts import connected_parts
from oysterbench.core.errors import MethodError
from oysterbench.core.geometry import Array
from oysterbench.core.masks import as_mask
from oysterbench.evaluate.detection.instances import instance_numbers, pieces
from oysterbench.evaluate.detection.states import ALIVE
from oysterbench.evaluate.segmentation import EstimateImage
from oysterbench.methods.checks import check_count, check_shape, checked_boxes, checked_masks, checked_scores
from oysterbench.methods.images import Detections, Segmentation

MOST = 65535
"""Maximum number of oysters in an image, as their numbers are stored in 16 bits."""


@dataclass(frozen=True)
class Oyster:
    """One oyster in an image.

    number:  of its pixels in the plane of numbers, from 1
    box:     x, y, width, height in px; area_px: of its mask, NaN if there is none
    centre:  (2,) x, y in px, of its mask, or else of its box
    hull:    (N, 2) x, y in px: the corners of the convex hull of its pixels, or of its box
    score:   confidence of the method; NaN if it gives none
    live:    probability that it is alive; NaN if the method cannot tell
    cut:     whether the edge of the image cuts it
    """

    number: int
    box: tuple[float, float, float, float]
    area_px: float
    centre: Array
    hull: Array
    score: float
    live: float
    cut: bool

    @property
    def state(self) -> str:
        """live, dead, or unknown."""
        return "unknown" if math.isnan(self.live) else "live" if self.live >= ALIVE else "dead"


@dataclass(frozen=True)
class Oysters:
    """All oysters found in an image.

    numbers: (H, W) uint16, 0 for none, the most confident on top where oysters overlap; None if there are only boxes
    novelty: see `Segmentation`; NaN if the method gives none
    parts:   whether they are the connected parts of a mask, so that touching oysters are one
    """

    each: tuple[Oyster, ...]
    numbers: NDArray[np.uint16] | None
    novelty: float
    parts: bool = False


class TooManyError(MethodError):
    """Error for more oysters in an image than can be numbered, as in an image of noise."""


def oysters_of(prediction: Segmentation | Detections, method: str, shape: tuple[int, int], threshold: float) -> Oysters:
    """Extract the oysters of an image (H, W) whose score is at least `threshold`.

    In masks and classes, and in probabilities of at least `threshold`, each part connected by edges or corners is one
    oyster; its score is its mean probability. The arrays of a method are not trusted but checked: raises MethodError or
    LabelError; TooManyError for more oysters than `MOST`.
    """
    where = f"method {method!r} on {prediction.name}"
    novelty = _novelty(prediction.novelty, where)
    parts = isinstance(prediction, Segmentation)
    if isinstance(prediction, Segmentation):
        found = _connected(prediction, where, shape, threshold)
    elif prediction.boxes is not None:
        return Oysters(tuple(_boxes(prediction, where, shape, threshold)), None, novelty)
    elif prediction.masks is not None:
        found = _masked(prediction, where, shape, threshold)
    else:
        found = _numbered(prediction, where, shape, threshold)
    if len(found.scores) > MOST:
        what = "connected parts of a mask" if parts else "oysters"
        raise TooManyError(f"{where}: expected at most {MOST} oysters in an image, got {len(found.scores)} {what}")
    return Oysters(tuple(_measured(found, shape)), found.numbers.astype(np.uint16), novelty, parts)


@dataclass(frozen=True)
class _Parts:
    """Oysters before measurement: numbers (H, W); top, left and mask of each number that has pixels; scores and live of
    numbers 1, 2, ..."""

    numbers: NDArray[np.integer[Any]]
    pieces: Mapping[int, tuple[int, int, NDArray[np.bool_]]]
    scores: Sequence[float]
    live: Sequence[float]


def _connected(prediction: Segmentation, where: str, shape: tuple[int, int], threshold: float) -> _Parts:
    said = EstimateImage(where, prediction.oyster, prediction.probability, prediction.classes)
    check_shape(said.shape, shape, where)
    numbers, means = connected_parts(said.mask(threshold), said.probability)
    count = int(numbers.max(initial=0))
    scores = [math.nan] * count if means is None else means.tolist()
    return _Parts(numbers, pieces(numbers), scores, [math.nan] * count)


def _masked(prediction: Detections, where: str, shape: tuple[int, int], threshold: float) -> _Parts:
    """Oysters of masks that may overlap: the most confident is on top in the plane, but each is measured by its whole
    mask."""
    scores, live = checked_scores(prediction, where)
    masks = checked_masks(np.asarray(prediction.masks), len(scores), shape, where)
    kept = np.flatnonzero(scores >= threshold)
    order = kept[np.argsort(scores[kept], kind="stable")]
    numbers = np.zeros(shape, np.int32)
    found = {}
    for number, k in enumerate(order, start=1):
        mask = as_mask(masks[k], where)
        numbers[mask] = number
        if whole := pieces(mask.view(np.uint8)):
            found[number] = whole[1]
    return _Parts(numbers, found, scores[order].tolist(), live[order].tolist())


def _numbered(prediction: Detections, where: str, shape: tuple[int, int], threshold: float) -> _Parts:
    scores, live = checked_scores(prediction, where)
    if prediction.numbers is None:
        raise MethodError(f"{where}: expected numbers, masks or boxes of oysters, got none of them")
    plane = instance_numbers(np.asarray(prediction.numbers), where)
    check_shape(plane.shape, shape, where)
    check_count(int(plane.max(initial=0)), len(scores), where, at_most=True)
    kept = np.flatnonzero(scores >= threshold)
    dense = np.zeros(len(scores) + 1, np.int32)
    dense[kept + 1] = np.arange(1, len(kept) + 1)
    numbers = dense[plane]
    return _Parts(numbers, pieces(numbers), scores[kept].tolist(), live[kept].tolist())


def _boxes(prediction: Detections, where: str, shape: tuple[int, int], threshold: float) -> Iterator[Oyster]:
    scores, live = checked_scores(prediction, where)
    boxes = checked_boxes(np.asarray(prediction.boxes), len(scores), where)
    if not np.isfinite(boxes).all():
        raise MethodError(f"{where}: expected boxes of finite numbers, got {boxes[~np.isfinite(boxes).all(axis=1)][0]}")
    height, width = shape
    for number, k in enumerate(np.flatnonzero(scores >= threshold), start=1):
        x, y, w, h = boxes[k].tolist()
        corners = np.array([[x, y], [x + w, y], [x + w, y + h], [x, y + h]])
        cut = x <= 0 or y <= 0 or x + w >= width or y + h >= height
        middle = np.array([x + w / 2, y + h / 2])
        yield Oyster(number, (x, y, w, h), math.nan, middle, corners, float(scores[k]), float(live[k]), cut)


def _measured(found: _Parts, shape: tuple[int, int]) -> Iterator[Oyster]:
    height, width = shape
    for number, (top, left, mask) in found.pieces.items():
        rows, columns = np.nonzero(mask)
        tall, wide = mask.shape
        yield Oyster(
            number,
            (float(left), float(top), float(wide), float(tall)),
            float(len(rows)),
            np.array([left + columns.mean() + 0.5, top + rows.mean() + 0.5]),
            _hull(rows, columns) + np.array([left, top]),
            found.scores[number - 1],
            found.live[number - 1],
            top == 0 or left == 0 or top + tall == height or left + wide == width,
        )


def _hull(rows: NDArray[np.intp], columns: NDArray[np.intp]) -> Array:
    """Convex hull (N, 2), x, y, of whole pixels, each of which covers [column, column + 1)."""
    first = cv2.convexHull(np.stack([columns, rows], axis=1).astype(np.int32)).reshape(-1, 2)
    corners = np.concatenate([first + step for step in ((0, 0), (1, 0), (0, 1), (1, 1))])
    return cv2.convexHull(corners.astype(np.int32)).reshape(-1, 2).astype(float)


def _novelty(value: float | None, where: str) -> float:
    if value is None:
        return math.nan
    if not float(value) >= 0:  # NaN fails as well
        raise MethodError(f"{where}: expected a novelty from 0, got {value}")
    return float(value)
