"""Training of the network through the tracking that its maps are for."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import torch

from oysterbench.core.streams import Streams
from oysterbench_baselines.gtsam_vi_learned.correspondence import Footage
from oysterbench_baselines.gtsam_vi_learned.lucas_kanade import TrackingSettings, follow, sample
from oysterbench_baselines.gtsam_vi_learned.model import described
from oysterbench_baselines.gtsam_vi_learned.network import MapNetwork, MapNetworkSettings
from oysterbench_baselines.gtsam_vi_learned.pairs import NAME, Pairs, PairSettings
from oysterbench_baselines.learning.batches import initial_seed
from oysterbench_baselines.learning.checkpoint import Checkpoint
from oysterbench_baselines.learning.loop import FitSettings, Progress, channels_last, fit

LEAST_PX = 0.05
"""Added to errors, px: the ground truth itself is no more accurate."""


@dataclass(frozen=True)
class MapTrainingSettings:
    """Settings of the training.

    batch: pairs per step. tracked: points of a pair, corners first, from which maps are learnt; errors are learnt from
    all of them. good_px: error beyond which a point is missed, and costs little more the farther off it is. coarse:
    weight of the end points on each coarser level relative to those in the full image.
    """

    batch: int = 6
    tracked: int = 16
    good_px: float = 0.3
    coarse: float = 0.3
    network: MapNetworkSettings = field(default_factory=MapNetworkSettings)
    tracking: TrackingSettings = field(default_factory=TrackingSettings)
    pairs: PairSettings = field(default_factory=PairSettings)
    fit: FitSettings = field(default_factory=lambda: FitSettings(steps=2000, learning_rate=1.5e-3, threads=1))


def loss_of(
    network: torch.nn.Module,
    before: torch.Tensor,
    after: torch.Tensor,
    points: torch.Tensor,
    targets: torch.Tensor,
    starts: torch.Tensor,
    off: torch.Tensor,
    known: torch.Tensor,
    settings: MapTrainingSettings,
) -> torch.Tensor:
    """Loss of a batch of pairs (`Batch`).

    For the expected errors: the squared difference to the logarithm of the tracking error. For the maps:
    log(1 + e / good_px) of the error e of tracking in them, which hardly depends on how far off a miss is; weighted by
    1 / (1 + s), s the error that the network expects there, px: where it is large nothing can be tracked, and the maps
    need not try.
    """
    maps, log_error = network(torch.cat([before, after]))
    first, second = maps.chunk(2)
    expected = sample(log_error.chunk(2)[0], (points - 1.5) / 4)[:, 0]
    surprise = (expected - (off + LEAST_PX).log()).square()
    few = slice(settings.tracked)
    ends = follow(first, second, points[:, few], starts[:, few], settings.tracking)
    errors = ((ends - targets[:, few]).square().sum(-1) + LEAST_PX**2).sqrt()
    levels = torch.tensor([settings.coarse] * (len(errors) - 1) + [1.0])[:, None, None]
    missed = (levels * torch.log1p(errors / settings.good_px)).sum(dim=0) / (1 + expected[:, few].detach().exp())
    return _mean(surprise, known) + _mean(missed, known[:, few])


def _mean(values: torch.Tensor, known: torch.Tensor) -> torch.Tensor:
    return (values * known).sum() / known.sum().clamp(min=1)


def train(
    footages: Sequence[Footage],
    path: Path,
    settings: MapTrainingSettings,
    seed: int,
    progress: Progress = lambda done, total: None,
    again: bool = False,
) -> Checkpoint:
    """Train on rendered sequences, or resume from the checkpoint at `path`; with `again`, start over."""
    pairs, streams = Pairs(footages, settings.pairs), Streams(seed).at(NAME)

    def loss(network: torch.nn.Module, *batch: torch.Tensor) -> torch.Tensor:
        before, after, points, targets, starts, off, known = batch
        return loss_of(network, before, after, points, targets, starts, off, known, settings)

    return fit(
        lambda: channels_last(MapNetwork(settings.network)),
        described(settings.network),
        lambda step: pairs.batch(streams, step, settings.batch),
        loss,
        settings.fit,
        identity(settings, {footage.name: footage.digest for footage in footages}, seed),
        path,
        torch.device("cpu"),
        initial_seed(streams),
        progress,
        again,
    )


def identity(settings: MapTrainingSettings, data: Mapping[str, Any], seed: int) -> dict[str, Any]:
    """What decides the weights, as plain values. data: digests of the data, by what they are for."""
    return {"method": NAME, "settings": _plain(dataclasses.asdict(settings)), "data": dict(data), "seed": seed}


def _plain(value: Any) -> Any:
    """Tuples as lists, as a checkpoint gives them back."""
    if isinstance(value, Mapping):
        return {key: _plain(part) for key, part in value.items()}
    return [_plain(part) for part in value] if isinstance(value, tuple | list) else value
