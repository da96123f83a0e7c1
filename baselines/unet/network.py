"""The network: a U-Net (Ronneberger et al. 2015), small, with group normalisation."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import nn

OUTPUTS = ("oyster", "core")
"""What the channels of the prediction are logits of."""


@dataclass(frozen=True)
class UNetworkSettings:
    """depth: levels, each half the size of the one before; base: channels of the first, doubled from level to level;
    groups: of channels that are normalised together. scale: of an image, at which it is looked at."""

    depth: int = 4
    base: int = 16
    groups: int = 4
    scale: float = 0.5

    @property
    def multiple(self) -> int:
        """Of pixels, that width and height of what the network is given must be."""
        return 1 << (self.depth - 1)


class Block(nn.Sequential):
    """Twice: 3 x 3 convolution, normalisation, ReLU."""

    def __init__(self, inputs: int, outputs: int, groups: int) -> None:
        layers: list[nn.Module] = []
        for count in (inputs, outputs):
            layers += [
                nn.Conv2d(count, outputs, 3, padding=1, bias=False),
                nn.GroupNorm(groups, outputs),
                nn.ReLU(inplace=True),
            ]
        super().__init__(*layers)


class UNetwork(nn.Module):
    """(B, 3, h, w) standardised pixels to (B, 2, h, w) logits (`OUTPUTS`); h and w are multiples of 2^(depth - 1)."""

    def __init__(self, settings: UNetworkSettings) -> None:
        super().__init__()
        widths = [settings.base * 2**level for level in range(settings.depth)]
        self.down = nn.ModuleList(
            Block(inputs, outputs, settings.groups) for inputs, outputs in zip([3, *widths], widths, strict=False)
        )
        self.grow = nn.ModuleList(nn.ConvTranspose2d(2 * width, width, 2, stride=2) for width in reversed(widths[:-1]))
        self.up = nn.ModuleList(Block(2 * width, width, settings.groups) for width in reversed(widths[:-1]))
        self.head = nn.Conv2d(widths[0], len(OUTPUTS), 1)

    def forward(self, pixels: torch.Tensor) -> torch.Tensor:
        """See the class."""
        levels = []
        found = pixels
        for level, block in enumerate(self.down):
            found = block(found if level == 0 else nn.functional.max_pool2d(found, 2))
            levels.append(found)
        for grow, block, beside in zip(self.grow, self.up, reversed(levels[:-1]), strict=True):
            found = block(torch.cat([beside, grow(found)], dim=1))
        prediction: torch.Tensor = self.head(found)
        return prediction
