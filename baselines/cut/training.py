"""The training: a discriminator and a generator in turn, deterministic, resumable at any step."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch

from oysterbench.annotations import LabelledSet
from oysterbench.core.errors import MethodError
from oysterbench.core.streams import Streams
from oysterbench_baselines.cut.losses import looks, patch_nce
from oysterbench_baselines.cut.networks import Discriminator, Generator, Projections
from oysterbench_baselines.cut.pictures import Picture, draw_crop, read_pictures
from oysterbench_baselines.cut.settings import CutSettings
from oysterbench_baselines.learning.batches import initial_seed
from oysterbench_baselines.learning.checkpoint import Checkpoint
from oysterbench_baselines.learning.loop import Progress, Trainer, be_deterministic, run_training, weights_of

BETAS = (0.5, 0.999)  # of Adam
KEEP_S = 60.0
"""Time between two checkpoints, seconds: the most that a kill costs."""
TERMS = ("discriminator", "looks", "content", "identity")
"""Losses recorded for each step: the discriminator's, and the generator's for looking real, for keeping the content,
and for leaving real images unchanged (0 where that is not used)."""


@dataclass
class Adversaries:
    """Generator, discriminator and projections with their optimisers. pictures: images of source and target."""

    settings: CutSettings
    streams: Streams
    device: torch.device
    pictures: Sequence[Sequence[Picture]] = ()

    def __post_init__(self) -> None:
        torch.manual_seed(initial_seed(self.streams))
        self.generator = Generator(self.settings).to(self.device)
        self.discriminator = Discriminator(self.settings).to(self.device)
        self.projections = Projections(self.generator, self.settings).to(self.device)
        parts = self.parts()
        rate = self.settings.learning_rate
        self.optimisers = {key: torch.optim.Adam(part.parameters(), rate, BETAS) for key, part in parts.items()}

    def parts(self) -> dict[str, torch.nn.Module]:
        """The networks by name."""
        return {
            "generator": self.generator,
            "discriminator": self.discriminator,
            "projections": self.projections,
        }

    def step(self, number: int) -> list[float]:
        """Update generator and discriminator on the crops of a step; returns the losses, in the order of `TERMS`."""
        given, wanted = draw_pair(self.pictures, self.settings.crop, self.streams, number)
        return self.turn(given.to(self.device), wanted.to(self.device), number)

    def turn(self, source: torch.Tensor, target: torch.Tensor, number: int) -> list[float]:
        """Update both on images (1, 3, h, w); returns the losses, in the order of `TERMS`. Raises MethodError where one
        is not finite."""
        for optimiser in self.optimisers.values():
            optimiser.param_groups[0]["lr"] = self.settings.rate(number)
        mirrored = self.settings.flip and self.streams.generator("mirror", number).random() < 0.5
        given = source.flip(3) if mirrored else source
        both = self.generator(torch.cat([given, target]) if self.settings.identity else given)
        translated = both[:1]

        self.discriminator.requires_grad_(True)
        opposed = (looks(self.discriminator(translated.detach()), False) + looks(self.discriminator(target), True)) / 2
        self._descend(opposed, "discriminator")

        self.discriminator.requires_grad_(False)
        real = looks(self.discriminator(translated), True)
        content = self._content(translated, source, ("source", number), mirrored)
        identity = torch.zeros(())
        if self.settings.identity:
            identity = self._content(both[1:], target, ("target", number))
        share = 0.5 if self.settings.identity else 1.0
        total = real + self.settings.nce_weight * share * (content + identity.to(content))
        found = [float(value.detach()) for value in (opposed, real, content, identity)]
        if not all(math.isfinite(value) for value in found):
            terms = ", ".join(f"{name} {value:g}" for name, value in zip(TERMS, found, strict=True))
            raise MethodError(f"the loss is not finite after {number} steps ({terms}); try a lower learning rate")
        self._descend(total, "generator", "projections")
        return found

    def _descend(self, loss: torch.Tensor, *names: str) -> None:
        for name in names:
            self.optimisers[name].zero_grad(set_to_none=True)
        loss.backward()  # type: ignore[no-untyped-call]
        for name in names:
            self.optimisers[name].step()

    def _content(
        self, translated: torch.Tensor, original: torch.Tensor, name: tuple[str, int], mirrored: bool = False
    ) -> torch.Tensor:
        """PatchNCE between an image and its translation; where that is of the mirrored image, its features are mirrored
        back before they are compared."""
        settings = self.settings
        seen = self.generator.encode(translated, settings.layers)
        if mirrored:
            seen = {key: values.flip(3) for key, values in seen.items()}
        with torch.no_grad():
            keys = self.generator.encode(original, settings.layers)
        places = {key: self._places(values.shape[2] * values.shape[3], (*name, key)) for key, values in keys.items()}
        queries = self.projections(seen, places)
        with torch.no_grad():
            against = self.projections(keys, places)
        return patch_nce(queries, against, settings.temperature)

    def _places(self, count: int, name: tuple[str | int, ...]) -> torch.Tensor:
        """Draw places (P,) out of `count`, each at most once."""
        chosen = self.streams.generator("places", *name).permutation(count)[: self.settings.patches]
        return torch.from_numpy(chosen).to(self.device)

    def state(self) -> tuple[dict[str, Any], dict[str, Any], dict[str, Any]]:
        """See `Trainer`. The random state is empty: all random numbers depend on the step number alone."""
        weights = {key: weights_of(part) for key, part in self.parts().items()}
        return weights, {key: optimiser.state_dict() for key, optimiser in self.optimisers.items()}, {}

    def load(self, checkpoint: Checkpoint) -> None:
        """Restore the state from a checkpoint."""
        for key, part in self.parts().items():
            part.load_state_dict(checkpoint.weights[key])
            self.optimisers[key].load_state_dict(checkpoint.optimiser[key])


def train(
    source: LabelledSet,
    target: LabelledSet,
    settings: CutSettings,
    path: Path,
    seed: int = 0,
    device: torch.device | None = None,
    progress: Progress = lambda done, total: None,
    keep: Callable[[Checkpoint], None] = lambda checkpoint: None,
    keep_s: float = KEEP_S,
) -> Checkpoint:
    """Learn to make images of `source` look like those of `target`, or resume from the checkpoint at `path`.

    keep is called after each checkpoint is written. `losses` of the checkpoint are the `TERMS` of all steps in
    sequence. Raises LabelError for images unfit for training, MethodError where `path` holds another training.
    """
    device = device or torch.device("cpu")
    be_deterministic(settings.threads, device)
    sides = {"source": source.digest(), "target": target.digest()}
    identity = {"settings": plain(settings), **sides, "seed": seed, "device": device.type}

    def begin() -> Trainer:
        pictures = [read_pictures(side, settings.crop, settings.scale) for side in (source, target)]
        return Adversaries(settings, Streams(seed).at("cut"), device, pictures)

    return run_training(begin, plain(settings), identity, settings.steps, path, progress, keep, keep_s)


def draw_pair(
    pictures: Sequence[Sequence[Picture]], crop: int, streams: Streams, number: int
) -> tuple[torch.Tensor, torch.Tensor]:
    """Draw a crop of the source and one of the target for a step, independent of the steps done before."""
    one, other = (draw_crop(side, crop, streams.generator("crop", number, k)) for k, side in enumerate(pictures))
    return one, other


def plain(settings: CutSettings) -> dict[str, Any]:
    """Settings as stored in a checkpoint."""
    return {key: list(value) if isinstance(value, tuple) else value for key, value in asdict(settings).items()}


def curves(checkpoint: Checkpoint) -> np.ndarray:
    """Losses (steps, TERMS) of a training, float64."""
    return np.array(checkpoint.losses, dtype=float).reshape(-1, len(TERMS))
