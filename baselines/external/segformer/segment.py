"""Runs SegFormer on a folder of images.

    python -m oysterbench_baselines.external.segformer.segment TASK.json WEIGHTS FOLDER OUT

FOLDER has NAME.png and images.txt, the names. OUT becomes a folder of probabilities, NAME.npz, or, where the task asks
for instances, COCO annotations.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from oysterbench.core.errors import OysterbenchError
from oysterbench.evaluate.detection.instances import ImageInstances, from_planes
from oysterbench.methods.interfaces.images import listed, read_picture
from oysterbench_baselines.external.segformer.network import read_model
from oysterbench_baselines.learning.loop import pick_device
from oysterbench_baselines.learning.masks import MaskModel, probability
from oysterbench_baselines.learning.samples import Floats
from oysterbench_baselines.unet.calibration import Calibration
from oysterbench_baselines.unet.instances import SIDE, Division, find_instances


def predictions(
    model: MaskModel, calibration: Calibration, folder: Path, flips: bool
) -> Iterator[tuple[str, Floats, Floats]]:
    """Name and probabilities (H, W) of oyster and depth of each image. flips: logits are averaged with those of the
    mirrored image."""
    names = listed(folder)
    for k, name in enumerate(names, start=1):
        pixels = read_picture(folder, name)
        logits = model.logits(pixels)
        if flips:
            logits = np.float32(0.5) * (logits + model.logits(np.ascontiguousarray(pixels[:, ::-1]))[:, :, ::-1])
        yield name, probability(calibration.applied(logits[0])), probability(logits[1])
        if k * 10 // len(names) > (k - 1) * 10 // len(names):
            print(f"progress {k} of {len(names)}", flush=True)


def division(oyster: Floats, calibration: Calibration, least_area: float) -> Division:
    """Division of an image (H, W) into oysters; least_area: of the smallest one, px of the image."""
    return replace(calibration.division, area=least_area * (SIDE / max(oyster.shape)) ** 2)


def write_probability(path: Path, values: NDArray[Any]) -> None:
    """Write probabilities (H, W) as float16."""
    path.parent.mkdir(parents=True, exist_ok=True)
    np.savez_compressed(path, values.astype(np.float16))


def document(found: Iterator[ImageInstances]) -> dict[str, Any]:
    """Convert instances to COCO annotations."""
    images: list[Mapping[str, Any]] = []
    items: list[Mapping[str, Any]] = []
    for number, each in enumerate(found):
        images.append({"id": number, "file_name": f"{each.name}.png", "height": each.height, "width": each.width})
        for one in each.instances:
            assert one.mask is not None
            mask = {"size": list(one.mask["size"]), "counts": one.mask["counts"].decode()}
            about = {"id": len(items), "image_id": number, "category_id": 1, "bbox": list(one.box)}
            items.append({**about, "segmentation": mask, "area": one.area, "score": one.score})
    return {"images": images, "annotations": items, "categories": [{"id": 1, "name": "oyster"}]}


def main(task: str, weights: str, folder: str, out: str) -> None:
    """Run on a folder; the arguments are those of the command line."""
    asked = json.loads(Path(task).read_text(encoding="utf-8"))
    try:
        model, calibration = read_model(Path(weights), pick_device(asked["device"]))
        coming = predictions(model, calibration, Path(folder), asked["flips"])
        if asked["instances"]:
            least = asked["least_area"]
            divided = (
                (name, find_instances(oyster, depth, division(oyster, calibration, least)))
                for name, oyster, depth in coming
            )
            scores = ((name, one.labels, dict(enumerate(one.scores.tolist(), start=1))) for name, one in divided)
            found = document(from_planes(name, labels, scores=known) for name, labels, known in scores)
            Path(out).write_text(json.dumps(found), encoding="utf-8")
        else:
            for name, oyster, _ in coming:
                write_probability(Path(out) / f"{name}.npz", oyster)
    except OysterbenchError as error:
        sys.exit(str(error))


if __name__ == "__main__":
    main(*sys.argv[1:])
