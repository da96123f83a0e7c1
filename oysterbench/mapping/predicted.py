"""Oysters in the images of a sequence, from files or its ground truth: numbers, states and scores for each image."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from oysterbench.annotations import open_predictions, read_coco
from oysterbench.annotations.coco import CocoFile
from oysterbench.annotations.coco_item import live_of
from oysterbench.annotations.forms import FORMS
from oysterbench.annotations.masks import MaskFiles
from oysterbench.annotations.parts import connected_parts, without_specks
from oysterbench.core.errors import LabelError
from oysterbench.evaluate.detection import ImageInstances
from oysterbench.evaluate.detection.instances import mask_tools, numpy_2
from oysterbench.evaluate.detection.states import ALIVE
from oysterbench.mapping.projection import Seen
from oysterbench.recipe import OYSTER
from oysterbench.sequence.types import Sequence

STAMP = re.compile(r"(?:(?P<sequence>[^/]+)/)?(?:(?P<camera>[A-Za-z]\w*)[/_])?(?P<stamp>\d+(?:\.\d{9})?)")
"""Image names: SEQUENCE/CAMERA/STAMP as in labels, CAMERA_STAMP as in exports, or STAMP alone; the stamp is in ns, or
in seconds with nine decimals as in the images of `export --format tum`."""


def true_seen(sequence: Sequence, camera: str) -> Iterator[Seen]:
    """Yield the true oysters of each image, from the layers instance and class, with their states."""
    states = true_states(sequence)
    classes = sequence.layer(camera, "class")
    for instances, kinds in zip(sequence.layer(camera, "instance"), classes, strict=True):
        numbers = np.where(kinds.pixels == OYSTER, instances.pixels, 0).astype(np.int32)
        yield Seen(instances.stamp_ns, camera, numbers, states)


def true_states(sequence: Sequence) -> dict[int, str]:
    """True state, live or dead, of each oyster by number."""
    return {number: "live" if alive else "dead" for number, alive in sequence.living().items()}


def read_seen(
    place: Path, sequence: Sequence, camera: str, kind: str, threshold: float, several: bool = False
) -> Iterator[Seen]:
    """Read the oysters in the images of a sequence's camera from files, in time order.

    place: a folder or .npz of masks, as `annotations.masks` reads them (each connected component of a mask is one
    oyster) or, with kind "instances", of oyster numbers; or COCO annotations (.json). several: the files are of several
    sequences, given in their names; those of other sequences are ignored. Raises LabelError where the files are of
    another sequence, or invalid.
    """
    if kind not in FORMS:
        raise LabelError(f"kind of masks: expected one of {', '.join(FORMS)}, got {kind!r}")
    if place.suffix.lower() == ".json":
        return _coco(place, sequence, camera, threshold, several)
    form: Any = kind
    files = open_predictions(place, form)
    stamps = _stamps(place, files.names, sequence, camera, several)
    return _from_masks(files, stamps, camera, threshold)


def check_seen(seen: Iterable[Seen], sequence: Sequence, camera: str) -> None:
    """Read all of the oysters seen, and raise LabelError where those in an image are damaged, or of no image of this
    camera."""
    stamps = {image.stamp_ns for image in sequence.images(camera)}
    for picture in seen:
        check_shown(picture, sequence, camera, picture.stamp_ns in stamps)


def check_shown(picture: Seen, sequence: Sequence, camera: str, there: bool) -> None:
    """Raise LabelError where the oysters seen are in no image of a camera: none is `there` at their stamp, or it has
    another size."""
    if not there:
        raise LabelError(
            f"{sequence.name}: {camera} took no image at {picture.stamp_ns} ns: are the masks of another sequence?"
        )
    size = (sequence.cameras[camera].height, sequence.cameras[camera].width)
    if picture.numbers.shape != size:
        raise LabelError(
            f"mask of {camera} at {picture.stamp_ns} ns: expected {size[1]} x {size[0]} px, as the images of "
            f"{sequence.name}, got {picture.numbers.shape[1]} x {picture.numbers.shape[0]}"
        )


def _stamps(place: Path, names: tuple[str, ...], sequence: Sequence, camera: str, several: bool) -> dict[int, str]:
    """Map the stamps of images to their names, in time order."""
    found: dict[int, str] = {}
    for name in names:
        match = STAMP.fullmatch(name)
        if match is None:
            raise LabelError(
                f"{place}: {name}: expected the name of an image of {sequence.name}, e.g. "
                f"{sequence.name}/{camera}/STAMP, {camera}_STAMP or STAMP, with the stamp in ns or s.nnnnnnnnn"
            )
        if several and match["sequence"] is None:
            raise LabelError(
                f"{place}: {name}: expected the name of its sequence too, as there are several: "
                f"{sequence.name}/{camera}/STAMP or {sequence.name}/STAMP"
            )
        if match["sequence"] not in (None, sequence.name):
            if several:
                continue
            raise LabelError(
                f"{place}: {name}: masks of another sequence: expected those of {sequence.name}, got "
                f"{match['sequence']}"
            )
        if match["camera"] in (None, camera):
            found[int(match["stamp"].replace(".", ""))] = name
        elif match["camera"] not in sequence.cameras:
            raise LabelError(
                f"{place}: {name}: {sequence.name} has no camera {match['camera']!r}; its cameras: "
                f"{', '.join(sequence.cameras)}"
            )
    if not found:
        of = f"{camera} of {sequence.name}" if several else camera
        raise LabelError(f"{place}: no masks for {of}; expected some, or another --camera")
    return dict(sorted(found.items()))


def _from_masks(files: MaskFiles, stamps: Mapping[int, str], camera: str, threshold: float) -> Iterator[Seen]:
    for stamp_ns, name in stamps.items():
        if (numbers := files.numbers(name)) is not None:
            yield Seen(stamp_ns, camera, numbers)
        else:
            answer = files.get(name)
            yield components(stamp_ns, camera, answer.mask(threshold), answer.probability)


def components(
    stamp_ns: int, camera: str, mask: NDArray[np.bool_], probability: NDArray[np.floating[Any]] | None = None
) -> Seen:
    """Take each connected component of a mask (H, W), but no specks, as an oyster, scored by its mean probability."""
    numbers, means = connected_parts(mask, probability)
    scores = {} if means is None else dict(enumerate(means.tolist(), start=1))
    return Seen(stamp_ns, camera, without_specks(numbers), scores=scores)


def stacked(stamp_ns: int, camera: str, found: ImageInstances) -> Seen:
    """Take oyster instances, the most certain on top, with their scores and, where known, states. Raises LabelError for
    mere boxes."""
    numbers = np.zeros((found.height, found.width), dtype=np.int32)
    states, scores = {}, {}
    for k, one in enumerate(sorted(found.instances, key=lambda one: one.score), start=1):
        if one.mask is None:
            raise LabelError(f"{found.name}: boxes have no footprint: expected masks of individual oysters")
        with numpy_2():
            numbers[mask_tools().decode(one.mask) > 0] = k
        scores[k] = one.score
        if not math.isnan(one.live):
            states[k] = _told(one.live)
    return Seen(stamp_ns, camera, numbers, states, scores)


def _told(live: float) -> str:
    """State by the probability that an oyster is alive."""
    return "live" if live >= ALIVE else "dead"


def _coco(place: Path, sequence: Sequence, camera: str, threshold: float, several: bool) -> Iterator[Seen]:
    file = read_coco(place, oysters_alone=True)  # as a map is
    return _annotated(_stamps(place, file.names, sequence, camera, several), file, camera, threshold)


def _annotated(stamps: Mapping[int, str], file: CocoFile, camera: str, threshold: float) -> Iterator[Seen]:
    for stamp_ns, name in stamps.items():
        numbers = np.zeros(file.sizes[name], dtype=np.int32)
        states, scores = {}, {}
        # The most certain are drawn last, and so on top.
        for k, item in enumerate(sorted(file.items[name], key=lambda one: one.score(1.0)), start=1):
            score = item.score(1.0)
            if score < threshold or item.crowd:
                continue
            numbers[file.mask_of(name, item)] = k
            live = live_of(item)
            states[k] = "unknown" if math.isnan(live) else _told(live)
            scores[k] = score
        yield Seen(stamp_ns, camera, numbers, states, scores)
