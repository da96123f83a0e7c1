"""Counts as COCO annotations, to be corrected by hand in a labelling tool, or scored."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path, PurePosixPath
from typing import Any

from oysterbench.annotations.image import read_plane
from oysterbench.core.polygons import mask_polygons
from oysterbench.counting.measure import OysterRow, PictureCount
from oysterbench.counting.store import Store

CATEGORY = {"id": 1, "name": "oyster", "supercategory": "reef"}


def coco_document(store: Store, pictures: Sequence[PictureCount]) -> dict[str, Any]:
    """COCO document of all oysters that count, with `score`, and `live` if the method provides them; polygons reproduce
    each mask exactly, if there are masks."""
    images: list[dict[str, Any]] = []
    annotations: list[dict[str, Any]] = []
    for k, one in enumerate(pictures, start=1):
        file = f"{one.name}.png" if one.video else (PurePosixPath(one.name).parent / Path(one.file).name).as_posix()
        images.append({"id": k, "file_name": file, "width": one.width, "height": one.height})
        for annotation in _annotations(store, one):
            annotations.append({"id": len(annotations) + 1, "image_id": k, "category_id": 1, **annotation})
    found = {"categories": [CATEGORY], "images": images, "annotations": annotations}
    return {"info": {"description": "oysters, as counted", "sha256": _digest(found)}, **found}


def is_as_counted(path: Path) -> bool:
    """Whether a file is as `coco_document` made it: not one that was corrected since, nor of a version that kept no
    digest, of which that is not known."""
    try:
        found = json.loads(path.read_text(encoding="utf-8"))
        return bool(found.pop("info")["sha256"] == _digest(found))
    except (OSError, ValueError, AttributeError, LookupError, TypeError):
        return False


def _digest(found: Mapping[str, Any]) -> str:
    return hashlib.sha256(json.dumps(found, sort_keys=True).encode()).hexdigest()


def _annotations(store: Store, picture: PictureCount) -> Iterator[dict[str, Any]]:
    path = store.mask(picture.name)
    numbers = read_plane(path) if path.is_file() else None
    for row in store.oysters(picture.name):
        if not row.counted:
            continue
        polygons = [] if numbers is None else _polygons(numbers, row)
        yield {
            "bbox": list(row.box),
            "area": row.area_px if row.area_px is not None else row.box[2] * row.box[3],
            "iscrowd": 0,
            **({"segmentation": polygons} if polygons else {}),
            **({"score": row.score} if row.score is not None else {}),
            **({"live": row.live} if row.live is not None else {}),
        }


def _polygons(numbers: Any, row: OysterRow) -> list[list[float]]:
    left, top, wide, tall = map(int, row.box)
    found = mask_polygons(numbers[top : top + tall, left : left + wide] == row.number)
    return [[value + (top if k % 2 else left) for k, value in enumerate(polygon)] for polygon in found]
