"""What is measured of masks: name, unit, direction and definition of every metric."""

from __future__ import annotations

import re

from oysterbench.evaluate.metric import Column, Metric, TrackMetrics, higher, lower, neutral
from oysterbench.recipe import CLASSES

SEGMENTATION: dict[str, Metric] = {
    "iou": higher("IoU", column=Column("IoU"), weight="union_px")(
        "Intersection over union (0 to 1) of the class oyster over the whole data set: all pixels that are oyster in "
        "truth and estimate, by all that are in either; the background has no part in it. 1 where neither has any."
    ),
    "image_iou": higher("IoU by image", column=Column("IoU", "by image"), weight="scored_images")(
        "Mean over images of their IoU of the class oyster, each image one vote: 1 where neither truth nor estimate "
        "has an oyster, 0 where the ground truth has none and the estimate has."
    ),
    "boundary_iou": higher("Boundary IoU", column=Column("IoU", "boundary"), weight="boundary_union_px")(
        "Boundary IoU (Cheng et al. 2021) over the data set: intersection over union of the masks' inner borders, deep "
        "by 2 % of the image's diagonal."
    ),
    "precision": higher("Precision", column=Column("prec"), weight="estimate_px")(
        "Share (0 to 1) of the pixels called oyster that are."
    ),
    "recall": higher("Recall", column=Column("recall"), weight="truth_px")(
        "Share (0 to 1) of the oysters' pixels that are called so."
    ),
    "dice": higher("Dice", column=Column("Dice"), weight="dice_px")(
        "Twice the intersection by the sum of both areas, over the data set (F1 of the pixels)."
    ),
    "image_dice": higher("Dice by image", weight="scored_images")("Mean over images of their Dice."),
    "miou": higher("mIoU")(
        "Mean over all classes that truth or estimate has of their IoU; only where the estimate names classes."
    ),
    "empty_false_positive_rate": lower(
        "False on empty", column=Column("empty", "% false", 2, factor=100.0, small=0.1), weight="empty_px"
    )("Share (0 to 1) of the pixels of images without any oyster that are called oyster."),
    "empty_images_called": lower("Empty images called", weight="empty_images")(
        "Share (0 to 1) of the images without any oyster in which some pixel is called oyster."
    ),
    "cover": neutral("Cover", weight="asked_px")("Share (0 to 1) of the pixels that are oyster in truth."),
    "cover_error": neutral("Cover error", weight="asked_px")(
        "Share of the pixels called oyster less the share that is: above 0 where too much is called oyster."
    ),
    "best_iou": higher("Best IoU")(
        "Greatest IoU over thresholds in steps of 1/256, chosen with the ground truth in sight: what the best "
        "would give, not what is reached."
    ),
    "best_threshold": neutral("Best threshold")("The threshold of best_iou."),
    "images": neutral("Images")("Number of images."),
    "scored_images": neutral("Scored images")("Number of images of which not all is ignored."),
    "empty_images": neutral("Empty images")("Number of images without any oyster."),
    "union_px": neutral("Union", "px")("Pixels that are oyster in truth or estimate."),
    "truth_px": neutral("Truth", "px")("Pixels that are oyster in truth."),
    "estimate_px": neutral("Estimate", "px")("Pixels that are called oyster."),
    "dice_px": neutral("Both", "px")("Pixels of truth and of estimate, added."),
    "boundary_union_px": neutral("Border", "px")("Pixels of the border of truth or estimate."),
    "asked_px": neutral("Asked", "px")("Pixels that are not ignored."),
    "ignored_px": neutral("Ignored", "px")("Pixels that are ignored."),
    "empty_px": neutral("Empty", "px")("Pixels of images without any oyster."),
}
"""Metrics of the segmentation track by their key."""

TABLE = ("iou", "image_iou", "boundary_iou", "precision", "recall", "dice", "empty_false_positive_rate")
TRACK = TrackMetrics("Segmentation", SEGMENTATION, TABLE, TABLE[1:], beside="boundary_iou", failed={"iou": 0.0})

_STRATA = {
    r"iou_range_([\w.]+)": ("IoU of the class oyster where what is seen is {} away along the optical axis.", "m"),
    r"recall_height_([\w.]+)": ("Recall of the pixels of oysters whose shell is {} high.", "mm"),
    r"recall_area_([\w.]+)": ("Recall of the pixels of oysters of which {} are visible.", "px"),
}


def find_segmentation(key: str) -> Metric | None:
    """Metrics of single classes, and of classes of range and size."""
    for pattern, (definition, unit) in _STRATA.items():
        if match := re.fullmatch(pattern, key):
            name = class_text(match[1], unit)
            heading = ("IoU, " if key.startswith("iou") else "Recall, ") + name
            return Metric(definition.format(name), heading, better="higher", weight=f"weight_{key}_px")
    if (match := re.fullmatch(r"iou_(\w+)", key)) and match[1] in CLASSES.values():
        return Metric(f"IoU of the class {match[1]} over the data set.", f"IoU, {match[1]}", better="higher")
    if match := re.fullmatch(r"weight_(.+)_px", key):
        return Metric(f"Pixels that {match[1]} is taken over.", f"Pixels of {match[1]}", unit="px")
    return None


def class_text(name: str, unit: str) -> str:
    """The name of a class as a text: `0.6to0.9m` is "0.6 to 0.9 m"."""
    plain = name.removesuffix(unit)
    if plain.startswith("below_"):
        return f"below {plain[6:]} {unit}"
    if plain.startswith("from_"):
        return f"{plain[5:]} {unit} and more"
    return f"{plain.replace('to', ' to ')} {unit}"
