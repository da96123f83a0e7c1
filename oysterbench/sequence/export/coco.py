"""COCO instances: images/ as in the sequence, and instances.json with polygons that reproduce each mask exactly.

Oysters too small or too hidden to count have `iscrowd` 1, by which COCO's evaluation ignores them, as ours does.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from oysterbench.core.errors import SequenceError
from oysterbench.core.polygons import mask_polygons
from oysterbench.recipe import CLASSES, OYSTER
from oysterbench.sequence.countable import countable
from oysterbench.sequence.export.parts import frames_with_layers, labelled_cameras, write_png
from oysterbench.sequence.export.steps import Steps, frames
from oysterbench.sequence.types import Sequence

LICENCE = {"id": 1, "name": "CC BY 4.0", "url": "https://creativecommons.org/licenses/by/4.0/"}


def write(sequence: Sequence, folder: Path, truth: bool, steps: Steps) -> list[str]:
    """Write, for every camera with the layers class and instance, the frames that have them. Ids start at 1."""
    cameras = labelled_cameras(sequence, "visibility")
    if not truth or not cameras:
        raise SequenceError(
            f"{sequence.name}: COCO needs the layers class and instance, which are ground truth: expected a camera "
            f"with both and no --no-truth, got {'--no-truth' if not truth else 'no such camera'}"
        )
    steps.expect(frames(sequence, cameras, "class"))
    (folder / "images").mkdir()
    images: list[dict[str, Any]] = []
    annotations: list[dict[str, Any]] = []
    living = sequence.living()
    for camera, layers in cameras.items():
        for image, found in steps.counted(frames_with_layers(sequence, camera, layers)):
            file = f"{camera}_{image.stamp_ns}.png"
            write_png(folder / "images" / file, image.pixels)
            height, width = found["class"].shape
            image_id = len(images) + 1
            images.append(
                {
                    "id": image_id,
                    "file_name": file,
                    "width": width,
                    "height": height,
                    "license": LICENCE["id"],
                    "clip": sequence.name,
                    "camera": camera,
                    "stamp_ns": image.stamp_ns,
                }
            )
            for annotation in annotate(found["class"], found["instance"], found.get("visibility")):
                alive = living.get(annotation["instance"])
                state = {} if alive is None else {"state": "live" if alive else "dead"}
                annotations.append({"id": len(annotations) + 1, "image_id": image_id, **annotation, **state})
    document = {
        "info": {"description": f"oysterbench {sequence.name}", "version": sequence.metadata.get("split_version", "")},
        "licenses": [LICENCE],
        "categories": [
            {"id": number, "name": name, "supercategory": "reef"} for number, name in CLASSES.items() if number
        ],
        "images": images,
        "annotations": annotations,
    }
    (folder / "instances.json").write_text(json.dumps(document) + "\n", encoding="utf-8")
    ignored = sum(annotation["iscrowd"] for annotation in annotations)
    said = f", {ignored} of them oysters too small or too hidden to count (iscrowd 1: ignored)" if ignored else ""
    return [f"{len(images)} images, {len(annotations)} instances{said}"]


def annotate(
    classes: NDArray[np.uint8], instances: NDArray[np.uint16], visibility: NDArray[np.float32] | None
) -> Iterator[dict[str, Any]]:
    """Yield the annotations of one image, from layers (H, W); instance 0 is none. Area is the number of pixels."""
    _, ignore = countable(classes, instances, visibility)
    for number in np.unique(instances[instances > 0]):
        mask = instances == number
        rows, columns = np.nonzero(mask.any(axis=1))[0], np.nonzero(mask.any(axis=0))[0]
        top, left = int(rows[0]), int(columns[0])
        height, width = int(rows[-1]) - top + 1, int(columns[-1]) - left + 1
        polygons = mask_polygons(mask[top : top + height, left : left + width])
        category = int(np.bincount(classes[mask]).argmax())
        yield {
            "category_id": category,
            "iscrowd": int(category == OYSTER and ignore[mask].any()),
            "area": int(mask.sum()),
            "bbox": [left, top, width, height],
            "segmentation": [
                [value + (top if k % 2 else left) for k, value in enumerate(polygon)] for polygon in polygons
            ],
            "instance": int(number),
            **({} if visibility is None else {"visibility": round(float(np.nanmax(visibility[mask])), 6)}),
        }
