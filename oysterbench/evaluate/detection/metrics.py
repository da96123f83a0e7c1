"""What is measured of single oysters: name, unit, direction and definition of every metric."""

from __future__ import annotations

from oysterbench.evaluate.detection.counting import LEVELS
from oysterbench.evaluate.metric import Column, Metric, TrackMetrics

_AP = "average precision of {}: the mean over 101 recalls and the overlaps (IoU) 0.50, 0.55, ... 0.95 (COCO)"


def _of(kind: str, what: str) -> dict[str, Metric]:
    ap = _AP.format(what)
    found = {
        f"ap_{kind}": Metric(
            f"{ap[0].upper()}{ap[1:]}.", f"AP {kind}", better="higher", column=Column("AP", kind, small=0.0)
        )
    }
    for percent in (50, 75):
        found[f"ap{percent}_{kind}"] = Metric(
            f"As ap_{kind}, at the overlap 0.{percent} alone.",
            f"AP{percent} {kind}",
            better="higher",
            column=Column(f"AP{percent}", kind, small=0.0),
        )
    for size, area in (("small", "below 32^2"), ("medium", "of 32^2 to 96^2"), ("large", "above 96^2")):
        found[f"ap_{size}_{kind}"] = Metric(
            f"As ap_{kind}, of oysters {area} px.", f"AP {size} {kind}", better="higher"
        )
    found[f"ar_{kind}"] = Metric(
        f"Average recall of {what}: the share of oysters found by the surest max_detections of each image, mean over "
        "the overlaps.",
        f"AR {kind}",
        better="higher",
        column=Column("AR", kind, small=0.0),
    )
    return found


DETECTION: dict[str, Metric] = {
    **_of("mask", "masks"),
    **_of("box", "boxes"),
    "pq": Metric(
        "Panoptic quality (Kirillov et al. 2019) of the class oyster: segmentation times recognition quality.",
        "PQ",
        better="higher",
        column=Column("PQ", "", small=0.0),
    ),
    "sq": Metric("Segmentation quality: mean overlap of the matches, those above 0.5.", "SQ", better="higher"),
    "rq": Metric(
        "Recognition quality: matches by the mean number of truths and estimates (F1).", "RQ", better="higher"
    ),
    "count_mae": Metric(
        "Mean over images of the absolute error of the number of oysters.",
        "Count MAE",
        better="lower",
        column=Column("count", "MAE", digits=1, small=0.0),
    ),
    "count_rmse": Metric("Root mean square over images of that error.", "Count RMSE", better="lower"),
    "count_bias": Metric(
        "Mean over images of that error: above 0 where too many are counted.",
        "Count bias",
        column=Column("count", "bias", digits=1, small=0.0),
    ),
    **{
        f"game_{level}": Metric(
            f"Grid average mean error (Guerrero-Gomez-Olmedo et al. 2015): as count_mae, the errors of {4**level} "
            "cells of the image added, so that oysters too many here do not make up for those missed there.",
            f"GAME({level})",
            better="lower",
        )
        for level in LEVELS
    },
    "count_error": Metric("Estimated less true number of oysters over all images of the clip.", "Clip count"),
    "count_truth": Metric("True number of oysters over all images of the clip.", "True count"),
    "count_estimate": Metric("Estimated number of oysters over all images of the clip.", "Estimated count"),
    "density_error_per_m2": Metric(
        "Error of the number of oysters over all images by the seabed, seen from above, that they show.",
        "Density error",
        unit="per m\N{SUPERSCRIPT TWO}",
        column=Column("density", "err/m²", digits=1, small=0.0),
    ),
    "density_mae_per_m2": Metric(
        "Mean over images of the absolute error of oysters on a square metre of seabed.",
        "Density MAE",
        unit="per m\N{SUPERSCRIPT TWO}",
        better="lower",
    ),
    "density_truth_per_m2": Metric(
        "True number of oysters by the seabed that the images show.", "Density", unit="per m\N{SUPERSCRIPT TWO}"
    ),
}
"""Metrics of the detection track by their key."""

TABLE = (
    "ap_mask",
    "ap50_mask",
    "ap_box",
    "ar_mask",
    "pq",
    "count_mae",
    "count_bias",
    "density_error_per_m2",
)
TRACK = TrackMetrics(DETECTION, TABLE, TABLE[1:], beside="count_mae", failed={"ap_mask": 0.0})
