"""Training of the network on labelled images."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import torch

from oysterbench.annotations import LabelledSet
from oysterbench.core.errors import LabelError
from oysterbench.core.streams import Streams
from oysterbench_baselines.learning.augment import Augmentation
from oysterbench_baselines.learning.batches import Mixture, initial_seed, make_batch
from oysterbench_baselines.learning.checkpoint import Checkpoint, in_half_precision, read_checkpoint
from oysterbench_baselines.learning.loop import FitSettings, Progress, beside, channels_last, fit
from oysterbench_baselines.learning.losses import mask_loss
from oysterbench_baselines.learning.novelty import clips_of, learnt
from oysterbench_baselines.learning.samples import LabelledDataset
from oysterbench_baselines.unet.calibration import LEAST, Calibration, evenly, kept_back, names_digest
from oysterbench_baselines.unet.calibration import measured as calibrated
from oysterbench_baselines.unet.method import DEFAULT_VIEWS
from oysterbench_baselines.unet.model import calibration_of, described, unet_model
from oysterbench_baselines.unet.network import UNetworkSettings, build_network, kind_of

MOST_ALIKE = 800
"""Maximum number of images, evenly spaced, to which the novelty is fitted."""


@dataclass(frozen=True)
class UNetSettings:
    """Settings of a training. batch: crops per step; measured: whether images are held out to calibrate the trained
    network. The defaults take 16 minutes on one CPU core, half of that on two."""

    batch: int = 8
    measured: bool = True
    network: UNetworkSettings = field(default_factory=UNetworkSettings)
    augmentation: Augmentation = field(default_factory=Augmentation)
    fit: FitSettings = field(default_factory=lambda: FitSettings(steps=2000))


def pretrained_settings(encoder: str) -> UNetSettings:
    """Settings for a network with a pretrained encoder: larger crops of larger images, a lower learning rate."""
    return UNetSettings(
        network=UNetworkSettings(groups=8, side=480, encoder=encoder, states=True, centres=True),
        augmentation=Augmentation(crop=320, zoom=(0.4, 1.7), gain=0.35, blur=0.35, blur_px=2.5, veil=0.35),
        fit=FitSettings(steps=1200, learning_rate=1e-3),
    )


BEGUN_RATE, BEGUN_WARM_UP = 6e-4, 10
"""Learning rate and warm-up steps where a training starts from the weights of another: lower, so that what was learnt
there is not lost in the first steps."""
BEGUN_SHARE = 0.5
"""Share of those weights in the final ones (`FitSettings.start`) for networks with a pretrained encoder; not measured
for others."""


def begun_settings(settings: UNetSettings, begun: Checkpoint) -> UNetSettings:
    """Adapt settings to a training that starts from the weights of another and has the same network."""
    network = UNetworkSettings(**{key: value for key, value in begun.network.items() if key != "kind"})
    share = BEGUN_SHARE if network.encoder else 0.0
    fit = dataclasses.replace(settings.fit, learning_rate=BEGUN_RATE, warm_up=BEGUN_WARM_UP, start=share)
    return dataclasses.replace(settings, network=network, fit=fit)


def identity(
    settings: UNetSettings,
    data: Mapping[str, Any],
    seed: int,
    device: torch.device,
    begun: Checkpoint | None = None,
    kept: LabelledSet | None = None,
) -> dict[str, Any]:
    """Identity of a training, all that determines the weights, as plain values. data: digests of the data, by purpose;
    begun: the training from whose weights it starts; kept: the images held out, which it must not have learnt from."""
    plain = dataclasses.asdict(settings)
    plain["augmentation"]["zoom"] = list(settings.augmentation.zoom)
    method = kind_of(plain["network"])
    found = {"method": method, "settings": plain, "data": dict(data), "seed": seed, "device": device.type}
    if kept is not None:
        found["held_out"] = names_digest(kept)
    return found if begun is None else {**found, "begun": {**begun.identity, "steps": begun.step}}


def new_network(settings: UNetworkSettings, begun: Checkpoint | None = None) -> torch.nn.Module:
    """Create a network, with weights drawn from torch's generator and those of ImageNet in a pretrained encoder, or
    with the weights of the training that it starts from."""
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
    loading: Progress = lambda done, total: None,
    measuring: Progress = lambda done, total: None,
    begun: Checkpoint | None = None,
    again: bool = False,
) -> Checkpoint:
    """Train on a set, or resume from the checkpoint at `path`; then measure the trained network (`measure`). loading,
    measuring: called with the number of images read, and measured on. begun: the training from whose weights this one
    starts, of the same network. again: start over. Raises LabelError where the set is empty, and before the first step
    where an image or its label cannot be read."""
    if not len(labelled):
        raise LabelError(f"{labelled.name}: expected images to train on, got none")
    learnt_from, kept = kept_back(labelled) if settings.measured else (labelled, labelled.where(lambda entry: False))
    dataset = LabelledDataset(learnt_from, settings.network.scale, settings.network.side)
    dataset.load(lambda done, total: loading(done, len(labelled)))
    for done, entry in enumerate(kept.entries, start=len(dataset) + 1):
        entry.read()  # a bad label or image is found now, not when the training is done
        loading(done, len(labelled))
    streams = Streams(seed).at("unet")
    wanted = identity(
        settings, {labelled.name: labelled.digest()}, seed, device, begun, kept if settings.measured else None
    )
    if not again and not beside(path).is_file() and _is_whole_of_before(path):
        wanted.pop("held_out", None)
    mixture = Mixture([dataset], [settings.batch])
    checkpoint = fit(
        lambda: new_network(settings.network, begun),
        described(settings.network),
        lambda step: make_batch(mixture, settings.augmentation, streams, step),
        mask_loss,
        settings.fit,
        wanted,
        path,
        device,
        initial_seed(streams),
        progress,
        again,
    )
    if settings.measured and not checkpoint.measured:
        if settings.network.encoder:
            checkpoint.weights = in_half_precision(checkpoint.weights)
        checkpoint.measured = measure(checkpoint, learnt_from, kept, device, measuring, begun)
        checkpoint.write(path)
    return checkpoint


def _is_whole_of_before(path: Path) -> bool:
    """Whether a training is finished and measured, of a version that did not keep which images were held out: nothing
    of it is computed anew, so that they need not be known."""
    known = read_checkpoint(path) if path.is_file() else None
    return known is not None and known.finished and bool(known.measured) and "held_out" not in known.identity


def measure(
    checkpoint: Checkpoint,
    learnt_from: LabelledSet,
    kept: LabelledSet,
    device: torch.device,
    progress: Progress = lambda done, total: None,
    begun: Checkpoint | None = None,
) -> dict[str, Any]:
    """Measure a trained network: its calibration on the images held out, and, with a pretrained encoder, the
    distribution of the training images for novelty (`learning.novelty`). begun: the training from whose weights it
    started, whose calibration it keeps where fewer than `LEAST` images held out show an oyster."""
    model = unet_model(checkpoint, device, DEFAULT_VIEWS)
    before = None if begun is None else calibration_of(begun)
    found: dict[str, Any] = {"calibration": dataclasses.asdict(calibrated(kept, model.look, progress, before))}
    if checkpoint.network["encoder"]:
        taken = evenly([*learnt_from.entries, *kept.entries], MOST_ALIKE)
        alike = []
        for k, entry in enumerate(taken, start=1):
            alike.append(model.alike(entry.read().pixels))
            progress(k, len(taken))
        if len(taken) > 1:
            found["novelty"] = learnt(np.array(alike), clips_of(taken)).state()
    return found


def thresholds_of(checkpoint: Checkpoint, begun: Checkpoint | None = None) -> str:
    """A sentence on what the thresholds of a trained network were measured on. begun: as in `measure`."""
    known = calibration_of(checkpoint)
    if begun is not None and known == calibration_of(begun):
        known_on = f", measured on {known.images} images" if known.images else ""
        few = f"fewer than {LEAST} images held out show an oyster"
        return f"{few}: the thresholds of the initial weights are kept{known_on}"
    if known == Calibration():
        return "no oyster in images held out: thresholds are the default ones, and counts may be far off"
    if not known.images:  # earlier versions did not keep it
        return "thresholds were measured on images held out"
    return f"thresholds were measured on {known.images} image{'s' * (known.images > 1)} held out"
