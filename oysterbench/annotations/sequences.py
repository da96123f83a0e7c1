"""Labelled images of rendered sequences: every frame with class and instance layers in the file."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from functools import partial
from pathlib import Path

from oysterbench.annotations.image import Entry, LabelledImage, LabelledSet
from oysterbench.core.errors import LabelError
from oysterbench.sequence import Sequence, open_sequence
from oysterbench.sequence.countable import countable
from oysterbench.sequence.export.parts import labelled_cameras


def sequence_set(
    name: str, paths: Iterable[Path], conditions: Mapping[str, Mapping[str, float | str]] | None = None
) -> LabelledSet:
    """Open the frames of all cameras of sequences that have the layers class and instance, sequence by sequence.

    A clip is a sequence: its cameras look at the same reef at the same time. Oysters that are too small or too hidden
    (`sequence.countable`) are not instances, and their pixels are ignored. conditions: by name of a sequence. Raises
    LabelError if no sequence has labels.
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
