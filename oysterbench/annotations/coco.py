"""COCO annotations: documents with images, and bare lists of results. Every item is checked before it is used."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from oysterbench.annotations.categories import Categories, categories_of
from oysterbench.annotations.coco_item import CocoItem, check_px, instance_of, live_of, run_lengths
from oysterbench.core import text
from oysterbench.core.errors import LabelError
from oysterbench.core.pictures import LARGEST_IMAGE_PX
from oysterbench.evaluate.detection import ImageInstances
from oysterbench.evaluate.detection.instances import mask_tools, numpy_2
from oysterbench.evaluate.detection.states import ALIVE
from oysterbench.evaluate.segmentation import EstimateImage

LONGEST_SIDE_PX = 1 << 16


class CocoImage(NamedTuple):
    """An image of a document. name: file name, without suffix if it remains unique; clip, split (in lower case): empty
    if the document does not state them."""

    name: str
    height: int
    width: int
    file_name: str
    clip: str
    split: str


@dataclass(frozen=True)
class CocoFile:
    """Content of a COCO file. images: by id; items: oysters, by name of the image; notes: what was left out or assumed,
    in sentences."""

    path: Path
    images: Mapping[Any, CocoImage]
    items: Mapping[str, tuple[CocoItem, ...]]
    categories: Categories
    notes: tuple[str, ...] = ()

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the images, in the order of the file."""
        return tuple(self.items)

    @property
    def sizes(self) -> dict[str, tuple[int, int]]:
        """Height and width of each image."""
        return {image.name: (image.height, image.width) for image in self.images.values()}

    @property
    def boxes_alone(self) -> bool:
        """Whether some item has a box, but no mask."""
        return any(not item.values.get("segmentation") for items in self.items.values() for item in items)

    @property
    def without_mask(self) -> str:
        """How many items have a box, but no mask, and which; empty if there is none."""
        items = [item for own in self.items.values() for item in own]
        lacking = [item.where for item in items if not item.values.get("segmentation")]
        return f"{len(lacking)} of {len(items)} ({_first(lacking)})" if lacking else ""

    def instances(self, name: str, scored: bool) -> ImageInstances:
        """Return the instances of an image; scored: as an estimate, in which every item has a score and none is a
        crowd region."""
        height, width = self.sizes[name]
        found = tuple(instance_of(item, height, width, scored) for item in self.items[name])
        return ImageInstances(name, height, width, found)

    def mask_of(self, name: str, item: CocoItem) -> NDArray[np.bool_]:
        """Mask (H, W) of an item of an image. Raises LabelError for an item with only a box."""
        if not item.values.get("segmentation"):
            raise LabelError(
                f"{item.where}: has no segmentation: expected a mask; with boxes only, use `--track detection`"
            )
        with numpy_2():
            mask = mask_tools().decode(run_lengths(item, *self.sizes[name]))
        return np.asarray(mask, dtype=bool)

    def mask(self, name: str, threshold: float) -> EstimateImage:
        """Union of the masks of an image's items with a score of at least `threshold`, or without a score."""
        mask = np.zeros(self.sizes[name], dtype=bool)
        for item in self.items[name]:
            if item.score(threshold) >= threshold:
                mask |= self.mask_of(name, item)
        return EstimateImage(name, oyster=mask)

    def truth(self, name: str) -> tuple[Iterator[NDArray[np.bool_]], NDArray[np.bool_]]:
        """Masks (H, W) of the oysters of an image, one by one, and that of its crowd regions, to be ignored."""
        crowd = np.zeros(self.sizes[name], dtype=bool)
        for item in self.items[name]:
            if item.crowd:
                crowd |= self.mask_of(name, item)
        single = (item for item in self.items[name] if not item.crowd)
        return (self.mask_of(name, item) for item in single), crowd

    def living(self, name: str) -> dict[int, bool]:
        """Whether oysters of an image are alive, by their numbers from 1 in the order of `truth`; unknown ones are left
        out."""
        live = [live_of(item) for item in self.items[name] if not item.crowd]
        return {number: one >= ALIVE for number, one in enumerate(live, start=1) if not math.isnan(one)}


def read_coco(path: Path, truth: CocoFile | None = None, oysters_alone: bool = False) -> CocoFile:
    """Read a document, or a list of results on the images of `truth`, of which only the oysters are kept.
    oysters_alone: live and dead are of oysters whatever categories stand beside them. Raises LabelError naming the item
    that is wrong.

    In a list of results, `category_id` means what it means in `truth`. Where that has a single category, results of a
    single number are of it, since programs number a single class from 0 or from 1; of several numbers, only those of
    the truth's. Checked here: ids of images and annotations (unique, known), categories (`categories_of`); when they
    are used: boxes, polygons, run lengths and their size, scores.
    """
    content = read_json(path)
    if isinstance(content, list):
        if truth is None:
            raise LabelError(
                f"{path}: a bare list of results names images only by number: expected ground truth in COCO form, "
                "which maps numbers to images, or an object with 'images' here"
            )
        known, notes = truth.categories, tuple[str, ...]()
        several = len(known.names) > 1
        results = list(_checked(path, "", content, truth.images, known.names if several else None))
        if several:
            kept = [one for one in results if one.values["category_id"] in known.states]
            notes = () if kept or not results else (_none_of_oysters(results, known),)
        else:
            kept, notes = _of_single_category(path, results, *known.names.items())
        return _sorted(path, truth.images, kept, known, notes)
    for key in ("images", "annotations", "categories"):
        if not isinstance(content, dict) or not isinstance(content.get(key), list):
            other = program_of(content)
            got = f", got annotations of {other}: export or convert them to COCO" if other else ""
            raise LabelError(f"{path}: expected a list of results, or an object with the list {key!r}{got}")
    if any(isinstance(item, dict) and "segments_info" in item for item in content["annotations"]):
        raise LabelError(
            f"{path}: expected annotations of instances, got panoptic ones, whose masks are in PNG files: give the "
            "file of the instances, such as instances_val2017.json, or convert them"
        )
    categories = _categories(path, content["categories"], oysters_alone)
    own = _images(path, content["images"])
    kept = []
    for item in _checked(path, "annotations", content["annotations"], own, categories.names):
        number = item.values["category_id"]
        if number in categories.doubtful:
            raise LabelError(
                f"{item.where}: its category, {categories.names[number]!r}, could be of oysters or not: expected a "
                "name such as oyster, 'live oyster' or 'dead oyster' if it is, else a supercategory other than oyster, "
                "and a name without this word that is no state alone: rename it"
            )
        if number in categories.states:
            kept.append(item)
    return _sorted(path, own, kept, categories)


def _categories(path: Path, content: list[Any], oysters_alone: bool) -> Categories:
    """Categories of a document. Raises LabelError where two have one id, or none is of oysters."""
    seen: set[Any] = set()
    for one in (one for one in content if isinstance(one, dict)):
        _check_id(number := one.get("id"), f"{path}: categories")
        if number in seen:
            raise LabelError(f"{path}: categories: id {number!r} is used twice")
        seen.add(number)
    found = categories_of(content, oysters_alone)
    if not found.states:
        raise LabelError(
            f"{path}: no category is named 'oyster'; its categories: {', '.join(found.names.values()) or 'none'}; name "
            'the one of oysters so; whether each is alive is said by "state": "live" or "dead" in its annotation, or '
            "by categories named 'live oyster' and 'dead oyster'"
        )
    return found


def _none_of_oysters(results: list[CocoItem], known: Categories) -> str:
    """What to say if no result is of an oyster, as where a program numbers its only class from 0."""
    numbers = ", ".join(str(number) for number in known.states)
    others = ", ".join(f"{k} {known.names[k]}" for k in {item.values["category_id"]: None for item in results})
    return f"left out: all {len(results)} results, of category_id {others}; in the ground truth, oysters are {numbers}"


def _of_single_category(
    path: Path, results: list[CocoItem], category: tuple[Any, str]
) -> tuple[list[CocoItem], tuple[str, ...]]:
    """Results of the only category, number and name, of a truth; and what to say of the others."""
    number, name = category
    found = Counter(one.values.get("category_id") for one in results)
    if len(found) == 1:
        (other,) = found
        assumed = f"all results have category_id {other}, taken for the ground truth's {number} {name}"
        return results, () if other in (number, None) else (assumed,)
    others = ", ".join(str(other) for other in found if other != number)
    if found and number not in found:
        raise LabelError(
            f"{path}: results have category_id {others}, and the ground truth knows only {number} {name}: give its "
            "number to those that are oysters"
        )
    kept = [one for one in results if one.values.get("category_id") == number]
    rest = [one.where for one in results if one.values.get("category_id") != number]
    if not rest:
        return kept, ()
    said = f"left out: {len(rest)} of {len(results)} results, of category_id {others}; the ground truth knows only "
    return kept, (f"{said}{number} {name} ({_first(rest)})",)


def _first(places: list[str]) -> str:
    return places[0] + (f" and {len(places) - 1} more" if len(places) > 1 else "")


def read_json(path: Path) -> Any:
    """Read a JSON file. Raises LabelError if it is none."""
    try:
        return text.read_json(path.read_bytes())
    except FileNotFoundError:
        raise LabelError(f"{path}: no such file") from None
    except (OSError, ValueError) as error:
        raise LabelError(f"{path}: cannot be read as JSON: {error}") from None


def program_of(content: Any) -> str:
    """Program other than of COCO that writes such JSON files; empty if it is not known."""
    if not isinstance(content, dict):
        return ""
    if {"shapes", "imagePath"} <= content.keys():
        return "LabelMe"
    images = content.get("_via_img_metadata", content)
    images = list(images.values()) if isinstance(images, dict) else []
    regions = all(isinstance(image, dict) and {"filename", "regions"} <= image.keys() for image in images)
    return "VIA" if images and regions else ""


def _images(path: Path, images: list[Any]) -> dict[Any, CocoImage]:
    found: dict[Any, CocoImage] = {}
    names: set[str] = set()
    bare = Counter(_bare(image.get("file_name")) for image in images if isinstance(image, dict))
    for k, image in enumerate(images):
        where = f"{path}: images[{k}]"
        for key in ("id", "file_name", "width", "height"):
            if not isinstance(image, dict) or key not in image:
                raise LabelError(f"{where}: key {key!r} is missing")
        _check_id(image["id"], where)
        file = _slashed(image["file_name"])
        name = _bare(file) if bare[_bare(file)] == 1 else file
        if image["id"] in found or name in names:
            raise LabelError(f"{where}: id {image['id']!r} or file_name {file!r} is used twice")
        sides = [image[key] for key in ("width", "height")]
        if not all(type(side) is int and 0 < side <= LONGEST_SIDE_PX for side in sides) or (
            sides[0] * sides[1] > LARGEST_IMAGE_PX
        ):
            got = " x ".join(f"{side!s:.20}" for side in sides)
            raise LabelError(
                f"{where}: expected width and height in px, of an image of at most {LARGEST_IMAGE_PX} px, got {got}"
            )
        clip, split = (str(image.get(key) or "").strip() for key in ("clip", "split"))
        found[image["id"]] = CocoImage(name, image["height"], image["width"], file, clip, split.casefold())
        names.add(name)
    if not found:
        raise LabelError(f"{path}: has no image")
    return found


def _bare(file: Any) -> str:
    path = PurePosixPath(_slashed(file))
    return path.with_suffix("").as_posix() if path.name else ""


def _slashed(file: Any) -> str:
    """Name of a file, which programs on Windows write with backslashes between folders."""
    return str(file).replace("\\", "/")


def _checked(
    path: Path, key: str, items: list[Any], images: Mapping[Any, CocoImage], categories: Mapping[Any, Any] | None
) -> Iterator[CocoItem]:
    """Check the items, and yield each. key: of an object in which they are; empty for a list of results, whose ids need
    not be unique. categories: known ones; None if any will do."""
    seen: set[Any] = set()
    for k, item in enumerate(items):
        where = f"{path}: {key}[{k}]"
        if not isinstance(item, dict):
            raise LabelError(f"{where}: expected an object, got {type(item).__name__}")
        for name in ("image_id", "category_id", "id"):
            _check_id(item.get(name), where)
        if item.get("image_id") not in images:
            raise LabelError(f"{where}: image_id {item.get('image_id')!r} matches none of {len(images)} images")
        if categories is not None and item.get("category_id") not in categories:
            known = ", ".join(f"{one} {name}" for one, name in categories.items())
            raise LabelError(f"{where}: category_id {item.get('category_id')!r} matches no category; known: {known}")
        if key and "id" in item:
            if item["id"] in seen:
                raise LabelError(f"{where}: id {item['id']!r} is used twice")
            seen.add(item["id"])
        if "segmentation" not in item and "bbox" not in item:
            raise LabelError(f"{where}: expected a 'segmentation', a 'bbox' or both, got neither")
        yield CocoItem(where, item)


def _sorted(
    path: Path,
    images: Mapping[Any, CocoImage],
    items: list[CocoItem],
    categories: Categories,
    notes: tuple[str, ...] = (),
) -> CocoFile:
    """Sort the oysters by their images, each with the state of its category, or of the only one."""
    alone = next(iter(categories.states.values())) if len(categories.names) == 1 else "unknown"
    found: dict[str, list[CocoItem]] = {image.name: [] for image in images.values()}
    for item in items:
        kind = categories.states.get(item.values.get("category_id"), alone)
        found[images[item.values["image_id"]].name].append(item._replace(kind=kind))
    check_px(path, items)
    return CocoFile(path, images, {name: tuple(own) for name, own in found.items()}, categories, notes)


def _check_id(value: Any, where: str) -> None:
    if not isinstance(value, str | int | float | None):
        raise LabelError(f"{where}: expected numbers or text as ids, got {value!s:.60}")
