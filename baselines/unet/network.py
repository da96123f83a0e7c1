"""The networks: U-Nets (Ronneberger et al. 2015) with group normalisation: a small one, and one whose encoder is
pretrained on ImageNet."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Self

import torch
from torch import nn
from torch.nn import functional

from oysterbench_baselines.learning.efficientnet import EfficientNetLite, pretrained

OUTPUTS = ("oyster", "depth", "live")
"""Channels of the prediction, as logits; depth: inside an oyster, see `learning.samples.depths`; live: that an oyster
is alive, in networks that tell."""

CENTRES = 3
"""Number of further planes in training: x and y from each pixel to the centre of its oyster, and that oyster's
radius."""


@dataclass(frozen=True)
class UNetworkSettings:
    """Settings of a network. depth: number of levels, each half the size of the one before; base: channels of the
    first, doubled from level to level; groups: of channels that are normalised together. scale: at which an image is
    processed; side: px, length of its longer side instead, if not 0. encoder: a key of `efficientnet.VARIANTS`, which
    replaces depth and base. states: whether the network tells live oysters from dead ones. centres: whether it also
    learns, for each pixel of an oyster, the oyster's centre and size (`learning.losses.centre_error`): these are not
    used for predictions, but a network that learns them separates touching oysters better."""

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
        """Number of `OUTPUTS` that the network has."""
        return len(OUTPUTS) if self.states else 2

    @property
    def learnt(self) -> int:
        """Number of planes of the head: the outputs, or all `OUTPUTS` and the planes that exist only in training."""
        return len(OUTPUTS) + CENTRES if self.centres else self.outputs

    @property
    def multiple(self) -> int:
        """Number of pixels of which the width and height of the network's input must be multiples."""
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

    def on_enlarged(self, beside: torch.Tensor, deep: torch.Tensor) -> torch.Tensor:
        """Apply the block to beside (B, c, 2h, 2w), stacked on deep (B, d, h, w) enlarged to twice its size."""
        first, *others = self
        assert isinstance(first, nn.Conv2d)
        found = _convolved(first.weight, beside, deep)
        for layer in others:
            found = layer(found)
        return found


class UNetwork(nn.Module):
    """U-Net from standardised pixels (B, 3, h, w) to logits (B, K, h, w) (`OUTPUTS`); h and w are multiples of
    2^(depth - 1). In training there are `CENTRES` more planes, where the settings say so."""

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
"""Channels of the decoder at strides 16, 8, 4 and 2."""
CONTRAST = 0.45
"""Standard deviation of the pixels that the encoder was trained on, in its units; in standardised images it is 1."""


class PretrainedUNetwork(nn.Module):
    """U-Net with a pretrained encoder: the same outputs, computed at stride 2 and enlarged; h and w are multiples of
    32. begun: start with ImageNet's weights, not with random ones that are about to be replaced."""

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
        """Set the mode. In training the decoder stores its values channels first, for prediction channels last, as the
        encoder always does. On a CPU channels last is faster, except for the gradient of the weights of a 3 x 3
        convolution, which takes four times as long."""
        super().train(mode)
        for part in (self.up, self.head):
            part.to(memory_format=torch.contiguous_format if mode else torch.channels_last)  # type: ignore[call-overload]
        return self

    def forward(self, pixels: torch.Tensor) -> torch.Tensor:
        """See the class."""
        *levels, found = self.encoder.features(CONTRAST * pixels)
        for block, beside in zip(self.up, reversed(levels), strict=True):
            assert isinstance(block, Block)
            if self.training:
                found = functional.interpolate(found, size=beside.shape[-2:], mode="nearest")
                found = block(torch.cat([beside, found], dim=1).contiguous())
            else:
                found = block.on_enlarged(beside, found)
        planes = self.head(found) if self.training else self.head(found)[:, : self.outputs]
        return functional.interpolate(planes, size=pixels.shape[-2:], mode="bilinear", align_corners=False)


WITHIN = torch.tensor([[[1.0, 0, 0], [0, 1, 1]], [[1, 1, 0], [0, 0, 1]]])
"""(2, 2, 3): for the first and the second of two enlarged pixels, which of the three taps of a kernel fall on the first
and which on the second of the two original pixels that they meet."""


def _convolved(weight: torch.Tensor, beside: torch.Tensor, deep: torch.Tensor) -> torch.Tensor:
    """Convolve beside (B, c, 2h, 2w), stacked on deep (B, d, h, w) enlarged to twice its size (nearest), by weight
    (K, c + d, 3, 3), padded by zeros. Of an enlarged image a 3 x 3 window sees only 2 x 2 different pixels, so deep is
    convolved as it is, by four kernels of 2 x 2: 4 / 9 of the products, up to rounding the same result."""
    channels, height, width = beside.shape[1], *deep.shape[-2:]
    within = WITHIN.to(weight)
    kernels = torch.einsum("pty,qux,kcyx->pqkctu", within, within, weight[:, channels:]).flatten(0, 2)
    parts = functional.conv2d(deep, kernels.to(memory_format=torch.channels_last), padding=1)
    found = functional.conv2d(beside, weight[:, :channels].to(memory_format=torch.channels_last), padding=1)
    for place, part in enumerate(parts.chunk(4, dim=1)):
        row, column = divmod(place, 2)
        found[..., row::2, column::2] += part[..., row : row + height, column : column + width]
    return found


def build_network(settings: UNetworkSettings, begun: bool = False) -> nn.Module:
    """Build a network of either kind; begun: see `PretrainedUNetwork`."""
    return PretrainedUNetwork(settings, begun) if settings.encoder else UNetwork(settings)


def kind_of(network: Mapping[str, Any]) -> str:
    """Name of the training that makes such a network, given its description in a checkpoint."""
    return "unet" if network.get("encoder") else "unet_small"
