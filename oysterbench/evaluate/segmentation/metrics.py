"""Metrics of masks: name, unit, direction and definition of each."""

from __future__ import annotations

import re

from oysterbench.evaluate.metric import IMAGES_PER_S, Column, Metric, TrackMetrics, counted, higher, lower, neutral
from oysterbench.recipe import CLASSES

SEGMENTATION: dict[str, Metric] = {
    "iou": higher("IoU", column=Column("IoU"), weight="union_px")(
        "Intersection over union (0 to 1) of the class oyster over the whole data set: pixels that are oyster in both "
        "ground truth and estimate, over pixels that are oyster in either; background does not count. 1 if neither has "
        "any."
    ),
    "image_iou": higher("IoU by image", column=Column("IoU", "by image"), weight="scored_images")(
        "Mean over images of the IoU of the class oyster, one vote per image: 1 if neither ground truth nor estimate "
        "has an oyster, 0 if only the estimate has one."
    ),
    "boundary_iou": higher("Boundary IoU", column=Column("IoU", "boundary"), weight="boundary_union_px")(
        "Boundary IoU (Cheng et al. 2021) over the data set: intersection over union of the masks' inner borders, 2 % "
        "of the image's diagonal wide."
    ),
    "precision": higher("Precision", column=Column("prec"), weight="estimate_px")(
        "Share (0 to 1) of the pixels predicted as oyster that are oyster."
    ),
    "recall": higher("Recall", column=Column("recall"), weight="truth_px")(
        "Share (0 to 1) of the oyster pixels that are predicted as oyster."
    ),
    "dice": higher("Dice", column=Column("Dice"), weight="dice_px")(
        "Twice the intersection over the sum of both areas, over the data set (F1 of the pixels)."
    ),
    "image_dice": higher("Dice by image", weight="scored_images")("Mean over images of the Dice coefficient."),
    "miou": higher("mIoU")(
        "Mean IoU over all classes in ground truth or estimate; only if the estimate has classes. Over sequences, a "
        "plain mean."
    ),
    "empty_false_positive_rate": lower(
        "False on empty", column=Column("empty", "% false", 2, factor=100.0, small=0.1), weight="empty_px"
    )("Share (0 to 1) of the pixels of images without any oyster that are predicted as oyster."),
    "empty_images_called": lower("Empty images called", weight="empty_images")(
        "Share (0 to 1) of the images without any oyster in which some pixel is predicted as oyster."
    ),
    "cover": neutral("Cover", weight="asked_px")("Share (0 to 1) of the pixels that are oyster in the ground truth."),
    "cover_error": neutral("Cover error", weight="asked_px")(
        "Predicted minus true share of oyster pixels: above 0 for overestimation."
    ),
    "best_iou": higher("Best IoU")(
        "Greatest IoU over thresholds in steps of 1/256, chosen with the ground truth: an upper bound, not a result."
    ),
    "best_threshold": neutral("Best threshold")("The threshold of best_iou."),
    "images": counted("Images")("Number of images."),
    "scored_images": counted("Scored images")("Number of images that are not entirely ignored."),
    "empty_images": counted("Empty images")("Number of images without any oyster."),
    "union_px": counted("Union", "px")("Pixels that are oyster in ground truth or estimate."),
    "truth_px": counted("Truth", "px")("Pixels that are oyster in the ground truth."),
    "estimate_px": counted("Estimate", "px")("Pixels predicted as oyster."),
    "dice_px": counted("Both", "px")("Oyster pixels of ground truth plus those of the estimate."),
    "boundary_union_px": counted("Border", "px")("Pixels in the border of ground truth or estimate."),
    "asked_px": counted("Asked", "px")("Pixels that are not ignored."),
    "ignored_px": counted("Ignored", "px")("Pixels that are ignored."),
    "empty_px": counted("Empty", "px")("Pixels of images without any oyster."),
    "images_per_s": IMAGES_PER_S,
}
"""Metrics of the segmentation track by their key."""

TABLE = ("iou", "image_iou", "boundary_iou", "precision", "recall", "dice", "empty_false_positive_rate")
TRACK = TrackMetrics("Segmentation", SEGMENTATION, TABLE, TABLE[1:], beside="boundary_iou", failed={"iou": 0.0})

_STRATA = {
    r"iou_range_([\w.]+)": ("IoU of the class oyster where the surface is {} away along the optical axis.", "m"),
    r"recall_height_([\w.]+)": ("Pixel recall of oysters whose shell is {} high.", "mm"),
    r"recall_area_([\w.]+)": ("Pixel recall of oysters of which {} are visible.", "px"),
}


def find_segmentation(key: str) -> Metric | None:
    """Return a metric of a single class, or of a class of range or size; None for an unknown key."""
    for pattern, (definition, unit) in _STRATA.items():
        if match := re.fullmatch(pattern, key):
            name = class_text(match[1], unit)
            heading = ("IoU, " if key.startswith("iou") else "Recall, ") + name
            return Metric(definition.format(name), heading, better="higher", weight=f"weight_{key}_px")
    if (match := re.fullmatch(r"iou_(\w+)", key)) and match[1] in CLASSES.values():
        text = f"IoU of the class {match[1]} over the data set."
        return Metric(text, f"IoU, {match[1]}", better="higher", weight=f"weight_{key}_px")
    if match := re.fullmatch(r"weight_(.+)_px", key):
        return counted(f"Pixels of {match[1]}", "px")(f"Pixels over which {match[1]} is computed.")
    return None


def class_text(name: str, unit: str) -> str:
    """Format the name of a class of range or size as text: `0.6to0.9m` becomes "0.6 to 0.9 m"."""
    plain = name.removesuffix(unit)
    if plain.startswith("below_"):
        return f"below {plain[6:]} {unit}"
    if plain.startswith("from_"):
        return f"{plain[5:]} {unit} and more"
    return f"{plain.replace('to', ' to ')} {unit}"
