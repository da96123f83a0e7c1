"""Metrics of masks, each a function of the true and the estimated ones.

truth: mask (H, W) of the oysters, bool or 0 and 1; or several, as (N, H, W) or an iterable.
estimate: the same, or probabilities from 0 to 1, which count as oyster from `threshold` on.
ignore: of the shape of truth, pixels that are not scored.

The pixels of several images are counted together, as over a data set, never averaged over images, except by
`image_iou`. CPU tensors are accepted as arrays.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from itertools import zip_longest
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from oysterbench.core.errors import LabelError
from oysterbench.core.masks import as_mask
from oysterbench.evaluate.segmentation import ClipScorer, EstimateImage, SegmentationSettings, TruthImage
from oysterbench.recipe import OYSTER

Masks = ArrayLike | Iterable[ArrayLike]


def iou(truth: Masks, estimate: Masks, ignore: Masks | None = None, threshold: float = 0.5) -> float:
    """Intersection over union of the oysters, over all images together; 1 if neither has any.

    Parameters
    ----------
    truth : (H, W) or (N, H, W) array of bool, or several of (H, W)
        True masks of the oysters.
    estimate : the same, or probabilities from 0 to 1
        Estimated masks.
    ignore : as truth, optional
        Pixels that are not scored.
    threshold : float
        Minimum probability that counts as oyster.

    Returns
    -------
    float
        0 to 1.

    Raises
    ------
    oysterbench.core.errors.LabelError
        The arguments differ in size or number, or are neither masks nor probabilities.

    Examples
    --------
    >>> import oysterbench
    >>> oysterbench.metrics.iou([[1, 1, 0, 0]], [[1, 0, 0, 0]])
    0.5
    >>> oysterbench.metrics.iou([[1, 1, 0, 0]], [[0.9, 0.2, 0.6, 0.1]], ignore=[[0, 0, 1, 0]])
    0.5
    """
    return _metric("iou", truth, estimate, ignore, threshold)


def dice(truth: Masks, estimate: Masks, ignore: Masks | None = None, threshold: float = 0.5) -> float:
    """Twice the intersection over the sum of both areas (F1 of the pixels); parameters as for `iou`.

    Examples
    --------
    >>> import oysterbench
    >>> round(oysterbench.metrics.dice([[1, 1, 0, 0]], [[1, 0, 0, 0]]), 4)
    0.6667
    """
    return _metric("dice", truth, estimate, ignore, threshold)


def precision(truth: Masks, estimate: Masks, ignore: Masks | None = None, threshold: float = 0.5) -> float:
    """Share (0 to 1) of the pixels predicted as oyster that are; NaN if there are none; parameters as for `iou`.

    Examples
    --------
    >>> import oysterbench
    >>> oysterbench.metrics.precision([[1, 1, 0, 0]], [[1, 0, 0, 0]])
    1.0
    """
    return _metric("precision", truth, estimate, ignore, threshold)


def recall(truth: Masks, estimate: Masks, ignore: Masks | None = None, threshold: float = 0.5) -> float:
    """Share (0 to 1) of the oyster pixels that are predicted as such; NaN if there are none; parameters as for `iou`.

    Examples
    --------
    >>> import oysterbench
    >>> oysterbench.metrics.recall([[1, 1, 0, 0]], [[1, 0, 0, 0]])
    0.5
    """
    return _metric("recall", truth, estimate, ignore, threshold)


def boundary_iou(
    truth: Masks, estimate: Masks, ignore: Masks | None = None, threshold: float = 0.5, share: float = 0.02
) -> float:
    """Intersection over union of the masks' borders (Cheng et al. 2021); other parameters as for `iou`.

    Parameters
    ----------
    share : float
        Depth of a border as a share of the image's diagonal, at least one pixel.

    Examples
    --------
    >>> import numpy as np, oysterbench
    >>> truth, shifted = np.zeros((2, 20, 20), dtype=bool)
    >>> truth[5:15, 5:15], shifted[5:15, 6:16] = True, True
    >>> round(oysterbench.metrics.boundary_iou(truth, shifted), 3), round(oysterbench.metrics.iou(truth, shifted), 3)
    (0.333, 0.818)
    """
    return _metric("boundary_iou", truth, estimate, ignore, threshold, boundary_share=share)


def image_iou(truth: Masks, estimate: Masks, ignore: Masks | None = None, threshold: float = 0.5) -> float:
    """Mean over images of their intersection over union, all weighted equally; parameters as for `iou`.

    Examples
    --------
    >>> import oysterbench
    >>> oysterbench.metrics.image_iou([[[1, 1]], [[1, 0]]], [[[1, 0]], [[1, 0]]])
    0.75
    """
    return _metric("image_iou", truth, estimate, ignore, threshold)


def _metric(key: str, truth: Masks, estimate: Masks, ignore: Masks | None, threshold: float, **settings: Any) -> float:
    scorer = ClipScorer(SegmentationSettings(threshold=threshold, **settings))
    ignored = _pictures(ignore) if ignore is not None else None
    for number, (true, said) in enumerate(zip_longest(_pictures(truth), _pictures(estimate))):
        where = f"image {number}"
        if true is None or said is None:
            raise LabelError(f"expected as many estimated images as true ones, got none of one of them for {where}")
        left_out = next(ignored, None) if ignored is not None else None
        if ignored is not None and (left_out is None or left_out.shape != true.shape):
            raise LabelError(f"{where}: ignore: expected an array of shape {true.shape}, as truth has")
        classes = np.where(as_mask(true, f"{where}: truth"), np.uint8(OYSTER), np.uint8(0))
        asked = None if left_out is None else as_mask(left_out, f"{where}: ignore")
        given = {"probability" if said.dtype.kind == "f" else "oyster": said}
        scorer.add(TruthImage(where, classes, named=False, ignore=asked), EstimateImage(where, **given))
    if ignored is not None and next(ignored, None) is not None:
        raise LabelError("ignore: expected as many images as truth has, got more")
    return float(scorer.result().metrics[key])


def _pictures(masks: Masks) -> Iterator[NDArray[Any]]:
    """Yield the images one by one, each (H, W)."""
    if isinstance(masks, list | tuple) and masks and np.ndim(masks[0]) < 2:
        masks = np.asarray(masks)
    if hasattr(masks, "ndim") or hasattr(masks, "__array__"):
        array = _array(masks)
        if array.ndim not in (2, 3):
            raise LabelError(f"expected masks (H, W) or (N, H, W), got an array of shape {array.shape}")
        masks = [array] if array.ndim == 2 else list(array)
    if not isinstance(masks, Iterable):
        raise LabelError(f"expected masks (H, W) or (N, H, W), or several of (H, W), got {masks!r:.80}")
    for one in masks:
        array = _array(one)
        if array.ndim != 2:
            raise LabelError(f"expected masks (H, W), got one of shape {array.shape}")
        yield array


def _array(mask: Any) -> NDArray[Any]:
    """A mask as an array. Raises LabelError for a tensor that cannot become one."""
    try:
        return np.asarray(mask)
    except (TypeError, RuntimeError) as error:
        raise LabelError(f"expected masks that NumPy can read, such as tensor.float().cpu().numpy(): {error}") from None
