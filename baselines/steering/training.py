"""Training of the network on examples, in which the cost of every command is known, not only which one is best."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch.nn import functional

from oysterbench.core.errors import LabelError
from oysterbench.core.streams import Streams
from oysterbench_baselines.learning.batches import initial_seed
from oysterbench_baselines.learning.checkpoint import Checkpoint
from oysterbench_baselines.learning.loop import FitSettings, Progress, channels_last, fit
from oysterbench_baselines.steering.augment import SteeringAugmentation, augmented
from oysterbench_baselines.steering.examples import Floats, TrainingExamples
from oysterbench_baselines.steering.model import described, is_symmetric
from oysterbench_baselines.steering.network import SteeringNetwork, SteeringNetworkSettings

LEAST_STAKE = 1.0
"""Lower limit of the oysters that the median turn loses: where nothing is at stake, nothing is learnt."""

Batch = tuple[torch.Tensor, torch.Tensor, torch.Tensor, torch.Tensor, torch.Tensor]
"""Pixels (B, 3, h, w), senses (B, SENSES), looked (B, 1, *memory.SHAPE), losses of turns of yaw (B, Y) and of
pitch (B, P) (`losses_of`), float32."""


@dataclass(frozen=True)
class SteeringSettings:
    """Settings of a training. batch: examples per step. temperature: the loss at which a command is still almost as
    likely as the best (see `losses_of`, `cost`). from_rollout: share of a batch drawn from rollouts, where there are
    any: they are few, and show where a policy ends up."""

    batch: int = 32
    temperature: float = 1.0
    from_rollout: float = 0.5
    network: SteeringNetworkSettings = field(default_factory=SteeringNetworkSettings)
    augmentation: SteeringAugmentation = field(default_factory=SteeringAugmentation)
    fit: FitSettings = field(default_factory=lambda: FitSettings(steps=2000, learning_rate=2e-3))


def identity(
    settings: SteeringSettings, data: Mapping[str, Any], seed: int, begun: Checkpoint | None = None
) -> dict[str, Any]:
    """Identity of a training, all that determines the weights, as plain values. data: digests of the data, by name;
    begun: the training from whose weights it starts."""
    found = {"method": "steering", "settings": _plain(dataclasses.asdict(settings)), "data": dict(data), "seed": seed}
    if begun is None:
        return found
    return {**found, "begun": {**begun.identity, "steps": begun.step, "weights": begun.digest()}}


def make_batch(examples: TrainingExamples, settings: SteeringSettings, streams: Streams, step: int) -> Batch:
    """Make the batch of a step from randomly drawn examples, each with a random stream of its own."""
    augmentation = settings.augmentation
    if not is_symmetric(examples.task.yaw_deg):
        augmentation = dataclasses.replace(augmentation, flip=0.0)
    rows = []
    for k in range(settings.batch):
        rng = streams.generator("lesson", step, k)
        n = _drawn(examples, settings.from_rollout, rng)
        rows.append(augmented(*examples[n], augmentation, rng))
    pixels, senses, looked, action_values = (np.stack(part) for part in zip(*rows, strict=True))
    parts = (pixels.transpose(0, 3, 1, 2), senses, looked[:, None], *losses_of(action_values))
    shown, told, seen, yaw, pitch = (torch.from_numpy(np.ascontiguousarray(part)) for part in parts)
    return shown.contiguous(memory_format=torch.channels_last), told, seen, yaw, pitch


def _drawn(examples: TrainingExamples, from_rollout: float, rng: np.random.Generator) -> int:
    """Draw the index of an example; where there are both kinds, one of a rollout with probability `from_rollout`."""
    kinds = [np.flatnonzero(~examples.from_rollout), np.flatnonzero(examples.from_rollout)]
    kind = int(rng.random() < from_rollout) if all(map(len, kinds)) else int(len(kinds[1]) > 0)
    return int(kinds[kind][rng.integers(len(kinds[kind]))])


def losses_of(action_values: Floats) -> tuple[Floats, Floats]:
    """Compute what turns of yaw (B, Y) and of pitch (B, P) lose against the best command, each combined with the best
    turn of the other axis, from the values of commands (B, Y, P).

    Losses are in units of the median over the turns of an axis: oysters are many on one reef and few on another, and a
    policy has to steer over both; and unlike the mean, the median does not grow with the cost of the worst turns.
    """
    lost = action_values.max(axis=(1, 2), keepdims=True) - action_values
    yaw, pitch = lost.min(axis=2), lost.min(axis=1)
    yaw, pitch = (part / np.maximum(np.median(part, axis=1, keepdims=True), LEAST_STAKE) for part in (yaw, pitch))
    return yaw, pitch


def cost(logits: torch.Tensor, lost: torch.Tensor, settings: SteeringSettings) -> torch.Tensor:
    """Cross-entropy of logits (B, K) with softmax(-lost / temperature), where lost (B, K) is what the classes lose.
    Classes as good as the best count as equally right, and a miss costs what it loses."""
    return functional.cross_entropy(logits, (-lost / settings.temperature).softmax(1))


def train(
    examples: TrainingExamples,
    path: Path,
    settings: SteeringSettings,
    seed: int,
    progress: Progress = lambda done, total: None,
    begun: Checkpoint | None = None,
    data: Mapping[str, Any] | None = None,
    again: bool = False,
) -> Checkpoint:
    """Train on examples, or resume from the checkpoint at `path`. begun: a training from whose weights this one starts;
    data: identity of the examples, by default their digest; again: start over. Raises LabelError where there are no
    examples."""
    if not len(examples):
        raise LabelError("steering: expected views to train on, got none")
    streams = Streams(seed).at("steering")
    task = examples.task

    def make() -> torch.nn.Module:
        network = SteeringNetwork(settings.network, len(task.yaw_deg), len(task.pitch_deg))
        if begun is not None:
            network.load_state_dict(begun.weights)
        return channels_last(network)

    def loss(model: torch.nn.Module, *batch: torch.Tensor) -> torch.Tensor:
        *shown, yaw_lost, pitch_lost = batch
        yaw, pitch = model(*shown)
        return cost(yaw, yaw_lost, settings) + cost(pitch, pitch_lost, settings)

    return fit(
        make,
        described(settings.network, task),
        lambda step: make_batch(examples, settings, streams, step),
        loss,
        settings.fit,
        identity(settings, data or {examples.name: examples.digest()}, seed, begun),
        path,
        torch.device("cpu"),
        initial_seed(streams),
        progress,
        again,
    )


def _plain(value: Any) -> Any:
    """Convert tuples to lists, as a checkpoint returns them."""
    if isinstance(value, Mapping):
        return {key: _plain(part) for key, part in value.items()}
    return [_plain(part) for part in value] if isinstance(value, tuple | list) else value
