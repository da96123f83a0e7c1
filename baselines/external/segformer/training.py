"""Training the network on labelled images."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import torch

from oysterbench.annotations import LabelledSet
from oysterbench.core.errors import LabelError
from oysterbench.core.streams import Streams
from oysterbench_baselines.external.segformer.network import SegFormer, SegFormerSettings, described
from oysterbench_baselines.learning.augment import Augmentation
from oysterbench_baselines.learning.batches import Mixture, initial_seed, make_batch
from oysterbench_baselines.learning.checkpoint import Checkpoint
from oysterbench_baselines.learning.loop import FitSettings, Progress, fit
from oysterbench_baselines.learning.losses import mask_loss
from oysterbench_baselines.learning.samples import LabelledDataset


@dataclass(frozen=True)
class TrainingSettings:
    """batch: crops of one step. Of the authors' recipe: AdamW and its decay. Their learning rate, 6e-5, is for an
    encoder that has seen ImageNet; from random weights it is too low."""

    batch: int = 8
    network: SegFormerSettings = field(default_factory=SegFormerSettings)
    augmentation: Augmentation = field(default_factory=Augmentation)
    fit: FitSettings = field(default_factory=lambda: FitSettings(steps=2000, learning_rate=1e-3))


def identity(settings: TrainingSettings, data: Mapping[str, Any], seed: int, device: torch.device) -> dict[str, Any]:
    """What decides the weights, as plain values. data: digests of the data, by what they are for."""
    plain = dataclasses.asdict(settings) | {"network": described(settings.network)}
    plain["augmentation"]["zoom"] = list(settings.augmentation.zoom)
    return {"method": "segformer", "settings": plain, "data": dict(data), "seed": seed, "device": device.type}


def train(
    labelled: LabelledSet,
    path: Path,
    settings: TrainingSettings,
    seed: int,
    device: torch.device,
    progress: Progress = lambda done, total: None,
    loading: Any = lambda done, total: None,
    again: bool = False,
) -> Checkpoint:
    """Train on a set, or go on where `path` was left; with `again`, start over. loading: is told how many images have
    been read."""
    if not len(labelled):
        raise LabelError(f"{labelled.name}: expected images to train on, got none")
    dataset = LabelledDataset(labelled, settings.network.scale).load(loading)
    streams = Streams(seed).at("segformer")
    mixture = Mixture([dataset], [settings.batch])
    return fit(
        lambda: SegFormer(settings.network),
        described(settings.network),
        lambda step: make_batch(mixture, settings.augmentation, streams, step),
        mask_loss,
        settings.fit,
        identity(settings, {labelled.name: labelled.digest()}, seed, device),
        path,
        device,
        initial_seed(streams),
        progress,
        again,
    )
