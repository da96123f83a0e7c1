"""The networks: U-Nets (Ronneberger et al. 2015) with group normalisation; a small one, and one whose way down has
learnt on ImageNet."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Self

import torch
from torch import nn
from torch.nn import functional

from oysterbench_baselines.learning.efficientnet import EfficientNetLite, pretrained

OUTPUTS = ("oyster", "depth", "live")
"""What the channels of the prediction are logits of; depth: into an oyster, see `learning.samples.depths`; live: that
an oyster is, of networks that tell."""

CENTRES = 3
"""Planes after those, in training: x and y from each pixel to the centre of its oyster, and the radius of that."""


@dataclass(frozen=True)
class UNetworkSettings:
    """depth: levels, each half the size of the one before; base: channels of the first, doubled from level to level;
    groups: of channels that are normalised together. scale: of an image, at which it is looked at; side: px, to which
    its longer side is brought instead, where it is not 0. encoder: in `efficientnet.VARIANTS`, which takes the place of
    depth and base. states: whether it tells live oysters from dead ones. centres: whether it also learns, for each
    pixel of an oyster, where the centre of that is and how large it is (`learning.losses.centre_error`): nothing is
    made of that later, but what knows it draws oysters apart that touch."""

    depth: int = 4
    base: int = 16
    groups: int = 4
    scale: float = 0.5
    side: int = 0
    encoder: str = ""
    states: bool = False
    centres: bool = False

    @property
    def outputs(self) -> int:
        """How many of `OUTPUTS` it has."""
        return len(OUTPUTS) if self.states else 2

    @property
    def learnt(self) -> int:
        """Planes of the head: the outputs, or all of them and those that there are in training only."""
        return len(OUTPUTS) + CENTRES if self.centres else self.outputs

    @property
    def multiple(self) -> int:
        """Of pixels, that width and height of what the network is given must be."""
        return 32 if self.encoder else 1 << (self.depth - 1)


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
    """(B, 3, h, w) standardised pixels to (B, K, h, w) logits (`OUTPUTS`); h and w are multiples of 2^(depth - 1). In
    training there are `CENTRES` more planes, where the settings say so."""

    def __init__(self, settings: UNetworkSettings) -> None:
        super().__init__()
        widths = [settings.base * 2**level for level in range(settings.depth)]
        self.down = nn.ModuleList(
            Block(inputs, outputs, settings.groups) for inputs, outputs in zip([3, *widths], widths, strict=False)
        )
        self.grow = nn.ModuleList(nn.ConvTranspose2d(2 * width, width, 2, stride=2) for width in reversed(widths[:-1]))
        self.up = nn.ModuleList(Block(2 * width, width, settings.groups) for width in reversed(widths[:-1]))
        self.head, self.outputs = nn.Conv2d(widths[0], settings.learnt, 1), settings.outputs

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
        return prediction if self.training else prediction[:, : self.outputs]


WIDTHS = (96, 64, 48, 32)
"""Channels on the way up, at strides 16, 8, 4 and 2."""
CONTRAST = 0.45
"""Deviation of the pixels that the encoder has learnt from, in its units; those of standardised pictures have 1."""


class PretrainedUNetwork(nn.Module):
    """The same answers, at strides down to 2 and enlarged; h and w are multiples of 32. begun: with ImageNet's weights,
    and not with random ones that others are to take the place of."""

    def __init__(self, settings: UNetworkSettings, begun: bool = False) -> None:
        super().__init__()
        self.encoder = pretrained(settings.encoder) if begun else EfficientNetLite(settings.encoder)
        deep, beside = self.encoder.channels[-1], reversed(self.encoder.channels[:-1])
        self.up = nn.ModuleList()
        for channels, width in zip(beside, WIDTHS, strict=True):
            self.up.append(Block(deep + channels, width, settings.groups))
            deep = width
        self.head, self.outputs = nn.Conv2d(deep, settings.learnt, 1), settings.outputs

    def train(self, mode: bool = True) -> Self:
        """In training the way up has its values plane by plane, for prediction pixel by pixel, as the encoder always
        has. On a processor that is faster, but for the gradient of the weights of a convolution of 3 x 3, which takes
        four times as long."""
        super().train(mode)
        for part in (self.up, self.head):
            part.to(memory_format=torch.contiguous_format if mode else torch.channels_last)  # type: ignore[call-overload]
        return self

    def forward(self, pixels: torch.Tensor) -> torch.Tensor:
        """See the class."""
        *levels, found = self.encoder.features(CONTRAST * pixels)
        for block, beside in zip(self.up, reversed(levels), strict=True):
            found = functional.interpolate(found, size=beside.shape[-2:], mode="nearest")
            found = torch.cat([beside, found], dim=1)
            found = block(found.contiguous() if self.training else found)
        planes = self.head(found) if self.training else self.head(found)[:, : self.outputs]
        return functional.interpolate(planes, size=pixels.shape[-2:], mode="bilinear", align_corners=False)


def build_network(settings: UNetworkSettings, begun: bool = False) -> nn.Module:
    """Of either kind; begun: see `PretrainedUNetwork`."""
    return PretrainedUNetwork(settings, begun) if settings.encoder else UNetwork(settings)


def kind_of(network: Mapping[str, Any]) -> str:
    """Name of the trainings of such a network, as a checkpoint describes it."""
    return "unet" if network.get("encoder") else "unet_small"
