"""Counts of one image. Counts are additive: those of a clip or a data set are the sums over its images."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import chain
from typing import Any

import numpy as np
from numpy.typing import NDArray

from oysterbench.evaluate.segmentation.boundary import boundary_depth, inner_boundary
from oysterbench.evaluate.segmentation.images import EstimateImage, TruthImage
from oysterbench.evaluate.segmentation.settings import SegmentationSettings, class_names
from oysterbench.recipe import CLASSES

Tally = dict[str, float]
"""Name of a count -> number. Names of pixel counts end in `_px`, those of sums over images in `_sum`."""

_PARTS = ("true_negative", "false_positive", "false_negative", "true_positive")
"""Indexed by 2 * truth + estimate."""


def tally_image(
    truth: TruthImage, estimate: EstimateImage, oyster: NDArray[np.bool_], settings: SegmentationSettings
) -> Tally:
    """Compute all counts of one image; oyster (H, W): the estimated mask."""
    true = truth.oyster
    scored = None if truth.ignore is None else ~truth.ignore
    codes = true.view(np.uint8) * np.uint8(2) + oyster.view(np.uint8)
    counts = _histogram(codes, scored, 4)
    tally: Tally = {f"{name}_px": count for name, count in zip(_PARTS, counts, strict=True)}
    tally["ignored_px"] = 0 if truth.ignore is None else int(truth.ignore.sum())
    tally["images"] = 1
    tally |= _by_image(tally)
    tally |= _tally_boundary(true, oyster, scored, settings.boundary_share)
    if estimate.classes is not None and truth.named:
        tally |= _tally_classes(truth.classes, estimate.classes, scored)
    if truth.depth_m is not None:
        tally |= _tally_range(codes, truth.depth_m, scored, settings.range_m)
    if truth.instances is not None:
        tally |= _tally_size(truth, oyster, scored, settings)
    return tally


def _histogram(values: NDArray[Any], scored: NDArray[np.bool_] | None, n: int) -> list[int]:
    return list(np.bincount(values.ravel() if scored is None else values[scored], minlength=n).tolist())


def _by_image(tally: Mapping[str, float]) -> Tally:
    """Contribution of one image to means over images, and to the metrics of images without oysters."""
    hit, extra, missed = (tally[f"{name}_px"] for name in ("true_positive", "false_positive", "false_negative"))
    scored = hit + extra + missed + tally["true_negative_px"]
    empty = scored > 0 and hit + missed == 0
    union = hit + extra + missed
    return {
        "scored_images": int(scored > 0),
        "image_iou_sum": 0.0 if not scored else hit / union if union else 1.0,
        "image_dice_sum": 0.0 if not scored else 2 * hit / (union + hit) if union else 1.0,
        "empty_images": int(empty),
        "empty_images_called": int(empty and extra > 0),
        "empty_px": scored if empty else 0,
        "empty_called_px": extra if empty else 0,
    }


def _tally_boundary(
    true: NDArray[np.bool_], oyster: NDArray[np.bool_], scored: NDArray[np.bool_] | None, share: float
) -> Tally:
    depth = boundary_depth(true.shape, share)
    a, b = inner_boundary(true, depth), inner_boundary(oyster, depth)
    both, either = a & b, a | b
    if scored is not None:
        both, either = both & scored, either & scored
    return {
        "boundary_intersection_px": int(np.count_nonzero(both)),
        "boundary_union_px": int(np.count_nonzero(either)),
    }


def _tally_classes(true: NDArray[np.uint8], classes: NDArray[np.uint8], scored: NDArray[np.bool_] | None) -> Tally:
    n = max(CLASSES) + 1
    confusion = np.array(_histogram(true * np.uint8(n) + classes, scored, n * n)).reshape(n, n)
    tally: Tally = {}
    for number, name in CLASSES.items():
        both = int(confusion[number, number])
        tally[f"class_{name}_intersection_px"] = both
        tally[f"class_{name}_union_px"] = int(confusion[number].sum() + confusion[:, number].sum()) - both
    return tally


def _tally_range(
    codes: NDArray[np.uint8], depth_m: NDArray[np.float32], scored: NDArray[np.bool_] | None, edges: tuple[float, ...]
) -> Tally:
    names = class_names(edges, "m")
    far = np.zeros(codes.shape, np.uint8)
    for edge in edges:
        far += depth_m >= edge
    known = depth_m > 0 if scored is None else (depth_m > 0) & scored
    counts = np.array(_histogram(far * np.uint8(4) + codes, known, 4 * len(names))).reshape(-1, 4)
    return {
        f"range_{name}_{part}_px": int(count)
        for name, row in zip(names, counts, strict=True)
        for part, count in zip(_PARTS[1:], row[1:], strict=True)
    }


def _tally_size(
    truth: TruthImage, oyster: NDArray[np.bool_], scored: NDArray[np.bool_] | None, settings: SegmentationSettings
) -> Tally:
    """Count true pixels by the size of their oyster, and how many of them are found. False positives have no size."""
    assert truth.instances is not None
    where = truth.oyster if scored is None else truth.oyster & scored
    numbers = truth.instances[where]
    n = int(numbers.max(initial=0)) + 1
    total = np.bincount(numbers, minlength=n)
    found = np.bincount(numbers[oyster[where]], minlength=n)
    total[0] = found[0] = 0
    tally: Tally = {}
    sizes = [("area", settings.area_px, "px", total.astype(float))]
    if truth.heights_mm is not None:
        heights = np.full(n, np.nan)
        m = min(n, len(truth.heights_mm))
        heights[:m] = truth.heights_mm[:m]
        sizes.append(("height", settings.height_mm, "mm", heights))
    for key, edges, unit, size in sizes:
        known = (total > 0) & ~np.isnan(size)
        of_class = np.searchsorted(edges, size[known], side="right")
        names = class_names(edges, unit)
        for part, pixels in (("truth", total), ("found", found)):
            sums = np.bincount(of_class, weights=pixels[known], minlength=len(names))
            tally |= {f"{key}_{name}_{part}_px": int(value) for name, value in zip(names, sums, strict=True)}
    return tally


def add(tallies: list[Tally]) -> Tally:
    """Sum tallies; a count missing in one is 0 there."""
    return {key: sum(tally.get(key, 0) for tally in tallies) for key in dict.fromkeys(chain(*tallies))}
