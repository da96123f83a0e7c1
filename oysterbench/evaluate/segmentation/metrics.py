"""What is measured of masks: name, unit, direction and definition of every metric."""

from __future__ import annotations

import re

from oysterbench.evaluate.metric import Column, Metric, TrackMetrics
from oysterbench.recipe import CLASSES

SEGMENTATION: dict[str, Metric] = {
    "iou": Metric(
        "Intersection over union (0 to 1) of the class oyster over the whole data set: all pixels that are oyster in "
        "truth and estimate, by all that are in either; the background has no part in it. 1 where neither has any.",
        "IoU",
        better="higher",
        weight="union_px",
        column=Column("IoU", "", small=0.0),
    ),
    "image_iou": Metric(
        "Mean over images of their IoU of the class oyster, each image one vote: 1 where neither truth nor estimate "
        "has an oyster, 0 where the truth has none and the estimate has.",
        "IoU by image",
        better="higher",
        weight="scored_images",
        column=Column("IoU", "by image", small=0.0),
    ),
    "boundary_iou": Metric(
        "Boundary IoU (Cheng et al. 2021) over the data set: intersection over union of the masks' inner borders, deep "
        "by 2 % of the image's diagonal.",
        "Boundary IoU",
        better="higher",
        weight="boundary_union_px",
        column=Column("IoU", "boundary", small=0.0),
    ),
    "precision": Metric(
        "Share (0 to 1) of the pixels called oyster that are.",
        "Precision",
        better="higher",
        weight="estimate_px",
        column=Column("prec", "", small=0.0),
    ),
    "recall": Metric(
        "Share (0 to 1) of the oysters' pixels that are called so.",
        "Recall",
        better="higher",
        weight="truth_px",
        column=Column("recall", "", small=0.0),
    ),
    "dice": Metric(
        "Twice the intersection by the sum of both areas, over the data set (F1 of the pixels).",
        "Dice",
        better="higher",
        weight="dice_px",
        column=Column("Dice", "", small=0.0),
    ),
    "image_dice": Metric("Mean over images of their Dice.", "Dice by image", better="higher", weight="scored_images"),
    "miou": Metric(
        "Mean over all classes that truth or estimate has of their IoU; only where the estimate names classes.",
        "mIoU",
        better="higher",
    ),
    "empty_false_positive_rate": Metric(
        "Share (0 to 1) of the pixels of images without any oyster that are called oyster.",
        "False on empty",
        better="lower",
        weight="empty_px",
        column=Column("empty", "% false", digits=2, factor=100.0),
    ),
    "empty_images_called": Metric(
        "Share (0 to 1) of the images without any oyster in which some pixel is called oyster.",
        "Empty images called",
        better="lower",
        weight="empty_images",
    ),
    "cover": Metric("Share (0 to 1) of the pixels that are oyster in truth.", "Cover", weight="asked_px"),
    "cover_error": Metric(
        "Share of the pixels called oyster less the share that is: above 0 where too much is called oyster.",
        "Cover error",
        weight="asked_px",
    ),
    "best_iou": Metric(
        "Greatest IoU over thresholds in steps of 1/256, chosen with the truth in sight: what the best threshold would "
        "give, not what is reached.",
        "Best IoU",
        better="higher",
    ),
    "best_threshold": Metric("The threshold of best_iou.", "Best threshold"),
    "images": Metric("Number of images.", "Images"),
    "scored_images": Metric("Number of images of which not all is ignored.", "Scored images"),
    "empty_images": Metric("Number of images without any oyster.", "Empty images"),
    "union_px": Metric("Pixels that are oyster in truth or estimate.", "Union", unit="px"),
    "truth_px": Metric("Pixels that are oyster in truth.", "Truth", unit="px"),
    "estimate_px": Metric("Pixels that are called oyster.", "Estimate", unit="px"),
    "dice_px": Metric("Pixels of truth and of estimate, added.", "Both", unit="px"),
    "boundary_union_px": Metric("Pixels of the border of truth or estimate.", "Border", unit="px"),
    "asked_px": Metric("Pixels that are not ignored.", "Asked", unit="px"),
    "ignored_px": Metric("Pixels that are ignored.", "Ignored", unit="px"),
    "empty_px": Metric("Pixels of images without any oyster.", "Empty", unit="px"),
}
"""Metrics of the segmentation track by their key."""

TABLE = ("iou", "image_iou", "boundary_iou", "precision", "recall", "dice", "empty_false_positive_rate")
TRACK = TrackMetrics(SEGMENTATION, TABLE, TABLE[1:], beside="boundary_iou", failed={"iou": 0.0})

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
