"""Metrics of single oysters: name, unit, direction and definition of each."""

from __future__ import annotations

from oysterbench.evaluate.detection.counting import LEVELS
from oysterbench.evaluate.metric import IMAGES_PER_S, Column, Metric, TrackMetrics, counted, higher, lower, neutral

_AP = "average precision of {}: the mean over 101 recalls and the overlaps (IoU) 0.50, 0.55, ... 0.95 (COCO)"


def _of(kind: str, what: str) -> dict[str, Metric]:
    ap = _AP.format(what)
    found = {f"ap_{kind}": higher(f"AP {kind}", column=Column("AP", kind))(f"{ap[0].upper()}{ap[1:]}.")}
    for percent in (50, 75):
        found[f"ap{percent}_{kind}"] = higher(f"AP{percent} {kind}", column=Column(f"AP{percent}", kind))(
            f"As ap_{kind}, only at overlap 0.{percent}."
        )
    for size, area in (("small", "below 32^2"), ("medium", "of 32^2 to 96^2"), ("large", "above 96^2")):
        found[f"ap_{size}_{kind}"] = higher(f"AP {size} {kind}")(f"As ap_{kind}, of oysters {area} px.")
    found[f"ar_{kind}"] = higher(f"AR {kind}", column=Column("AR", kind))(
        f"Average recall of {what}: the share of oysters found by the max_detections most confident detections of each "
        "image, averaged over the overlaps."
    )
    return found


DETECTION: dict[str, Metric] = {
    **_of("mask", "masks"),
    **_of("box", "boxes"),
    "pq": higher("PQ", column=Column("PQ"))(
        "Panoptic quality (Kirillov et al. 2019) of the class oyster: segmentation quality times recognition quality."
    ),
    "sq": higher("SQ")("Segmentation quality: mean overlap of the matches (overlap above 0.5)."),
    "rq": higher("RQ")("Recognition quality: matches over the mean number of true and estimated oysters (F1)."),
    "f1_live": higher("F1 live")(
        "F1 of the class live: twice the matches that are alive and predicted alive, over the number of true plus "
        "estimated live oysters."
    ),
    "f1_dead": higher("F1 dead")("The same for dead oysters: boxes and single valves."),
    "state_accuracy": higher("State")(
        "Share of found oysters whose state is predicted correctly, averaged over live and dead ones: 0.5 by chance."
    ),
    "live_error": neutral("Live count error", "oysters", column=Column("live", "error", 0))(
        "Estimated minus true number of live oysters over all images of the clip."
    ),
    "count_mae": lower("Count MAE", "oysters", column=Column("count", "MAE", 1))(
        "Mean absolute error of the number of oysters per image."
    ),
    "count_rmse": lower("Count RMSE", "oysters")("Root mean square of that error over images."),
    "count_bias": neutral("Count bias", "oysters", column=Column("count", "bias", 1))(
        "Mean signed error over images: above 0 for overcounting."
    ),
    **{
        f"game_{level}": lower(f"GAME({level})")(
            f"Grid average mean error (Guerrero-Gomez-Olmedo et al. 2015): like count_mae, but summed over {4**level} "
            "cells of the image, so that extra oysters in one cell do not offset those missed in another."
        )
        for level in LEVELS
    },
    "count_error": neutral("Count error", "oysters", column=Column("count", "error", 0))(
        "Estimated minus true number of oysters over all images of the clip."
    ),
    "count_truth": counted("True count", column=Column("true", "count", 0))(
        "True number of oysters over all images of the clip."
    ),
    "count_estimate": counted("Estimated count", column=Column("estimated", "count", 0))(
        "Estimated number of oysters over all images of the clip."
    ),
    "density_error_per_m2": neutral("Density error", "per m\N{SUPERSCRIPT TWO}", Column("density", "err/m²", 1))(
        "Error of the number of oysters over all images, divided by the area of seabed (seen from above) that they "
        "show."
    ),
    "density_mae_per_m2": lower("Density MAE", "per m\N{SUPERSCRIPT TWO}")(
        "Mean over images of the absolute error of oysters per square metre of seabed."
    ),
    "density_truth_per_m2": neutral("Density", "per m\N{SUPERSCRIPT TWO}")(
        "True number of oysters per area of seabed that the images show."
    ),
    "images_per_s": IMAGES_PER_S,
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
TRACK = TrackMetrics("Detection", DETECTION, TABLE, TABLE[1:], beside="count_mae", failed={"ap_mask": 0.0})
