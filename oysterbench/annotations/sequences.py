"""Labelled images of rendered sequences: every frame with class and instance layers in the file."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from oysterbench.annotations.image import OYSTER, Entry, LabelledImage, LabelledSet
from oysterbench.core.errors import LabelError
from oysterbench.sequence import Sequence, open_sequence
from oysterbench.sequence.export.parts import labelled_cameras

LEAST_VISIBILITY = 0.1
"""Minimum visible share of an oyster for it to count; with less, not even a person could tell what it is."""
LEAST_PIXELS = 16
"""Minimum number of pixels of an oyster for it to count: 4 x 4."""


def sequence_set(
    name: str, paths: Iterable[Path], conditions: Mapping[str, Mapping[str, float | str]] | None = None
) -> LabelledSet:
    """Open the frames of all cameras of sequences that have the layers class and instance, sequence by sequence.

    A clip is a sequence: its cameras look at the same reef at the same time. Oysters of which less than
    `LEAST_VISIBILITY` is visible (if there is a layer visibility) or fewer than `LEAST_PIXELS` are not instances, and
    their pixels are ignored. conditions: by name of a sequence. Raises LabelError if no sequence has labels.
    """
    entries: list[Entry] = []
    names = []
    for path in paths:
        sequence = open_sequence(path)
        names.append(sequence.name)
        living = sequence.living()
        for camera, layers in labelled_cameras(sequence, "visibility").items():
            known = {"camera": camera, **(conditions or {}).get(sequence.name, {})}
            for layer in sequence.layer(camera, "class"):
                key = f"{sequence.name}/{camera}/{layer.stamp_ns}"
                read = partial(_read, sequence, camera, layer.stamp_ns, layers, key, known, living)
                entries.append(Entry(key, sequence.name, read, (Path(path),)))
    if not entries:
        raise LabelError(
            f"{name}: no camera of {', '.join(names) or 'no sequence'} has the layers class and instance; "
            "`oysterbench info` lists what a sequence has"
        )
    return LabelledSet(name, entries)


def _read(
    sequence: Sequence,
    camera: str,
    stamp_ns: int,
    layers: list[str],
    name: str,
    conditions: Mapping[str, float | str],
    living: Mapping[int, bool],
) -> LabelledImage:
    window = (stamp_ns, stamp_ns + 1)
    image = next(iter(sequence.images(camera, *window)), None)
    found = {layer: next(iter(sequence.layer(camera, layer, *window)), None) for layer in layers}
    if image is None or None in found.values():
        raise LabelError(f"{name}: the file has its class but not its image, instance or visibility")
    planes = {layer: item.pixels for layer, item in found.items() if item is not None}
    instances, ignore = countable(planes["class"], planes["instance"], planes.get("visibility"))
    return LabelledImage(name, sequence.name, image.pixels, planes["class"], instances, ignore, conditions, living)


def countable(
    classes: NDArray[np.uint8], instances: NDArray[np.uint16], visibility: NDArray[np.float32] | None
) -> tuple[NDArray[np.uint16], NDArray[np.bool_]]:
    """Split off the oysters that are too small or too hidden: return the other instances (H, W), and their mask
    (H, W)."""
    sizes = np.bincount(instances.ravel())
    bad = sizes < LEAST_PIXELS
    if visibility is not None:
        hidden = np.ones(len(sizes), dtype=bool)
        hidden[instances[visibility >= LEAST_VISIBILITY]] = False
        bad |= hidden
    bad[0] = False
    ignore = bad[instances] & (classes == OYSTER)
    return np.where(ignore, 0, instances).astype(np.uint16), ignore
