"""The network: from an image to how well each place can be tracked, and to maps in which points can be tracked."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import nn
from torch.nn import functional

MULTIPLE = 8
"""Width and height of the network's input must be multiples of this, px."""
RANGE = 3.0
"""Bound of the maps, in units of an image's contrast: at 40 grey levels each, as much as uint8 holds."""


@dataclass(frozen=True)
class MapNetworkSettings:
    """Size of the network. maps: number per image; the first is the image itself, changed. channels: of the levels at a
    half, a quarter and an eighth of the size."""

    maps: int = 3
    channels: tuple[int, int, int] = (12, 24, 32)


def convolution(inputs: int, outputs: int, stride: int = 1) -> nn.Sequential:
    """3 x 3 convolution and ReLU. Nothing is normalised: images come with even contrast, and sums over large images
    are costly."""
    return nn.Sequential(nn.Conv2d(inputs, outputs, 3, stride, padding=1), nn.ReLU(inplace=True))


class MapNetwork(nn.Module):
    """From images (B, 1, h, w), of mean 0 and contrast 1, to maps (B, maps, h, w) and log_error (B, 1, h/4, w/4):
    expected logarithm of the error, px, of a point there after tracking. h and w are multiples of `MULTIPLE`.

    An hourglass with skip sums (as Newell, Yang & Deng 2016) that starts and ends at half the size, with four pixels as
    channels (Shi et al. 2016): at full size a single layer would cost as much as all of it does.
    """

    def __init__(self, settings: MapNetworkSettings) -> None:
        super().__init__()
        half, quarter, eighth = settings.channels
        self.settings = settings
        self.enter = nn.Sequential(convolution(4, half), convolution(half, half))
        self.middle = nn.Sequential(convolution(half, quarter, 2), convolution(quarter, quarter))
        self.deep = nn.Sequential(
            convolution(quarter, eighth, 2), convolution(eighth, eighth), convolution(eighth, eighth)
        )
        self.from_deep, self.after_deep = nn.Conv2d(eighth, quarter, 1), convolution(quarter, quarter)
        self.from_middle, self.after_middle = nn.Conv2d(quarter, half, 1), convolution(half, half)
        self.maps = nn.Conv2d(half, 4 * settings.maps, 3, padding=1)
        self.error = nn.Conv2d(quarter, 1, 1)
        with torch.no_grad():  # it starts as tracking in the image itself
            self.maps.weight.mul_(0.1)
            self.maps.bias.zero_()  # type: ignore[union-attr]

    def forward(self, picture: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """See the class."""
        fine, middle = self._seen(picture)
        back = functional.interpolate(self.from_middle(middle), scale_factor=2, mode="nearest")
        maps = functional.pixel_shuffle(self.maps(self.after_middle(fine + back)), 2)
        maps = torch.cat([maps[:, :1] + picture, maps[:, 1:]], dim=1)
        return RANGE * torch.tanh(maps / RANGE), self.error(middle)

    def log_error(self, picture: torch.Tensor) -> torch.Tensor:
        """Compute only log_error, in half of the time."""
        found: torch.Tensor = self.error(self._seen(picture)[1])
        return found

    def _seen(self, picture: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Features at a half and at a quarter of the size."""
        fine = self.enter(functional.pixel_unshuffle(picture, 2))
        middle = self.middle(fine)
        deep = self.from_deep(self.deep(middle))
        return fine, self.after_deep(middle + functional.interpolate(deep, scale_factor=2, mode="nearest"))
