"""Training of the network: a smaller one of `unet`, on images at a quarter of their size."""

from __future__ import annotations

from dataclasses import dataclass, field

from oysterbench_baselines.learning.loop import FitSettings
from oysterbench_baselines.unet.network import UNetworkSettings
from oysterbench_baselines.unet.training import UNetSettings


@dataclass(frozen=True)
class MovingSettings(UNetSettings):
    """Settings of the training. The defaults take 6 minutes on one CPU core, and a mask of 640x480 some 15 ms."""

    network: UNetworkSettings = field(default_factory=lambda: UNetworkSettings(base=8, scale=0.25))
    measured: bool = False
    fit: FitSettings = field(default_factory=lambda: FitSettings(steps=1500))
