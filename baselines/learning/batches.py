"""Batches of crops: batch k depends on the seed and on k alone, so that a training goes on where it was killed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch

from oysterbench.core.errors import LabelError
from oysterbench.core.streams import Streams
from oysterbench_baselines.learning.augment import Augmentation, augmented
from oysterbench_baselines.learning.samples import LabelledDataset, as_tensors

Batch = tuple[torch.Tensor, torch.Tensor, torch.Tensor]
"""Pixels (B, 3, C, C), truth (B, 7, C, C), known (B, 1, C, C), float32, as `LabelledDataset` has them."""


@dataclass(frozen=True)
class Mixture:
    """Data sets, and how many crops of a batch are of each."""

    datasets: Sequence[LabelledDataset]
    counts: Sequence[int]

    def __post_init__(self) -> None:
        for dataset, count in zip(self.datasets, self.counts, strict=True):
            if count and not len(dataset):
                raise LabelError(f"{dataset.labelled.name}: expected images to train on, got none")


def make_batch(mixture: Mixture, augmentation: Augmentation, streams: Streams, step: int) -> Batch:
    """Crops of images drawn at random (`LabelledDataset.drawn`), each with a stream of its own."""
    crops = []
    for k, (dataset, count) in enumerate(zip(mixture.datasets, mixture.counts, strict=True)):
        for j in range(count):
            rng = streams.generator("crop", step, k, j)
            crops.append(as_tensors(*augmented(dataset.drawn(rng), augmentation, rng)))
    return stacked(crops)


def stacked(items: Sequence[Batch]) -> Batch:
    """Items of one size as a batch."""
    pixels, truth, known = (torch.stack(parts) for parts in zip(*items, strict=True))
    return pixels, truth, known


def initial_seed(streams: Streams) -> int:
    """Of torch's own generator, for the first weights."""
    return int(streams.generator("weights").integers(np.iinfo(np.int64).max))
