"""Single frames with per-pixel ground truth."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch.utils.data import Dataset

from oysterbench.core.errors import OptionError, SequenceError
from oysterbench.recipe import OYSTER
from oysterbench.sensors.camera_messages import LAYERS, read_layer
from oysterbench.sequence import Sequence
from oysterbench.sequence.countable import countable
from oysterbench.sequence.places import CACHE_BYTES, Chunks, IndexedFile
from oysterbench.torch.sources import (
    Shots,
    Source,
    Transform,
    cameras_of,
    channels_first,
    names_of,
    opened,
    place_of,
    sequence_files,
)

DERIVED = {"oyster": ("class",), "ignore": ("class", "instance")}
"""Derived layer -> the layers that it is made from."""

NEEDED_IF_THERE = {"ignore": ("visibility",)}


class FrameDataset(Dataset[Any]):
    """Frames of rendered sequences with their masks and other ground-truth layers, in the order of the files.

    Parameters
    ----------
    source : str, path, oysterbench.Split, or several of these
        A split or its name, rendered or downloaded if it is not here; sequence files (.mcap); folders of them.
    camera : str or list of str, optional
        Cameras whose frames are used; by default all that have the layers.
    layers : tuple of str
        Layers that items contain, see below. Frames that lack one of them are left out, as layers are often recorded at
        a lower rate.
    transform : callable, optional
        Maps each item to what is returned instead. It must be picklable where workers are spawned.
    cache_mb : float
        Size of the cache of unpacked file chunks in each process.

    Notes
    -----
    An item is a dict. For a frame of H x W pixels:

    ============== ==================== ==================================================================
    key            tensor               what
    ============== ==================== ==================================================================
    image          (3, H, W) uint8      RGB
    oyster         (H, W) bool          where an oyster is visible
    ignore         (H, W) bool          pixels of oysters too small or too occluded to count, not evaluated
    class          (H, W) uint8         numbers of `oysterbench.recipe.CLASSES`
    instance       (H, W) int32         number of the oyster or other object, 0 is none
    depth          (H, W) float32       m along the optical axis from the true pupil, 0 is none
    visibility     (H, W) float32       unoccluded share of the instance at a pixel, NaN is none
    normals        (3, H, W) float32    outward, in the optical frame (x right, y down, z forward)
    dynamic        (H, W) uint8         1 where something moves by itself
    flow           (2, H, W) float32    px to the right and down until the image of the next frame
                                        in the file: 0 if that repeats this one; NaN is none
    transmittance  (H, W) float32       share of green light that gets through the water, 0 is none
    clean, direct, (3, H, W) float32    light; 1 is a white surface in full daylight
    forward_scatter, backscatter, snow
    intrinsics     (3, 3) float32       matrix of the camera, px
    stamp_ns       int                  ns
    name, sequence, camera  str         name: SEQUENCE/CAMERA/STAMP, as in the evaluators
    ============== ==================== ==================================================================

    Only those of `layers` are present, besides image, intrinsics, stamp_ns and names. Intrinsics are those that methods
    are given; behind a flat port, their centre lies behind the true pupil (`oysterbench/sensors/README.md`).

    Raises
    ------
    oysterbench.core.errors.SequenceError
        A file is absent or damaged, or no camera of a file has the layers: the message says which layers there are.
    oysterbench.core.errors.OptionError
        Cameras or layers are not given by their names.

    Examples
    --------
    From a file, or from a split by its name, as in `FrameDataset("seg-train")`:

    >>> import oysterbench
    >>> from torch.utils.data import DataLoader
    >>> frames = oysterbench.torch.FrameDataset("mini-01.mcap", layers=("oyster", "ignore"))
    >>> frames
    <FrameDataset: 4 frames of 1 sequences, with oyster, ignore>
    >>> for batch in DataLoader(frames, batch_size=2, shuffle=True):
    ...     asked = batch["oyster"][~batch["ignore"]]           # what a loss is taken over
    >>> batch["image"].shape, batch["oyster"].shape
    (torch.Size([2, 3, 48, 64]), torch.Size([2, 48, 64]))
    """

    def __init__(
        self,
        source: Source,
        camera: str | Iterable[str] | None = None,
        layers: Iterable[str] = ("oyster", "instance", "depth"),
        transform: Transform | None = None,
        cache_mb: float = CACHE_BYTES / 1e6,
    ) -> None:
        self.layers = tuple(names_of(layers, "layers"))
        self.transform = transform
        for layer in self.layers:
            if layer not in LAYERS and layer not in DERIVED:
                raise SequenceError(f"layers: unknown layer {layer!r}; known layers: {', '.join([*DERIVED, *LAYERS])}")
        asked = None if camera is None else names_of(camera, "camera")
        if asked == []:
            raise OptionError("camera: expected a name or several, got none; leave it out for all that have the layers")
        chunks = Chunks(round(1e6 * cache_mb))
        self._parts: list[_Part] = []
        for path in sequence_files(source):
            self._parts += _parts_of(path, asked, self.layers, chunks)
        self._ends = np.cumsum([len(part.shots.numbers) for part in self._parts], dtype=np.intp)
        if not len(self):
            raise SequenceError(f"{source}: no frame has all of the layers {', '.join(self.layers)}")

    def __len__(self) -> int:
        return int(self._ends[-1]) if len(self._ends) else 0

    def __getitem__(self, number: int) -> Any:
        part, k = place_of(number, self._ends)
        item = self._parts[part].item(k, self.layers)
        return item if self.transform is None else self.transform(item)

    @property
    def names(self) -> list[str]:
        """Name of each frame: SEQUENCE/CAMERA/STAMP."""
        return [part.shots.name(k) for part in self._parts for k in range(len(part.shots.numbers))]

    def __repr__(self) -> str:
        sequences = {part.shots.file.path for part in self._parts}
        layers = ", ".join(self.layers) or "no layers"
        return f"<FrameDataset: {len(self)} frames of {len(sequences)} sequences, with {layers}>"


class _Part:
    """Frames of one camera of a file. numbers: layer -> numbers (N,) of its messages, for each layer needed."""

    def __init__(self, shots: Shots, numbers: Mapping[str, NDArray[np.intp]]) -> None:
        self.shots, self.numbers = shots, numbers

    def item(self, k: int, layers: Iterable[str]) -> dict[str, Any]:
        shots = self.shots
        planes = {name: self._plane(name, k) for name in self.numbers}
        return {
            "image": shots.image(k),
            **{name: _tensor(name, planes) for name in layers},
            "intrinsics": torch.from_numpy(shots.calibration.matrix.astype(np.float32)),
            "stamp_ns": int(shots.stamps_ns[k]),
            "name": shots.name(k),
            "sequence": shots.sequence,
            "camera": shots.camera,
        }

    def _plane(self, layer: str, k: int) -> NDArray[Any]:
        data = self.shots.file.message(f"/{self.shots.camera}/{layer}", int(self.numbers[layer][k]))
        return read_layer(data, layer)[1]


def _parts_of(path: Path, asked: list[str] | None, layers: tuple[str, ...], chunks: Chunks) -> list[_Part]:
    sequence = opened(path)
    topics = {topic for topic, _, _ in sequence.contents()}
    needed = dict.fromkeys(part for layer in layers for part in DERIVED.get(layer, (layer,)))
    further = [part for layer in layers for part in NEEDED_IF_THERE.get(layer, ())]
    parts = []
    for camera in cameras_of(sequence, path, asked):
        lacking = [layer for layer in needed if f"/{camera}/{layer}" not in topics]
        if lacking and asked is None:
            continue
        if lacking:
            raise _lacks(sequence, path, camera, layers)
        own = [*needed, *(layer for layer in further if f"/{camera}/{layer}" in topics and layer not in needed)]
        file = IndexedFile(path, [f"/{camera}/{leaf}" for leaf in ("image", *own)], chunks)
        images = file.topics.get(f"/{camera}/image")
        if images is None:
            raise SequenceError(f"{path}: no image of {camera}: it was left out of the file")
        stamps = images.stamps_ns
        for layer in own:
            stamps = np.intersect1d(stamps, file.topics[f"/{camera}/{layer}"].stamps_ns)
        numbers = {leaf: _numbers(file, camera, leaf, stamps) for leaf in ("image", *own)}
        shots = Shots(file, sequence.name, camera, sequence.cameras[camera], numbers.pop("image"), stamps)
        parts.append(_Part(shots, numbers))
    if not parts:
        raise _lacks(sequence, path, next(iter(sequence.cameras), None), layers)
    return parts


def _numbers(file: IndexedFile, camera: str, leaf: str, stamps_ns: NDArray[np.int64]) -> NDArray[np.intp]:
    """Numbers (N,) of the messages at these stamps, all of which exist."""
    return np.searchsorted(file.topics[f"/{camera}/{leaf}"].stamps_ns, stamps_ns)


def _lacks(sequence: Sequence, path: Path, camera: str | None, layers: tuple[str, ...]) -> SequenceError:
    topics = {topic for topic, _, _ in sequence.contents()}
    known = [layer for layer in LAYERS if f"/{camera}/{layer}" in topics]
    if camera is None:
        return SequenceError(f"{path}: expected a camera with the layers {', '.join(layers)}, found no camera at all")
    known += [name for name, parts in DERIVED.items() if set(parts) <= set(known)]
    return SequenceError(
        f"{path}: expected a camera with the layers {', '.join(layers)}; {camera} has {', '.join(known) or 'none'}"
        + ("" if known else ": its truth is kept back, or was never there; layers=() takes the images alone")
    )


def _tensor(layer: str, planes: Mapping[str, NDArray[Any]]) -> torch.Tensor:
    if layer == "oyster":
        return torch.from_numpy(planes["class"] == OYSTER)
    if layer == "ignore":
        return torch.from_numpy(countable(planes["class"], planes["instance"], planes.get("visibility"))[1])
    plane = planes[layer]
    if plane.ndim == 3:
        return channels_first(plane)
    return torch.from_numpy(plane.astype(np.int32) if layer == "instance" else plane.copy())
