"""COCO annotations: a document with images, or a bare list of results. Every item is checked before it is used."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np
from numpy.typing import NDArray

from oysterbench.annotations.coco import segmentation_mask
from oysterbench.core.errors import LabelError
from oysterbench.evaluate.detection import ImageInstances, Instance
from oysterbench.evaluate.detection.instances import mask_tools, numpy_2
from oysterbench.evaluate.segmentation import EstimateImage

Ids = Mapping[Any, tuple[str, int, int]]
"""Image id -> name, height, width."""


@dataclass(frozen=True)
class CocoFile:
    """What a file says of each image. items: by name of the image; clips: of those images that have the key clip."""

    path: Path
    ids: Ids
    items: Mapping[str, tuple[tuple[str, Mapping[str, Any]], ...]]
    clips: Mapping[str, str]

    @property
    def names(self) -> tuple[str, ...]:
        """Of its images, in its order."""
        return tuple(self.items)

    @property
    def sizes(self) -> dict[str, tuple[int, int]]:
        """Height and width of each image."""
        return {name: (height, width) for name, height, width in self.ids.values()}

    @property
    def boxes_alone(self) -> bool:
        """Whether some item has no mask."""
        return any(not item.get("segmentation") for rows in self.items.values() for _, item in rows)

    def instances(self, name: str, scored: bool) -> ImageInstances:
        """Its instances in an image; scored: as an estimate, in which every item has a score and is asked about."""
        height, width = self.sizes[name]
        found = tuple(_instance(where, item, height, width, scored) for where, item in self.items[name])
        return ImageInstances(name, height, width, found)

    def mask(self, name: str, threshold: float) -> EstimateImage:
        """All of an image's items from a score on (all, where they have none), as one mask."""
        height, width = self.sizes[name]
        mask = np.zeros((height, width), dtype=bool)
        for where, item in self.items[name]:
            if "score" in item and _score(where, item) < threshold:
                continue
            if not item.get("segmentation"):
                raise LabelError(
                    f"{where}: has no segmentation: a box alone is no mask; `--track detection` scores boxes"
                )
            mask |= segmentation_mask(item["segmentation"], height, width, where)
        return EstimateImage(name, oyster=mask)

    def as_truth(self, name: str) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
        """(H, W) of the oysters of an image, and of what is ignored: crowd regions, where no oyster lies on them."""
        height, width = self.sizes[name]
        planes = np.zeros((2, height, width), dtype=bool)
        for where, item in self.items[name]:
            if not item.get("segmentation"):
                raise LabelError(f"{where}: has no segmentation: a box alone is no mask")
            planes[int(bool(item.get("iscrowd")))] |= segmentation_mask(item["segmentation"], height, width, where)
        return planes[0], planes[1] & ~planes[0]


def read_coco(path: Path, ids: Ids | None = None, category: str = "oyster") -> CocoFile:
    """A document, or a list of results on the images `ids`. Raises LabelError naming the item that is wrong.

    Checked: ids of images and annotations (unique, known), categories, boxes, polygons, run lengths and their size,
    scores where they are given.
    """
    content = _load(path)
    if isinstance(content, list):
        if ids is None:
            raise LabelError(
                f"{path}: a bare list of results names images by number alone: expected a truth in COCO form, which "
                "says which numbers are which images, or an object with 'images' here"
            )
        return _sorted(path, ids, _checked(path, "", content, ids, None), {})
    for key in ("images", "annotations", "categories"):
        if not isinstance(content, dict) or not isinstance(content.get(key), list):
            raise LabelError(f"{path}: expected a list of results, or an object with the list {key!r}")
    names = {one.get("name"): one.get("id") for one in content["categories"] if isinstance(one, dict)}
    if category not in names:
        raise LabelError(f"{path}: no category {category!r}; its categories: {', '.join(map(str, names)) or 'none'}")
    own, clips = _images(path, content["images"])
    items = _checked(path, "annotations", content["annotations"], own, {one: name for name, one in names.items()})
    return _sorted(path, own, [(w, item) for w, item in items if item["category_id"] == names[category]], clips)


def _load(path: Path) -> Any:
    try:
        return json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise LabelError(f"{path}: no such file") from None
    except (OSError, UnicodeDecodeError, json.JSONDecodeError) as error:
        raise LabelError(f"{path}: cannot be read as JSON: {error}") from None


def _images(path: Path, images: list[Any]) -> tuple[Ids, dict[str, str]]:
    ids: dict[Any, tuple[str, int, int]] = {}
    names: set[str] = set()
    clips = {}
    for k, image in enumerate(images):
        where = f"{path}: images[{k}]"
        for key in ("id", "file_name", "width", "height"):
            if not isinstance(image, dict) or key not in image:
                raise LabelError(f"{where}: key {key!r} is missing")
        name = PurePosixPath(str(image["file_name"])).with_suffix("").as_posix()
        if image["id"] in ids or name in names:
            raise LabelError(f"{where}: id {image['id']!r} or file_name {image['file_name']!r} is used a second time")
        if not all(isinstance(image[key], int) and image[key] > 0 for key in ("width", "height")):
            raise LabelError(f"{where}: expected width and height in px, got {image['width']} x {image['height']}")
        ids[image["id"]] = (name, image["height"], image["width"])
        names.add(name)
        if "clip" in image:
            clips[name] = str(image["clip"])
    if not ids:
        raise LabelError(f"{path}: has no image")
    return ids, clips


def _checked(
    path: Path, key: str, items: list[Any], ids: Ids, categories: Mapping[Any, Any] | None
) -> Iterator[tuple[str, Mapping[str, Any]]]:
    """Where each item stands, and the item. categories: those known; None where the list does not say."""
    seen: set[Any] = set()
    for k, item in enumerate(items):
        where = f"{path}: {key}[{k}]"
        if not isinstance(item, dict):
            raise LabelError(f"{where}: expected an object, got {type(item).__name__}")
        if item.get("image_id") not in ids:
            raise LabelError(f"{where}: image_id {item.get('image_id')!r} is of no image; {len(ids)} images are known")
        if categories is not None and item.get("category_id") not in categories:
            known = ", ".join(f"{one} {name}" for one, name in categories.items())
            raise LabelError(f"{where}: category_id {item.get('category_id')!r} is of no category; known: {known}")
        if categories is not None and "id" in item:
            if item["id"] in seen:
                raise LabelError(f"{where}: id {item['id']!r} is used a second time")
            seen.add(item["id"])
        if "segmentation" not in item and "bbox" not in item:
            raise LabelError(f"{where}: expected a 'segmentation', a 'bbox' or both, got neither")
        yield where, item


def _sorted(path: Path, ids: Ids, items: Any, clips: Mapping[str, str]) -> CocoFile:
    found: dict[str, list[tuple[str, Mapping[str, Any]]]] = {name: [] for name, _, _ in ids.values()}
    for where, item in items:
        found[ids[item["image_id"]][0]].append((where, item))
    return CocoFile(path, ids, {name: tuple(rows) for name, rows in found.items()}, clips)


def _score(where: str, item: Mapping[str, Any]) -> float:
    score = item.get("score")
    if isinstance(score, bool) or not isinstance(score, int | float) or not math.isfinite(score):
        raise LabelError(f"{where}: expected a 'score', a number, got {score!r}")
    return float(score)


def _instance(where: str, item: Mapping[str, Any], height: int, width: int, scored: bool) -> Instance:
    runs = _runs(where, item["segmentation"], height, width) if item.get("segmentation") else None
    tools = mask_tools()
    with numpy_2():
        box = _box(where, item["bbox"] if "bbox" in item else tools.toBbox(runs).tolist())
        area = float(tools.area(runs)) if runs is not None else box[2] * box[3]
    if scored:
        return Instance(box, runs, area, _score(where, item))
    return Instance(box, runs, float(item.get("area", area)), crowd=bool(item.get("iscrowd")))


def _box(where: str, box: Any) -> tuple[float, float, float, float]:
    numbers = isinstance(box, list) and len(box) == 4 and all(isinstance(v, int | float) for v in box)
    if not numbers or not all(map(math.isfinite, box)) or box[2] < 0 or box[3] < 0:
        raise LabelError(f"{where}: expected 'bbox' as [x, y, width, height] in px, got {box!s:.60}")
    x, y, w, h = map(float, box)
    return x, y, w, h


def _runs(where: str, segmentation: Any, height: int, width: int) -> Mapping[str, Any]:
    """Compressed run lengths, as pycocotools makes them of polygons (which it rasterises in its own way)."""
    tools = mask_tools()
    if isinstance(segmentation, list):
        for polygon in segmentation:
            if not isinstance(polygon, list) or len(polygon) < 6 or len(polygon) % 2:
                count = len(polygon) if isinstance(polygon, list) else 0
                raise LabelError(f"{where}: expected polygons of three corners x y or more, got {count} numbers")
            if not all(isinstance(v, int | float) and math.isfinite(v) for v in polygon):
                raise LabelError(f"{where}: expected the corners of polygons as numbers, got {polygon!s:.60}")
        with numpy_2():
            return tools.merge(tools.frPyObjects(segmentation, height, width))
    if isinstance(segmentation, dict) and isinstance(segmentation.get("counts"), str | bytes):
        # pycocotools trusts the lengths; what does not add up would be read from beyond the image.
        segmentation_mask(segmentation, height, width, where)
        counts = segmentation["counts"]
        return {"size": [height, width], "counts": counts.encode() if isinstance(counts, str) else counts}
    segmentation_mask(segmentation, height, width, where)
    with numpy_2():
        return tools.frPyObjects(segmentation, height, width)
