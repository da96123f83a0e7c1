"""Training the network on examples: what a command would cost is known for each, not only which one is best."""

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
"""Oysters that a turn of the middle is taken to lose at least: where nothing is at stake, nothing is learnt."""

Batch = tuple[torch.Tensor, torch.Tensor, torch.Tensor, torch.Tensor, torch.Tensor]
"""Pixels (B, 3, h, w), senses (B, SENSES), looked (B, 1, *memory.SHAPE), what turns of yaw (B, Y) and of
pitch (B, P) lose (`losses_of`), float32."""


@dataclass(frozen=True)
class SteeringSettings:
    """batch: examples of one step. temperature: what a command may lose and still be almost as likely as the best (see
    `losses_of`, `cost`). from_rollout: share of a batch that is of rollouts, where there are any: they are few, and
    show where a policy gets to."""

    batch: int = 32
    temperature: float = 1.0
    from_rollout: float = 0.5
    network: SteeringNetworkSettings = field(default_factory=SteeringNetworkSettings)
    augmentation: SteeringAugmentation = field(default_factory=SteeringAugmentation)
    fit: FitSettings = field(default_factory=lambda: FitSettings(steps=2000, learning_rate=2e-3))


def identity(settings: SteeringSettings, data: Mapping[str, Any], seed: int) -> dict[str, Any]:
    """What decides the weights, as plain values. data: digests of the data, by what they are for."""
    return {"method": "steering", "settings": _plain(dataclasses.asdict(settings)), "data": dict(data), "seed": seed}


def make_batch(examples: TrainingExamples, settings: SteeringSettings, streams: Streams, step: int) -> Batch:
    """Training examples drawn at random, each with a stream of its own."""
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
    """Number of an example, of a rollout with that chance where there are both kinds."""
    kinds = [np.flatnonzero(~examples.from_rollout), np.flatnonzero(examples.from_rollout)]
    kind = int(rng.random() < from_rollout) if all(map(len, kinds)) else int(len(kinds[1]) > 0)
    return int(kinds[kind][rng.integers(len(kinds[kind]))])


def losses_of(action_values: Floats) -> tuple[Floats, Floats]:
    """What turns of yaw (B, Y) and of pitch (B, P) lose against the best command, each with the best turn of the other
    axis, of the values of commands (B, Y, P).

    In medians over the turns of an axis: oysters are many on one reef and few on another, and a policy has to steer
    over both; and the median, unlike the mean, does not grow with what the worst turns cost.
    """
    lost = action_values.max(axis=(1, 2), keepdims=True) - action_values
    yaw, pitch = lost.min(axis=2), lost.min(axis=1)
    yaw, pitch = (part / np.maximum(np.median(part, axis=1, keepdims=True), LEAST_STAKE) for part in (yaw, pitch))
    return yaw, pitch


def cost(logits: torch.Tensor, lost: torch.Tensor, settings: SteeringSettings) -> torch.Tensor:
    """Of logits (B, K), given what the classes lose (B, K): cross-entropy with softmax(-lost / temperature). Classes
    that are as good as the best are as right, and a miss costs what it loses."""
    return functional.cross_entropy(logits, (-lost / settings.temperature).softmax(1))


def train(
    examples: TrainingExamples,
    path: Path,
    settings: SteeringSettings,
    seed: int,
    progress: Progress = lambda done, total: None,
    begun: Checkpoint | None = None,
    data: Mapping[str, Any] | None = None,
) -> Checkpoint:
    """Train on examples, or go on where `path` was left. begun: a training whose weights it begins with; data: what
    the examples are, if not their digest."""
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
        identity(settings, data or {"examples": examples.digest()}, seed),
        path,
        torch.device("cpu"),
        initial_seed(streams),
        progress,
    )


def _plain(value: Any) -> Any:
    """Tuples as lists, as a checkpoint gives them back."""
    if isinstance(value, Mapping):
        return {key: _plain(part) for key, part in value.items()}
    return [_plain(part) for part in value] if isinstance(value, tuple | list) else value
