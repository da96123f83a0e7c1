"""Matching of estimates to truths by pycocotools: which estimates are right at which overlap."""

from __future__ import annotations

import contextlib
import io
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from oysterbench.core.errors import LabelError
from oysterbench.core.geometry import Array
from oysterbench.evaluate.detection.instances import ImageInstances, Instance, mask_tools, numpy_2

Kind = Literal["box", "mask"]

OVERLAPS = np.linspace(0.5, 0.95, 10)
"""Minimum overlaps (IoU) of a match: COCO's."""

AREAS = {"all": (0.0, 1e10), "small": (0.0, 32.0**2), "medium": (32.0**2, 96.0**2), "large": (96.0**2, 1e10)}
"""Ranges of area, px, of the truths to be found: COCO's."""


@dataclass(frozen=True)
class Matches:
    """Matches of D estimates in some images, for one range of areas; image by image, and by falling score in each.

    scores (D,); right (T, D): matched to a truth in the range of areas, at each of `OVERLAPS`; ignored (T, D): matched
    to an ignored truth, or unmatched and outside the range; truths: number of truths that are not ignored.
    """

    scores: Array
    right: NDArray[np.bool_]
    ignored: NDArray[np.bool_]
    truths: int


def match(
    truths: Sequence[ImageInstances], estimates: Sequence[ImageInstances], kind: Kind, max_detections: int
) -> dict[str, Matches]:
    """Match estimates to truths, for each range of `AREAS`, by its name. truths, estimates: of the same images, in the
    same order."""
    mask_tools()
    from pycocotools.coco import COCO
    from pycocotools.cocoeval import COCOeval

    images = [{"id": k, "height": t.height, "width": t.width} for k, t in enumerate(truths, start=1)]
    with contextlib.redirect_stdout(io.StringIO()), numpy_2():  # it prints its progress
        sides = []
        for side in (truths, estimates):
            coco = COCO()
            coco.dataset = {"images": images, "categories": [{"id": 1}], "annotations": _annotations(side, kind)}
            coco.createIndex()
            sides.append(coco)
        evaluation = COCOeval(*sides, "bbox" if kind == "box" else "segm")
        evaluation.params.iouThrs = OVERLAPS
        evaluation.params.maxDets = [max_detections]
        evaluation.params.areaRng = list(AREAS.values())
        evaluation.params.areaRngLbl = list(AREAS)
        evaluation.evaluate()
    found = evaluation.evalImgs
    return {name: _gather(found[k * len(images) : (k + 1) * len(images)]) for k, name in enumerate(AREAS)}


def _annotations(side: Sequence[ImageInstances], kind: Kind) -> list[dict[str, Any]]:
    """COCO annotations of the images. Their ids start at 1: pycocotools mistakes a match with id 0 for none."""
    found: list[dict[str, Any]] = []
    for image_id, image in enumerate(side, start=1):
        wholes = [(instance, instance.box) for instance in image.instances]
        if kind == "box":
            wholes = [(instance, box) for instance in image.instances for box in instance.boxes]
        for instance, box in wholes:
            annotation = {
                "id": len(found) + 1,
                "image_id": image_id,
                "category_id": 1,
                "bbox": list(box),
                "area": _area(instance, kind),
                "iscrowd": int(instance.crowd),
                "score": instance.score,
            }
            if kind == "mask":
                if instance.mask is None:
                    raise LabelError(f"{image.name}: expected masks, got a box without one")
                annotation["segmentation"] = instance.mask
            found.append(annotation)
    return found


def _area(instance: Instance, kind: Kind) -> float:
    """Area in px: of an estimate, that of its mask or box, whichever is scored; of a truth, the one it was given."""
    is_truth = np.isnan(instance.score)
    return instance.area if is_truth or kind == "mask" else instance.box[2] * instance.box[3]


def _gather(found: list[dict[str, Any] | None]) -> Matches:
    known = [image for image in found if image is not None]  # None: neither truth nor estimate in the image
    n = len(OVERLAPS)
    if not known:
        return Matches(np.zeros(0), np.zeros((n, 0), bool), np.zeros((n, 0), bool), 0)
    matched = np.concatenate([np.reshape(image["dtMatches"], (n, -1)) for image in known], axis=1) > 0
    ignored = np.concatenate([np.reshape(image["dtIgnore"], (n, -1)) for image in known], axis=1).astype(bool)
    return Matches(
        np.concatenate([np.asarray(image["dtScores"], float) for image in known]),
        matched & ~ignored,
        ignored,
        int(sum(np.count_nonzero(np.asarray(image["gtIgnore"]) == 0) for image in known)),
    )
