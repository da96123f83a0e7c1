"""Ratios from counts: of an image, a clip, a data set, or many resamples of a data set at once."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

import numpy as np

from oysterbench.evaluate.segmentation.metrics import SEGMENTATION
from oysterbench.recipe import CLASSES

NO_OYSTER = "the ground truth has no oyster"
NOTHING_CALLED = "nothing is predicted as oyster"
NO_EMPTY_IMAGE = "there is no image without oysters"
NO_IMAGE = "there is no image with pixels to score"
ABSENT = "neither ground truth nor estimate has it"
_REASONS = {
    "precision": NOTHING_CALLED,
    "recall": NO_OYSTER,
    **dict.fromkeys(("empty_false_positive_rate", "empty_images_called"), NO_EMPTY_IMAGE),
    **dict.fromkeys(("image_iou", "image_dice", "cover", "cover_error"), NO_IMAGE),
}
ONE_IF_EMPTY = ("iou", "dice", "boundary_iou")
"""Metrics that are 1 where neither truth nor estimate has an oyster."""

_PARTS = ("true_positive", "false_positive", "false_negative")

_RANGE = re.compile(r"range_(\w[\w.]*)_true_positive_px")
_SIZE = re.compile(r"((?:area|height)_\w[\w.]*)_truth_px")


def measure(tally: Mapping[str, Any]) -> tuple[dict[str, Any], dict[str, str]]:
    """Compute metrics (see `metrics`), and the reasons for those that are NaN, from counts.

    Counts may be numbers, or arrays (R,) of resamples, and metrics are of the same form. For arrays, no reasons are
    given.
    """
    values = {key: _ratio(*parts, 1.0 if key in ONE_IF_EMPTY else np.nan) for key, parts in _of_all(tally).items()}
    values |= _classes(tally)
    values |= {key: _ratio(*parts) for key, parts in _of_strata(tally).items()}
    return values, {
        key: _REASONS.get(key, ABSENT) for key, value in values.items() if np.ndim(value) == 0 and np.isnan(value)
    }


def weights(tally: Mapping[str, float]) -> dict[str, float]:
    """Denominators of the metrics, by which clips are weighted in a mean (`Metric.weight`)."""
    found = {key: tally[key] for key in ("images", "scored_images", "empty_images", "empty_px", "ignored_px")}
    parts = _of_all(tally)
    for key in ("iou", "recall", "precision", "dice", "cover", "boundary_iou"):
        found[SEGMENTATION[key].weight] = parts[key][1]
    of_parts = {**_of_classes(tally), **_of_strata(tally)}
    return found | {f"weight_{key}_px": below for key, (_, below) in of_parts.items()}


def _of_all(tally: Mapping[str, Any]) -> dict[str, tuple[Any, Any]]:
    """Numerator and denominator of each metric over all pixels or images."""
    hit, extra, missed = (tally[f"{part}_px"] for part in _PARTS)
    union = hit + extra + missed
    scored = union + tally["true_negative_px"]
    return {
        "iou": (hit, union),
        "dice": (2 * hit, 2 * hit + extra + missed),
        "precision": (hit, hit + extra),
        "recall": (hit, hit + missed),
        "boundary_iou": (tally["boundary_intersection_px"], tally["boundary_union_px"]),
        "image_iou": (tally["image_iou_sum"], tally["scored_images"]),
        "image_dice": (tally["image_dice_sum"], tally["scored_images"]),
        "empty_false_positive_rate": (tally["empty_called_px"], tally["empty_px"]),
        "empty_images_called": (tally["empty_images_called"], tally["empty_images"]),
        "cover": (hit + missed, scored),
        "cover_error": (extra - missed, scored),
    }


def _of_strata(tally: Mapping[str, Any]) -> dict[str, tuple[Any, Any]]:
    """Numerator and denominator of each metric over one class of range, area or height."""
    found = {}
    for key in tally:
        if match := _RANGE.fullmatch(key):
            hit, *others = (tally[f"range_{match[1]}_{part}_px"] for part in _PARTS)
            found[f"iou_range_{match[1]}"] = (hit, hit + sum(others))
        elif match := _SIZE.fullmatch(key):
            found[f"recall_{match[1]}"] = (tally[f"{match[1]}_found_px"], tally[key])
    return found


def _of_classes(tally: Mapping[str, Any]) -> dict[str, tuple[Any, Any]]:
    """Numerator and denominator of the IoU of each class; empty if classes were not counted."""
    names = [name for name in CLASSES.values() if f"class_{name}_union_px" in tally]
    return {f"iou_{n}": (tally[f"class_{n}_intersection_px"], tally[f"class_{n}_union_px"]) for n in names}


def _classes(tally: Mapping[str, Any]) -> dict[str, Any]:
    """IoU of each class, and the mean over those in truth or estimate; empty if classes were not counted."""
    each = {key: _ratio(*parts) for key, parts in _of_classes(tally).items()}
    if not each:
        return {}

    stacked = np.stack([np.asarray(value, float) for value in each.values()])
    mean = _ratio(np.nansum(stacked, axis=0), np.sum(~np.isnan(stacked), axis=0))
    return {"miou": mean, **each}


def _ratio(numerator: Any, denominator: Any, empty: float = np.nan) -> Any:
    """numerator / denominator, or `empty` where the denominator is 0."""
    above, below = np.asarray(numerator, dtype=float), np.asarray(denominator, dtype=float)
    value = np.where(below > 0, above / np.where(below > 0, below, 1.0), empty)
    return float(value) if value.ndim == 0 else value
