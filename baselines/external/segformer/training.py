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
from oysterbench_baselines.external.segformer.network import SegFormer, SegFormerSettings, described, model_of
from oysterbench_baselines.learning.augment import Augmentation
from oysterbench_baselines.learning.batches import Mixture, initial_seed, make_batch
from oysterbench_baselines.learning.checkpoint import Checkpoint
from oysterbench_baselines.learning.loop import FitSettings, Progress, fit
from oysterbench_baselines.learning.losses import mask_loss
from oysterbench_baselines.learning.samples import LabelledDataset
from oysterbench_baselines.unet.calibration import kept_back, names_digest
from oysterbench_baselines.unet.calibration import measured as calibrated
from oysterbench_baselines.unet.views import Look


@dataclass(frozen=True)
class TrainingSettings:
    """batch: crops per step; measured: images are held out to calibrate the trained network. AdamW and its decay are
    the authors'; their learning rate, 6e-5, is for a pretrained encoder and too low for random weights."""

    batch: int = 8
    measured: bool = True
    network: SegFormerSettings = field(default_factory=SegFormerSettings)
    augmentation: Augmentation = field(default_factory=Augmentation)
    fit: FitSettings = field(default_factory=lambda: FitSettings(steps=2000, learning_rate=1e-3))


def identity(
    settings: TrainingSettings, data: Mapping[str, Any], seed: int, device: torch.device, kept: LabelledSet
) -> dict[str, Any]:
    """Identity of a training, all that determines the weights, as plain values. data: digests of the data, by purpose;
    kept: the images held out."""
    plain = dataclasses.asdict(settings) | {"network": described(settings.network)}
    plain["augmentation"]["zoom"] = list(settings.augmentation.zoom)
    found = {"method": "segformer", "settings": plain, "data": dict(data), "seed": seed, "device": device.type}
    return {**found, "held_out": names_digest(kept)}


def train(
    labelled: LabelledSet,
    path: Path,
    settings: TrainingSettings,
    seed: int,
    device: torch.device,
    progress: Progress = lambda done, total: None,
    loading: Progress = lambda done, total: None,
    measuring: Progress = lambda done, total: None,
    again: bool = False,
) -> Checkpoint:
    """Train on a set, or resume from the checkpoint at `path`; then calibrate the network on the images held out, as
    `unet.training` does. loading, measuring: called with the number of images read, and measured on. again: start over.
    Raises LabelError where the set is empty."""
    if not len(labelled):
        raise LabelError(f"{labelled.name}: expected images to train on, got none")
    learnt_from, kept = kept_back(labelled)
    dataset = LabelledDataset(learnt_from, settings.network.scale).load(loading)
    streams = Streams(seed).at("segformer")
    mixture = Mixture([dataset], [settings.batch])
    checkpoint = fit(
        lambda: SegFormer(settings.network),
        described(settings.network),
        lambda step: make_batch(mixture, settings.augmentation, streams, step),
        mask_loss,
        settings.fit,
        identity(settings, {labelled.name: labelled.digest()}, seed, device, kept),
        path,
        device,
        initial_seed(streams),
        progress,
        again,
    )
    if not checkpoint.measured:
        model = model_of(checkpoint, path, device)
        found = calibrated(kept, lambda pixels: Look(model.logits(pixels)), measuring)
        checkpoint.measured = {"calibration": dataclasses.asdict(found)}
        checkpoint.write(path)
    return checkpoint
