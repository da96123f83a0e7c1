"""Metrics of single oysters, each a function of the true and the estimated ones.

truth, estimate: for each image a plane (H, W) of integers, a number for each oyster and 0 for none; or
`oysterbench.evaluate.detection.ImageInstances`, which may have boxes instead. They are matched by pycocotools:
pip install 'oysterbench[score]'.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from oysterbench.core.errors import LabelError
from oysterbench.evaluate.detection import DetectionScorer, DetectionSettings, ImageInstances
from oysterbench.evaluate.detection.instances import from_planes, instance_numbers

Planes = ArrayLike | Sequence[ArrayLike | ImageInstances]
Scores = Sequence[Mapping[int, float]]
Counts = Sequence[float] | ArrayLike


def average_precision(
    truth: Planes,
    estimate: Planes,
    scores: Scores | None = None,
    kind: Literal["mask", "box"] = "mask",
    overlap: Literal[50, 75] | None = None,
) -> float:
    """Average precision as defined by COCO, over the 300 most confident estimates of each image.

    Parameters
    ----------
    truth, estimate : (H, W) or (N, H, W) array of int, or a list of (H, W) or ImageInstances
        The oysters of each image, by number; 0 is none.
    scores : list of dict of int to float, optional
        For each image, the confidence of each estimated oyster by its number; all equal by default.
    kind : {"mask", "box"}
        What is matched.
    overlap : {50, 75}, optional
        Minimum intersection over union, in %, of a match; by default, the mean over 50, 55, ..., 95.

    Returns
    -------
    float
        0 to 1; NaN if there is no oyster in the truth.

    Raises
    ------
    oysterbench.core.errors.LabelError
        Truth and estimate differ in size or number of images, or kind or overlap is none of these.
    oysterbench.core.errors.MissingExtraError
        pycocotools is not installed.

    Examples
    --------
    >>> import numpy as np, oysterbench
    >>> truth = np.zeros((40, 40), dtype=int)
    >>> truth[2:12, 2:12], truth[20:30, 20:30] = 1, 2
    >>> oysterbench.metrics.average_precision(truth, truth)
    1.0
    >>> one = np.where(truth == 2, 2, 0)
    >>> round(oysterbench.metrics.average_precision(truth, one), 3)
    0.505
    """
    if overlap not in (None, 50, 75):
        raise LabelError(f"overlap: expected 50 or 75 (%), or none for the mean over 50 to 95, got {overlap!r}")
    part = "" if overlap is None else f"{overlap:.0f}"
    return _metric(f"ap{part}_{_kind(kind)}", truth, estimate, scores)


def average_recall(
    truth: Planes, estimate: Planes, scores: Scores | None = None, kind: Literal["mask", "box"] = "mask"
) -> float:
    """Recall of all estimates, the mean over overlaps of 50, 55, ..., 95 %; parameters as for `average_precision`.

    Examples
    --------
    >>> import numpy as np, oysterbench
    >>> truth = np.zeros((40, 40), dtype=int)
    >>> truth[2:12, 2:12], truth[20:30, 20:30] = 1, 2
    >>> oysterbench.metrics.average_recall(truth, np.where(truth == 2, 2, 0))
    0.5
    """
    return _metric(f"ar_{_kind(kind)}", truth, estimate, scores)


def panoptic_quality(truth: Planes, estimate: Planes, scores: Scores | None = None) -> float:
    """Panoptic quality of the class oyster (Kirillov et al. 2019): the sum of the overlaps of all matches over the
    number of matches plus half the number of unmatched oysters; parameters as for `average_precision`. With scores,
    estimates below 0.5 are left out, as when oysters are counted; without, none is.

    Examples
    --------
    >>> import numpy as np, oysterbench
    >>> truth = np.zeros((40, 40), dtype=int)
    >>> truth[2:12, 2:12], truth[20:30, 20:30] = 1, 2
    >>> round(oysterbench.metrics.panoptic_quality(truth, np.where(truth == 2, 2, 0)), 4)
    0.6667
    """
    return _metric("pq", truth, estimate, scores)


def count_mae(truth: Counts, estimate: Counts) -> float:
    """Mean absolute error of the number of oysters in an image.

    Parameters
    ----------
    truth, estimate : (N,) numbers
        Number of oysters in each of N images.

    Raises
    ------
    oysterbench.core.errors.LabelError
        Truth and estimate differ in length, or are empty.

    Examples
    --------
    >>> import oysterbench
    >>> oysterbench.metrics.count_mae([12, 7, 0], [11, 9, 0])
    1.0
    """
    return float(np.abs(_errors(truth, estimate)).mean())


def count_rmse(truth: Counts, estimate: Counts) -> float:
    """Root mean square error of the number of oysters in an image; parameters as for `count_mae`.

    Examples
    --------
    >>> import oysterbench
    >>> oysterbench.metrics.count_rmse([12, 7], [13, 14])
    5.0
    """
    return float(np.sqrt((_errors(truth, estimate) ** 2).mean()))


def count_bias(truth: Counts, estimate: Counts) -> float:
    """Mean error of the number of oysters in an image, above 0 for overcounting; parameters as for `count_mae`.

    Examples
    --------
    >>> import oysterbench
    >>> oysterbench.metrics.count_bias([12, 7], [11, 9])
    0.5
    """
    return float(_errors(truth, estimate).mean())


def _errors(truth: Counts, estimate: Counts) -> Any:
    true, said = np.asarray(truth, dtype=float), np.asarray(estimate, dtype=float)
    if true.ndim != 1 or true.shape != said.shape or not len(true):
        raise LabelError(f"expected as many estimated counts as true ones, got shapes {true.shape} and {said.shape}")
    return said - true


def _kind(kind: str) -> str:
    if kind not in ("mask", "box"):
        raise LabelError(f"kind: expected mask or box, got {kind!r}")
    return kind


def _metric(key: str, truth: Planes, estimate: Planes, scores: Scores | None) -> float:
    true, said = _pictures(truth), _pictures(estimate)
    if len(true) != len(said) or (scores is not None and len(scores) != len(said)):
        given = f"{len(true)}, {len(said)}" + ("" if scores is None else f" and {len(scores)}")
        raise LabelError(f"expected ground truth, estimate and scores of the same images, got {given}")
    scorer = DetectionScorer(DetectionSettings())
    for number, (one, other) in enumerate(zip(true, said, strict=True)):
        sure = None if scores is None else scores[number]
        scorer.add(_instances(number, one, False, None), _instances(number, other, True, sure))
    return float(scorer.result().metrics.get(key, math.nan))


def _pictures(planes: Planes) -> list[Any]:
    if isinstance(planes, list | tuple) and planes and isinstance(planes[0], ImageInstances):
        return list(planes)
    if isinstance(planes, Iterable) and not hasattr(planes, "__array__"):
        rows = list(planes)
        if rows and np.ndim(rows[0]) == 2:
            return rows
        planes = np.asarray(rows)
    array = np.asarray(planes)
    if array.ndim not in (2, 3):
        raise LabelError(f"expected numbers of oysters (H, W) or (N, H, W), got an array of shape {array.shape}")
    return [array] if array.ndim == 2 else list(array)


def _instances(number: int, plane: Any, scored: bool, scores: Mapping[int, float] | None) -> ImageInstances:
    where = f"image {number}"
    if isinstance(plane, ImageInstances):
        return plane
    numbers = instance_numbers(np.asarray(plane), where)
    if not scored:
        return from_planes(where, numbers)
    found = [int(one) for one in np.unique(numbers) if one]
    missing = [one for one in found if scores is not None and one not in scores]
    if missing:
        raise LabelError(f"{where}: no score of oyster {missing[0]}; expected one for each number of the estimate")
    return from_planes(where, numbers, scores={one: 1.0 if scores is None else float(scores[one]) for one in found})
