"""Checks of the arrays that a method for images predicts, which are not trusted.

Each raises MethodError, in one line that starts with `where`.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from oysterbench.core.errors import MethodError
from oysterbench.core.geometry import Array
from oysterbench.methods.images import Detections


def checked_scores(prediction: Detections, where: str) -> tuple[Array, Array]:
    """Return the scores (N,), finite, and the probabilities (N,) of being alive, NaN where the method does not tell."""
    scores = np.asarray(prediction.scores).ravel()
    if scores.dtype.kind not in "iuf" or not np.isfinite(scores.astype(float)).all():
        raise MethodError(f"{where}: expected scores (N,), finite numbers, got {scores.dtype} {scores[:4]}")
    if prediction.live is None:
        return scores.astype(float), np.full(len(scores), np.nan)
    live, count = np.asarray(prediction.live).ravel(), len(scores)
    known = live.dtype.kind in "biuf"
    if not known or len(live) != count or not ((live >= 0) & (live <= 1) | np.isnan(live.astype(float))).all():
        raise MethodError(
            f"{where}: expected live ({count},), a probability of each oyster or NaN, got {live.dtype} {live[:4]} of "
            f"{len(live)}"
        )
    return scores.astype(float), live.astype(float)


def checked_masks(masks: NDArray[Any], count: int, shape: tuple[int, int], where: str) -> NDArray[Any]:
    """Return the masks (N, H, W) of `count` oysters in an image of size (H, W); their values are not looked at."""
    check_count(len(masks) if masks.ndim else 0, count, where)
    if masks.ndim != 3:
        raise MethodError(f"{where}: expected masks (N, H, W), got an array of shape {masks.shape}")
    check_shape(masks.shape[1:], shape, where)
    return masks


def checked_boxes(boxes: NDArray[Any], count: int, where: str) -> Array:
    """Return the boxes (N, 4) of `count` oysters."""
    check_count(len(boxes) if boxes.ndim else 0, count, where)
    boxes = boxes.reshape(0, 4) if not boxes.size else boxes
    if boxes.ndim != 2 or boxes.shape[1] != 4 or boxes.dtype.kind not in "iuf":
        raise MethodError(
            f"{where}: expected boxes (N, 4), x, y, width, height in px, got {boxes.dtype} of shape {boxes.shape}"
        )
    return boxes.astype(float)


def check_count(count: int, scores: int, where: str, at_most: bool = False) -> None:
    """Check that there are as many scores as oysters; at_most: or more."""
    if count > scores or (count < scores and not at_most):
        raise MethodError(f"{where}: expected a score for each of {count} oysters, got {scores}")


def check_shape(found: tuple[int, ...], shape: tuple[int, int], where: str) -> None:
    """Check that an array has the size (H, W) of its image."""
    if found != shape:
        size, got = (" x ".join(str(n) for n in one[::-1]) for one in (shape, found))
        raise MethodError(f"{where}: expected a prediction of the image's size, {size}, got {got}")
