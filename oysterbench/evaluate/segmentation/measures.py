"""Ratios from counts: the same for an image, a clip, a data set, and many resamples of one at once."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

import numpy as np

from oysterbench.recipe import CLASSES

NO_OYSTER = "there is no oyster in the truth"
NOTHING_CALLED = "nothing is called oyster"
NO_EMPTY_IMAGE = "there is no image without oysters"
NO_IMAGE = "there is no image with pixels to be asked about"
ABSENT = "neither truth nor estimate has it"

_RANGE = re.compile(r"range_(\w[\w.]*)_true_positive_px")
_SIZE = re.compile(r"((?:area|height)_\w[\w.]*)_truth_px")


def measure(tally: Mapping[str, Any]) -> tuple[dict[str, Any], dict[str, str]]:
    """Metrics (see `metrics`) and the reasons of those that are NaN, from counts.

    Counts may be numbers, or arrays (R,) of resamples; the metrics are alike. Of arrays, no reasons are given.
    """
    hit, extra, missed = (
        np.asarray(tally[f"{name}_px"], dtype=float) for name in ("true_positive", "false_positive", "false_negative")
    )
    union = hit + extra + missed
    values: dict[str, Any] = {
        "iou": _ratio(hit, union, 1.0),
        "dice": _ratio(2 * hit, 2 * hit + extra + missed, 1.0),
        "precision": _ratio(hit, hit + extra),
        "recall": _ratio(hit, hit + missed),
        "boundary_iou": _ratio(tally["boundary_intersection_px"], tally["boundary_union_px"], 1.0),
        "image_iou": _ratio(tally["image_iou_sum"], tally["scored_images"]),
        "image_dice": _ratio(tally["image_dice_sum"], tally["scored_images"]),
        "empty_false_positive_rate": _ratio(tally["empty_called_px"], tally["empty_px"]),
        "empty_images_called": _ratio(tally["empty_images_called"], tally["empty_images"]),
        "cover": _ratio(hit + missed, union + tally["true_negative_px"]),
        "cover_error": _ratio(extra - missed, union + tally["true_negative_px"]),
    }
    reasons = {
        "precision": NOTHING_CALLED,
        "recall": NO_OYSTER,
        "empty_false_positive_rate": NO_EMPTY_IMAGE,
        "empty_images_called": NO_EMPTY_IMAGE,
        **dict.fromkeys(("image_iou", "image_dice", "cover", "cover_error"), NO_IMAGE),
    }
    values |= _classes(tally)
    for key in tally:
        if (match := _RANGE.fullmatch(key)) is not None:
            parts = [np.asarray(tally[f"range_{match[1]}_{part}_px"], float) for part in _PARTS]
            values[f"iou_range_{match[1]}"] = _ratio(parts[0], sum(parts))
        elif (match := _SIZE.fullmatch(key)) is not None:
            values[f"recall_{match[1]}"] = _ratio(tally[f"{match[1]}_found_px"], tally[key])
    return values, {
        key: reasons.get(key, ABSENT) for key, value in values.items() if np.ndim(value) == 0 and np.isnan(value)
    }


_PARTS = ("true_positive", "false_positive", "false_negative")


def _classes(tally: Mapping[str, Any]) -> dict[str, Any]:
    """IoU of each class that truth or estimate has, and their mean, where classes were counted."""
    names = [name for name in CLASSES.values() if f"class_{name}_union_px" in tally]
    if not names:
        return {}
    each = {n: _ratio(tally[f"class_{n}_intersection_px"], tally[f"class_{n}_union_px"]) for n in names}
    stacked = np.stack([np.asarray(value, float) for value in each.values()])
    mean = _ratio(np.nansum(stacked, axis=0), np.sum(~np.isnan(stacked), axis=0))
    return {"miou": mean, **{f"iou_{name}": value for name, value in each.items()}}


def _ratio(numerator: Any, denominator: Any, empty: float = np.nan) -> Any:
    """numerator / denominator, and `empty` where that is 0 / 0."""
    above, below = np.asarray(numerator, dtype=float), np.asarray(denominator, dtype=float)
    value = np.where(below > 0, above / np.where(below > 0, below, 1.0), empty)
    return float(value) if value.ndim == 0 else value
