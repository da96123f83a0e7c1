"""Number of oysters: counts of images and clips against those of the truth."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from oysterbench.core.geometry import Array
from oysterbench.evaluate.detection.instances import ImageInstances, Instance, mask_tools, numpy_2

LEVELS = (1, 2, 3)
"""Levels of GAME: at level L an image has 4^L cells."""

NO_FOOTPRINT = "it is not known how much of the seabed the images show"


@dataclass(frozen=True)
class ImageCount:
    """Count of one image: true and estimated number of oysters, and the area of seabed in m^2, NaN if unknown.

    cells: sum over cells of the absolute errors in number, for each of `LEVELS`
    """

    name: str
    truth: int
    estimate: int
    footprint_m2: float
    cells: tuple[int, ...]

    @property
    def error(self) -> int:
        """Estimated minus true number: above 0 for too many."""
        return self.estimate - self.truth


def count(truth: ImageInstances, estimate: ImageInstances, threshold: float) -> ImageCount:
    """Count the oysters of an image: estimates with a score of at least `threshold`, except for those that lie on crowd
    regions by more than half of their area."""
    crowds = [one for one in truth.instances if one.crowd]
    true = [one for one in truth.instances if not one.crowd]
    detections = [one for one in estimate.instances if one.score >= threshold]
    if crowds and detections:
        tools = mask_tools()
        boxes = any(one.mask is None for one in (*detections, *crowds))
        with numpy_2():
            parts = np.array([one.box for one in detections]) if boxes else [one.mask for one in detections]
            of_crowds = [box for one in crowds for box in one.boxes]
            regions = np.array(of_crowds) if boxes else [tools.merge([one.mask for one in crowds])]
            share = tools.iou(parts, regions, [True] * len(regions)).max(axis=1)
        detections = [one for one, on_crowd in zip(detections, share, strict=True) if on_crowd <= 0.5]
    footprint = math.nan if truth.footprint_m2 is None else truth.footprint_m2
    cells = tuple(
        int(np.abs(_in_cells(detections, truth, level) - _in_cells(true, truth, level)).sum()) for level in LEVELS
    )
    return ImageCount(truth.name, len(true), len(detections), footprint, cells)


def _in_cells(instances: Sequence[Instance], image: ImageInstances, level: int) -> Array:
    """Number of instances (4^level,) in each cell of the image, by the centre of their box."""
    side = 2**level
    boxes = np.array([one.box for one in instances], dtype=float).reshape(-1, 4)
    centres = (boxes[:, :2] + boxes[:, 2:] / 2) / (image.width, image.height)
    columns, rows = np.clip(np.floor(centres * side).astype(int), 0, side - 1).T
    return np.bincount(rows * side + columns, minlength=side**2).astype(float)


def count_metrics(counts: Sequence[ImageCount], times: Array | None = None) -> tuple[dict[str, float], dict[str, str]]:
    """Compute the metrics of N images, and the reasons for those that are NaN. times: (N,) how often each counts in
    means; None: once."""

    def mean(values: Array, often: Array | None = times) -> float:
        return float(values.mean() if often is None else np.average(values, weights=often))

    errors = np.array([each.error for each in counts], dtype=float)
    areas = np.array([each.footprint_m2 for each in counts])
    metrics = {
        "count_mae": mean(np.abs(errors)),
        "count_rmse": float(np.sqrt(mean(errors**2))),
        "count_bias": mean(errors),
        "count_truth": float(sum(each.truth for each in counts)),
        "count_estimate": float(sum(each.estimate for each in counts)),
    }
    for level, values in zip(LEVELS, np.array([each.cells for each in counts], dtype=float).T, strict=True):
        metrics[f"game_{level}"] = mean(values)
    metrics["count_error"] = metrics["count_estimate"] - metrics["count_truth"]
    known = ~np.isnan(areas) & (areas > 0)
    if not known.any():
        missing = ("density_error_per_m2", "density_mae_per_m2")
        return metrics | dict.fromkeys(missing, math.nan), dict.fromkeys(missing, NO_FOOTPRINT)
    errors, areas, often = errors[known], areas[known], None if times is None else times[known]
    truth = np.array([each.truth for each, k in zip(counts, known, strict=True) if k], dtype=float)
    total = areas.sum() if often is None else areas @ often
    metrics["density_error_per_m2"] = float((errors.sum() if often is None else errors @ often) / total)
    metrics["density_mae_per_m2"] = mean(np.abs(errors / areas), often)
    metrics["density_truth_per_m2"] = float((truth.sum() if often is None else truth @ often) / total)
    return metrics, {}
