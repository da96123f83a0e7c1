"""Sources of data sets: sequence files, and the frames of their cameras."""

from __future__ import annotations

import operator
import os
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from oysterbench.core.errors import OptionError, SequenceError
from oysterbench.notebook.split import Split, split
from oysterbench.sensors.camera import CameraCalibration
from oysterbench.sensors.camera_messages import read_colour
from oysterbench.sequence import Sequence, open_sequence
from oysterbench.sequence.places import IndexedFile

Source = str | os.PathLike[str] | Split | Iterable[str | os.PathLike[str] | Split]
"""A split or its name, a sequence file, a folder of them, or several of these."""

Transform = Callable[[dict[str, Any]], Any]
"""Maps an item to what is returned instead."""


@dataclass(frozen=True)
class Shots:
    """Frames of one camera of a file: `numbers` (N,) of its image messages in time order, and their stamps, ns."""

    file: IndexedFile
    sequence: str
    camera: str
    calibration: CameraCalibration
    numbers: NDArray[np.intp]
    stamps_ns: NDArray[np.int64]

    def image(self, k: int) -> torch.Tensor:
        """Read the k-th frame, (3, H, W) uint8 RGB."""
        _, pixels = read_colour(self.file.message(f"/{self.camera}/image", int(self.numbers[k])))
        return channels_first(pixels)

    def name(self, k: int) -> str:
        """Name of the k-th frame as in the evaluators: SEQUENCE/CAMERA/STAMP."""
        return f"{self.sequence}/{self.camera}/{self.stamps_ns[k]}"


def sequence_files(source: Source) -> list[Path]:
    """Sequence files of a source, rendered or downloaded if missing. Raises OysterbenchError where there is none."""
    if isinstance(source, Split):
        return list(source.fetch().values())
    if isinstance(source, str | os.PathLike):
        path = Path(source)
        if path.suffix == ".mcap":
            return [path]
        return list(split(source).fetch().values())
    if not isinstance(source, Iterable):
        opened = isinstance(source, Sequence)
        got = f"the open sequence {source.name}: give the path of its file" if opened else type(source).__name__
        raise SequenceError(f"expected a split, sequence files (.mcap) or folders of them, got {got}")
    files = [file for one in source for file in sequence_files(one)]
    if not files:
        raise SequenceError("expected a split, sequence files (.mcap) or a folder of them, got nothing")
    return files


def names_of(asked: str | Iterable[str], what: str) -> list[str]:
    """Names that were asked for, of cameras or layers. Raises OptionError for anything else."""
    if isinstance(asked, str):
        return [asked]
    names = list(asked) if isinstance(asked, Iterable) else []
    if not isinstance(asked, Iterable) or not all(isinstance(name, str) for name in names):
        raise OptionError(f"{what}: expected a name or several, got {asked!r:.80}")
    return names


def cameras_of(sequence: Sequence, path: Path, camera: str | Iterable[str] | None) -> Iterator[str]:
    """Yield the names of the requested cameras, or of all. Raises SequenceError where the sequence lacks one."""
    asked = list(sequence.cameras) if camera is None else [camera] if isinstance(camera, str) else list(camera)
    for name in asked:
        if name not in sequence.cameras:
            raise SequenceError(f"{path}: no camera {name!r}; cameras: {', '.join(sequence.cameras) or 'none'}")
        yield name


def opened(path: Path) -> Sequence:
    """Open a sequence file. Raises SequenceError for anything else, such as a folder in EuRoC layout."""
    if path.is_dir():
        raise SequenceError(f"{path}: expected a sequence file (.mcap), got a folder; `oysterbench.open` reads it")
    return open_sequence(path)


def channels_first(pixels: NDArray[Any]) -> torch.Tensor:
    """Tensor (C, H, W) of pixels (H, W, C), in its own memory."""
    return torch.from_numpy(np.ascontiguousarray(pixels.transpose(2, 0, 1)))


def place_of(number: int, ends: NDArray[np.intp]) -> tuple[int, int]:
    """Part and index within it of an item in concatenated parts; ends (P,): end of each part. Raises IndexError, and
    TypeError for anything but a number."""
    try:
        number = operator.index(number)
    except TypeError:
        raise TypeError(
            f"expected the number of an item, got {number!r:.80}; torch.utils.data.Subset(data, numbers) has several"
        ) from None
    total = int(ends[-1]) if len(ends) else 0
    if not -total <= number < total:
        raise IndexError(f"expected an item from 0 to {total - 1}, got {number}")
    number %= total
    part = int(np.searchsorted(ends, number, side="right"))
    return part, number - (int(ends[part - 1]) if part else 0)
