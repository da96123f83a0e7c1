"""Generator with named encoder layers, PatchGAN discriminator, and projections of patches."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

import torch
from torch import nn
from torch.nn import functional

from oysterbench_baselines.cut.settings import CutSettings

GAIN = 0.02
"""Gain of the initial weights (Glorot & Bengio 2010, normal), as the method was published."""
NEARLY = 0.99
"""Factor on pixels before atanh, which keeps its values finite."""


class Shrink(nn.Module):
    """Downsampling by two, after the binomial low-pass filter (1, 2, 1) (Zhang 2019), so that nothing is aliased."""

    def __init__(self, channels: int) -> None:
        super().__init__()
        line = torch.tensor([1.0, 2.0, 1.0]) / 4
        self.register_buffer("kernel", (line[:, None] * line).expand(channels, 1, 3, 3).contiguous(), persistent=False)
        self.channels = channels

    def forward(self, values: torch.Tensor) -> torch.Tensor:
        """Downsample (B, C, h, w) -> (B, C, h / 2, w / 2), rounded up."""
        padded = functional.pad(values, (1, 1, 1, 1), mode="reflect")
        return functional.conv2d(padded, self.get_buffer("kernel"), stride=2, groups=self.channels)


class Grow(nn.Module):
    """Upsampling by two with bilinear interpolation: zeros between the pixels, then the filter (1, 3, 3, 1)."""

    def forward(self, values: torch.Tensor) -> torch.Tensor:
        """Upsample (B, C, h, w) -> (B, C, 2 h, 2 w)."""
        return functional.interpolate(values, scale_factor=2, mode="bilinear", align_corners=False)


class Residual(nn.Module):
    """Residual block x + norm(conv(relu(norm(conv(x))))), mirrored at the borders."""

    def __init__(self, channels: int) -> None:
        super().__init__()
        self.inner = nn.Sequential(*convolution(channels, channels, 3), nn.ReLU(), *convolution(channels, channels, 3))

    def forward(self, values: torch.Tensor) -> torch.Tensor:
        """Apply the block to (B, C, h, w), which keeps its shape."""
        changed: torch.Tensor = values + self.inner(values)
        return changed


def convolution(inputs: int, outputs: int, size: int) -> list[nn.Module]:
    """Layers of a convolution: mirrored border, convolution, instance normalisation."""
    return [nn.ReflectionPad2d(size // 2), nn.Conv2d(inputs, outputs, size), nn.InstanceNorm2d(outputs)]


class Generator(nn.Module):
    """Generator from pixels (B, 3, h, w) in [-1, 1] to the same; h and w are multiples of 4.

    Its encoder's layers have names: pixels (the input), conv1 and conv2 (the outputs of the two convolutions before
    downsampling, not yet normalised), block1, block2, ... (the output of each residual block).
    """

    def __init__(self, settings: CutSettings) -> None:
        super().__init__()
        n = settings.filters
        self.skip = settings.skip
        self.stem = nn.Sequential(*convolution(3, n, 7), nn.ReLU())
        self.conv1 = nn.Conv2d(n, 2 * n, 3, padding=1)
        self.after1 = nn.Sequential(nn.InstanceNorm2d(2 * n), nn.ReLU(), Shrink(2 * n))
        self.conv2 = nn.Conv2d(2 * n, 4 * n, 3, padding=1)
        self.after2 = nn.Sequential(nn.InstanceNorm2d(4 * n), nn.ReLU(), Shrink(4 * n))
        self.blocks = nn.ModuleList(Residual(4 * n) for _ in range(settings.blocks))
        self.decoder = nn.Sequential(
            Grow(),
            *convolution(4 * n, 2 * n, 3),
            nn.ReLU(),
            Grow(),
            *convolution(2 * n, n, 3),
            nn.ReLU(),
            nn.ReflectionPad2d(3),
            nn.Conv2d(n, 3, 7),
        )
        first_weights(self)

    def channels(self, layer: str) -> int:
        """Number of channels of a named layer."""
        widths = {"pixels": 3, "conv1": self.conv1.out_channels, "conv2": self.conv2.out_channels}
        return widths.get(layer, self.conv2.out_channels)

    def encode(self, pixels: torch.Tensor, layers: Iterable[str]) -> dict[str, torch.Tensor]:
        """Outputs (B, C, h', w') of named layers of the encoder; nothing after the last of them is computed."""
        wanted = set(layers)
        found = {"pixels": pixels} if "pixels" in wanted else {}
        for name, values in self._walk(pixels):
            if name in wanted:
                found[name] = values
            if len(found) == len(wanted):
                break
        return found

    def forward(self, pixels: torch.Tensor) -> torch.Tensor:
        """See the class."""
        for _, values in self._walk(pixels):
            encoded = values
        painted = self.decoder(encoded)
        if self.skip:
            painted = painted + torch.atanh(pixels * NEARLY)
        return torch.tanh(painted)

    def _walk(self, pixels: torch.Tensor) -> Iterable[tuple[str, torch.Tensor]]:
        """Yield the name and output of the encoder's layers after the pixels, one by one."""
        values = self.conv1(self.stem(pixels))
        yield "conv1", values
        values = self.conv2(self.after1(values))
        yield "conv2", values
        values = self.after2(values)
        for k, block in enumerate(self.blocks):
            values = block(values)
            yield f"block{k + 1}", values


class Discriminator(nn.Sequential):
    """Discriminator from pixels (B, 3, h, w) in [-1, 1] to verdicts (B, 1, h', w'), 1 for real, each over 70 x 70 px
    (PatchGAN, Isola et al. 2017), with low-pass filtered downsampling in place of strided convolutions."""

    def __init__(self, settings: CutSettings) -> None:
        n = settings.discriminator_filters
        layers: list[nn.Module] = [nn.Conv2d(3, n, 4, padding=1), nn.LeakyReLU(0.2), Shrink(n)]
        for inputs, outputs in ((n, 2 * n), (2 * n, 4 * n)):
            layers += [nn.Conv2d(inputs, outputs, 4, padding=1), nn.InstanceNorm2d(outputs), nn.LeakyReLU(0.2)]
            layers += [Shrink(outputs)]
        layers += [nn.Conv2d(4 * n, 8 * n, 4, padding=1), nn.InstanceNorm2d(8 * n), nn.LeakyReLU(0.2)]
        super().__init__(*layers, nn.Conv2d(8 * n, 1, 4, padding=1))
        first_weights(self)


class Projections(nn.ModuleDict):
    """A small perceptron for each named layer that maps its patches to unit vectors. All are created at once, from the
    generator's numbers of channels: created at the first image they would miss the optimiser and the seed."""

    def __init__(self, generator: Generator, settings: CutSettings) -> None:
        super().__init__(
            {
                layer: nn.Sequential(
                    nn.Linear(generator.channels(layer), settings.width),
                    nn.ReLU(),
                    nn.Linear(settings.width, settings.width),
                )
                for layer in settings.layers
            }
        )
        first_weights(self)

    def forward(
        self, layers: Mapping[str, torch.Tensor], places: Mapping[str, torch.Tensor]
    ) -> dict[str, torch.Tensor]:
        """Project the layers (B, C, h, w) at places (P,), row * w + column, to unit vectors (B, P, width)."""
        found = {}
        for name, values in layers.items():
            patches = values.flatten(2)[:, :, places[name]].transpose(1, 2)
            found[name] = functional.normalize(self[name](patches), dim=2)
        return found


def first_weights(network: nn.Module) -> None:
    """Initialise with normal weights (`GAIN`), drawn from torch's generator, and zero bias."""
    for module in network.modules():
        if isinstance(module, nn.Conv2d | nn.Linear):
            nn.init.xavier_normal_(module.weight, GAIN)
            if module.bias is not None:
                nn.init.zeros_(module.bias)
