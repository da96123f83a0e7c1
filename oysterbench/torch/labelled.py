"""Labelled images of any kind, mainly real ones, as tensors."""

from __future__ import annotations

import os
from typing import Any

import numpy as np
import torch
from torch.utils.data import Dataset

from oysterbench.annotations import LabelledSet, open_labelled
from oysterbench.core.errors import LabelError
from oysterbench.notebook.split import Split
from oysterbench.torch.sources import Transform, channels_first, place_of


class LabelledDataset(Dataset[Any]):
    """Labelled images, such as one's own real ones, in the format of `FrameDataset`.

    Parameters
    ----------
    source : path, oysterbench.Split or oysterbench.annotations.LabelledSet
        A folder with images/ and labels/*.txt (YOLO) or masks/*.png, one with a COCO file, or a set of them, such as
        `oysterbench.labelled(path).of_split("train")`.
    transform : callable, optional
        Maps each item to what is returned instead. Needed for batches where images differ in size.

    Notes
    -----
    An item is a dict: image (3, H, W) uint8 RGB; oyster (H, W) bool; instance (H, W) int32, 0 is none; ignore (H, W)
    bool, pixels that are not evaluated; name and clip, str. These keys are shared with `FrameDataset(...,
    layers=("oyster", "instance", "ignore"))`, so that a `ConcatDataset` can mix rendered and real images if a transform
    keeps what both have; `instance` numbers other objects, too, there, so the transform sets it to 0 outside `oyster`.

    Raises
    ------
    oysterbench.core.errors.LabelError
        The path holds no labelled images, or an item's file is absent or damaged.

    Examples
    --------
    >>> import oysterbench
    >>> pictures = oysterbench.torch.LabelledDataset("mini-01.mcap")         # or a folder of real ones
    >>> pictures
    <LabelledDataset mini-01: 4 images of 1 clips>
    >>> pictures[0]["oyster"].shape
    torch.Size([48, 64])
    """

    def __init__(
        self, source: str | os.PathLike[str] | Split | LabelledSet, transform: Transform | None = None
    ) -> None:
        if isinstance(source, Split):
            source = source.labelled()
        self.pictures = source if isinstance(source, LabelledSet) else open_labelled(os.fspath(source))
        self.transform = transform
        if not len(self.pictures):
            raise LabelError(f"{self.pictures.name}: expected labelled images, got none")

    def __len__(self) -> int:
        return len(self.pictures)

    def __getitem__(self, number: int) -> Any:
        found = self.pictures[place_of(number, np.array([len(self)]))[1]]
        item = {
            "image": channels_first(found.pixels),
            "oyster": torch.from_numpy(found.oysters.copy()),
            "instance": torch.from_numpy(np.where(found.oysters, found.instances, 0).astype(np.int32)),
            "ignore": torch.from_numpy(found.ignore.copy()),
            "name": found.name,
            "clip": found.clip,
        }
        return item if self.transform is None else self.transform(item)

    def __repr__(self) -> str:
        return f"<LabelledDataset {self.pictures.name}: {len(self)} images of {len(self.pictures.clips)} clips>"
