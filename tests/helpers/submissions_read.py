"""Submissions as the limited process opens them."""

from __future__ import annotations

import io
import json
from pathlib import Path
from typing import Any

import cv2
import msgspec
import numpy as np

from oysterbench_leaderboard.submissions.catalogue import Wanted
from oysterbench_leaderboard.submissions.reading.archive import Limits
from oysterbench_leaderboard.submissions.reading.predictions import check_predictions, open_upload
from tests.helpers.pool import classes, image_names

LIMITS = Limits(4_000_000, 1_000_000, 200, 20_000_000, 100.0)


def wanted_of(served, split: str, track: str = "slam") -> Wanted:
    made = served[split].wanted[track]
    assert msgspec.json.decode(msgspec.json.encode(made), type=Wanted) == made
    return made


def opened(tmp_path: Path, data: bytes, wanted: Wanted):
    file = tmp_path / "upload"
    file.write_bytes(data)
    predictions = open_upload(file, wanted, LIMITS)
    return predictions, check_predictions(predictions, wanted)


def npz(**arrays) -> bytes:
    out = io.BytesIO()
    np.savez_compressed(out, **arrays)
    return out.getvalue()


def masks(sequence: int, shift: int = 1) -> dict[str, np.ndarray]:
    """Answers to the images of a sequence: the truth, moved by some pixels."""
    names = image_names(sequence)
    return {name: np.roll(classes(sequence, k)[1] > 0, shift, axis=1) for k, name in enumerate(names)}


def as_png(mask: np.ndarray) -> bytes:
    return cv2.imencode(".png", mask.astype(np.uint8) * 255)[1].tobytes()


def as_coco(found: dict[str, np.ndarray]) -> bytes:
    """COCO annotations: each connected piece of each mask, as uncompressed run lengths."""
    document_: dict[str, list[Any]] = {"images": [], "annotations": [], "categories": [{"id": 1, "name": "oyster"}]}
    for k, (name, mask) in enumerate(found.items()):
        document_["images"].append({"id": k, "file_name": f"{name}.png", "width": 64, "height": 48})
        count, numbers = cv2.connectedComponents(mask.astype(np.uint8), connectivity=8)
        for number in range(1, count):
            flat = (numbers == number).ravel(order="F").astype(np.int8)
            changes = np.flatnonzero(np.diff(flat, prepend=0))
            counts = np.diff([0, *changes.tolist(), flat.size]).tolist()
            row = {"id": len(document_["annotations"]) + 1, "image_id": k, "category_id": 1, "score": 1.0}
            document_["annotations"].append(row | {"segmentation": {"size": [48, 64], "counts": counts}})
    return json.dumps(document_).encode()
