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
from oysterbench_baselines.learning.augment import Augmentation
from oysterbench_baselines.learning.batches import Mixture, initial_seed, make_batch
from oysterbench_baselines.learning.checkpoint import Checkpoint
from oysterbench_baselines.learning.loop import FitSettings, Progress, channels_last, fit
from oysterbench_baselines.learning.losses import mask_loss
from oysterbench_baselines.learning.samples import LabelledDataset
from oysterbench_baselines.unet.model import described
from oysterbench_baselines.unet.network import UNetworkSettings, build_network


@dataclass(frozen=True)
class UNetSettings:
    """batch: crops of one step. The defaults take 16 minutes of a processor's core, half of that on two."""

    batch: int = 8
    network: UNetworkSettings = field(default_factory=UNetworkSettings)
    augmentation: Augmentation = field(default_factory=Augmentation)
    fit: FitSettings = field(default_factory=lambda: FitSettings(steps=2000))


def pretrained_settings(encoder: str) -> UNetSettings:
    """Of a network on a pretrained encoder: larger crops of larger pictures, smaller steps."""
    return UNetSettings(
        network=UNetworkSettings(groups=8, side=320, encoder=encoder),
        augmentation=Augmentation(crop=224),
        fit=FitSettings(steps=1000, learning_rate=1e-3),
    )


def identity(settings: UNetSettings, data: Mapping[str, Any], seed: int, device: torch.device) -> dict[str, Any]:
    """What decides the weights, as plain values. data: digests of the data, by what they are for."""
    plain = dataclasses.asdict(settings)
    plain["augmentation"]["zoom"] = list(settings.augmentation.zoom)
    return {"method": "unet", "settings": plain, "data": dict(data), "seed": seed, "device": device.type}


def new_network(settings: UNetworkSettings, begun: Checkpoint | None = None) -> torch.nn.Module:
    """With weights drawn from torch's generator, those of ImageNet in a pretrained encoder, or with those of a training
    that it goes on from."""
    network = channels_last(build_network(settings, begun is None))
    if begun is not None:
        network.load_state_dict(begun.weights)
    return network


def train(
    labelled: LabelledSet,
    path: Path,
    settings: UNetSettings,
    seed: int,
    device: torch.device,
    progress: Progress = lambda done, total: None,
    loading: Any = lambda done, total: None,
) -> Checkpoint:
    """Train on a set, or go on where `path` was left. loading: is told how many images have been read."""
    if not len(labelled):
        raise LabelError(f"{labelled.name}: expected images to train on, got none")
    dataset = LabelledDataset(labelled, settings.network.scale, settings.network.side).load(loading)
    streams = Streams(seed).at("unet")
    mixture = Mixture([dataset], [settings.batch])
    return fit(
        lambda: new_network(settings.network),
        described(settings.network),
        lambda step: make_batch(mixture, settings.augmentation, streams, step),
        mask_loss,
        settings.fit,
        identity(settings, {labelled.name: labelled.digest()}, seed, device),
        path,
        device,
        initial_seed(streams),
        progress,
    )
