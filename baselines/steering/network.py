"""The network: from an image, two of the vehicle's senses and the map of what was looked at to two sets of logits."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import nn

from oysterbench_baselines.steering.memory import SHAPE

SENSES = 2
"""Number of senses given to the network in addition to the image (`examples.senses_of`)."""
MAP_CHANNELS = (8, 16)
"""Channels of the two levels that read the map of what was looked at, each half the size of the one before."""


@dataclass(frozen=True)
class SteeringNetworkSettings:
    """Settings of the network. width, height: px, size of its input images. channels: of the levels, each half the size
    of the one before. groups: of channels that are normalised together. columns: channels whose spatial positions are
    kept, as steering depends on where in the image a patch lies; hidden: units between them and the predictions.
    dropout: of hidden units. memory: whether the network is given the map of where the vehicle has already looked."""

    width: int = 96
    height: int = 72
    channels: tuple[int, ...] = (16, 32, 64, 96)
    groups: int = 4
    columns: int = 16
    hidden: int = 128
    dropout: float = 0.3
    memory: bool = True


class Level(nn.Sequential):
    """Level that halves the size: 3 x 3 convolutions with strides 2 and 1, each normalised and followed by ReLU."""

    def __init__(self, inputs: int, outputs: int, groups: int) -> None:
        layers: list[nn.Module] = []
        for count, stride in ((inputs, 2), (outputs, 1)):
            layers += [
                nn.Conv2d(count, outputs, 3, stride=stride, padding=1, bias=False),
                nn.GroupNorm(groups, outputs),
                nn.ReLU(inplace=True),
            ]
        super().__init__(*layers)


class SteeringNetwork(nn.Module):
    """Network from standardised pixels (B, 3, height, width), senses (B, SENSES) and the map of what was looked at (B,
    1, *memory.SHAPE) to logits of yaw (B, Y) and pitch (B, P)."""

    def __init__(self, settings: SteeringNetworkSettings, yaw: int, pitch: int) -> None:
        super().__init__()
        levels = zip((3, *settings.channels), settings.channels, strict=False)
        self.levels = nn.Sequential(*(Level(inputs, outputs, settings.groups) for inputs, outputs in levels))
        self.columns = nn.Sequential(nn.Conv2d(settings.channels[-1], settings.columns, 1), nn.ReLU(inplace=True))
        scale = 2 ** len(settings.channels)
        # Convolutions of stride 2 with this padding round up.
        places = -(-settings.width // scale) * -(-settings.height // scale)
        self.senses = nn.Sequential(nn.Linear(SENSES, settings.groups * 4), nn.ReLU(inplace=True))
        first, second = MAP_CHANNELS
        self.looked = nn.Sequential(
            nn.Conv2d(1, first, 3, stride=2, padding=1),
            nn.ReLU(inplace=True),
            nn.Conv2d(first, second, 3, stride=2, padding=1),
            nn.ReLU(inplace=True),
        )
        self.memory = settings.memory
        remembered = second * -(-SHAPE[0] // 4) * -(-SHAPE[1] // 4)
        self.hidden = nn.Sequential(
            nn.Linear(settings.columns * places + settings.groups * 4 + remembered, settings.hidden),
            nn.ReLU(inplace=True),
            nn.Dropout(settings.dropout),
        )
        self.yaw = nn.Linear(settings.hidden, yaw)
        self.pitch = nn.Linear(settings.hidden, pitch)

    def forward(
        self, pixels: torch.Tensor, senses: torch.Tensor, looked: torch.Tensor
    ) -> tuple[torch.Tensor, torch.Tensor]:
        """See the class."""
        seen = self.columns(self.levels(pixels)).flatten(1)
        if not self.memory:
            looked = torch.zeros_like(looked)
        found = self.hidden(torch.cat([seen, self.senses(senses), self.looked(looked).flatten(1)], dim=1))
        return self.yaw(found), self.pitch(found)
