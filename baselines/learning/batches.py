"""Batches of crops: batch k depends only on the seed and on k, so that a killed training resumes where it stopped."""

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
"""Pixels (B, 3, C, C), truth (B, 7, C, C), known (B, 1, C, C), float32, with the planes of a `LabelledDataset`."""


@dataclass(frozen=True)
class Mixture:
    """Datasets, and how many crops of each batch come from each of them. Raises LabelError where a dataset that
    contributes crops is empty."""

    datasets: Sequence[LabelledDataset]
    counts: Sequence[int]

    def __post_init__(self) -> None:
        for dataset, count in zip(self.datasets, self.counts, strict=True):
            if count and not len(dataset):
                raise LabelError(f"{dataset.labelled.name}: expected images to train on, got none")


def make_batch(mixture: Mixture, augmentation: Augmentation, streams: Streams, step: int) -> Batch:
    """Make the batch of a step from crops of randomly drawn images (`LabelledDataset.drawn`), each crop with a random
    stream of its own."""
    crops = []
    for k, (dataset, count) in enumerate(zip(mixture.datasets, mixture.counts, strict=True)):
        for j in range(count):
            rng = streams.generator("crop", step, k, j)
            crops.append(as_tensors(*augmented(dataset.drawn(rng), augmentation, rng)))
    return stacked(crops)


def stacked(items: Sequence[Batch]) -> Batch:
    """Stack items of the same size into a batch."""
    pixels, truth, known = (torch.stack(parts) for parts in zip(*items, strict=True))
    return pixels, truth, known


def initial_seed(streams: Streams) -> int:
    """Seed of torch's own generator, from which the initial weights are drawn."""
    return int(streams.generator("weights").integers(np.iinfo(np.int64).max))
