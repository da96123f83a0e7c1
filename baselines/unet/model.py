"""A trained network, ready to predict."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Any

import torch

from oysterbench.core.errors import MethodError
from oysterbench_baselines.learning.checkpoint import Checkpoint, read_checkpoint
from oysterbench_baselines.learning.loop import channels_last
from oysterbench_baselines.learning.masks import MaskModel
from oysterbench_baselines.unet.network import UNetworkSettings, build_network


def unet_model(checkpoint: Checkpoint, device: torch.device | None = None) -> MaskModel:
    """From a training. Raises MethodError where it is of another network."""
    if checkpoint.network.get("kind") != "unet":
        raise MethodError(f"expected the checkpoint of a unet, got one of {checkpoint.network.get('kind')!r}")
    settings = UNetworkSettings(**{key: value for key, value in checkpoint.network.items() if key != "kind"})
    network = build_network(settings)
    network.load_state_dict(checkpoint.weights)
    device = device or torch.device("cpu")
    return MaskModel(channels_last(network.to(device)).eval(), settings.scale, settings.multiple, device, settings.side)


def read_unet(path: Path, device: torch.device | None = None) -> MaskModel:
    """From a file."""
    return unet_model(read_checkpoint(path), device)


def described(settings: UNetworkSettings) -> dict[str, Any]:
    """What a checkpoint says of the network."""
    return {"kind": "unet", **asdict(settings)}
