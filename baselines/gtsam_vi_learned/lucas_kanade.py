"""Lucas-Kanade tracking of points in maps, differentiable so that a loss can be taken through it."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch.nn import functional

PYRAMID = (1.0, 4.0, 6.0, 4.0, 1.0)
"""Taps of the blur before every second pixel is taken, as in OpenCV's pyramids (Burt & Adelson 1983), in sixteenths."""
SCHARR = (3.0, 10.0, 3.0)
"""Taps of the blur across a central difference, in sixteenths."""


@dataclass(frozen=True)
class TrackingSettings:
    """Settings of tracking.

    reach: px, half the side of a patch. levels: of the pyramid; iterations: on each. damping: added to the normal
    equations of a patch, in squares of a map's slope, px^-2.

    All pixels of a patch are used: with every second one, half of the noise stays, and the network learns to blur.
    """

    reach: int = 10
    levels: int = 3
    iterations: int = 3
    damping: float = 0.05


def pyramid(maps: torch.Tensor, levels: int) -> list[torch.Tensor]:
    """Pyramid of maps (B, C, h, w), each half as large: pixel (2x, 2y) of one level is pixel (x, y) of the next."""
    taps = torch.tensor(PYRAMID) / 16
    kernel = (taps[:, None] * taps[None, :]).expand(maps.shape[1], 1, -1, -1)
    found = [maps]
    for _ in range(levels - 1):
        padded = functional.pad(found[-1], (2, 2, 2, 2), mode="reflect")
        found.append(functional.conv2d(padded, kernel, stride=2, groups=maps.shape[1]))
    return found


def slopes(maps: torch.Tensor) -> torch.Tensor:
    """Derivatives (B, 2C, h, w) of maps (B, C, h, w): along x of all of them, then along y."""
    across, along = torch.tensor(SCHARR) / 16, torch.tensor([-0.5, 0.0, 0.5])
    kernel = across[:, None] * along[None, :]
    padded = functional.pad(maps, (1, 1, 1, 1), mode="replicate")
    count = maps.shape[1]
    return torch.cat(
        [
            functional.conv2d(padded, one.expand(count, 1, 3, 3), groups=count)
            for one in (kernel, kernel.T.contiguous())
        ],
        dim=1,
    )


def sample(maps: torch.Tensor, pixels: torch.Tensor) -> torch.Tensor:
    """Sample maps (B, C, h, w) bilinearly at pixels (B, ..., 2): (B, C, ...); beyond the border, what is on it."""
    height, width = maps.shape[-2:]
    scale = torch.tensor([2.0 / (width - 1), 2.0 / (height - 1)])
    grid = (pixels * scale - 1).flatten(1, -2)[:, None]
    found = functional.grid_sample(maps, grid, mode="bilinear", padding_mode="border", align_corners=True)
    return found[:, :, 0].reshape(*found.shape[:2], *pixels.shape[1:-1])


def track(
    before: torch.Tensor, after: torch.Tensor, pixels: torch.Tensor, guess: torch.Tensor, settings: TrackingSettings
) -> list[torch.Tensor]:
    """Track the patches at pixels (B, N, 2) of maps (B, C, h, w) into others, starting at guess (B, N, 2): pixels
    (B, N, 2) after each iteration.

    The slopes are those of the patch that is searched for, so that its normal equations hold for all iterations (Baker
    & Matthews 2004), as in OpenCV: with g = dA/dx, dq = (sum g g^T)^-1 sum g (A(p + w) - B(q + w)).
    """
    steps = torch.arange(-settings.reach, settings.reach + 1, dtype=torch.float32)
    patch = torch.stack(torch.meshgrid(steps, steps, indexing="xy"), dim=-1).reshape(-1, 2)
    count = before.shape[1]
    there = pixels[:, :, None] + patch
    known = sample(torch.cat([before, slopes(before)], dim=1), there)
    value, slope_x, slope_y = known[:, :count], known[:, count : 2 * count], known[:, 2 * count :]
    xx = (slope_x * slope_x).sum(dim=(1, 3)) + settings.damping
    xy = (slope_x * slope_y).sum(dim=(1, 3))
    yy = (slope_y * slope_y).sum(dim=(1, 3)) + settings.damping
    determinant = xx * yy - xy * xy
    found, place = [], guess
    for _ in range(settings.iterations):
        missed = value - sample(after, place[:, :, None] + patch)
        x, y = (slope_x * missed).sum(dim=(1, 3)), (slope_y * missed).sum(dim=(1, 3))
        step = torch.stack([yy * x - xy * y, xx * y - xy * x], dim=-1) / determinant[..., None]
        place = place + step.clamp(-settings.reach / 2, settings.reach / 2)
        found.append(place)
    return found


def follow(
    before: torch.Tensor, after: torch.Tensor, pixels: torch.Tensor, guess: torch.Tensor, settings: TrackingSettings
) -> torch.Tensor:
    """Track from coarse to fine, as `gtsam_vi` tracks points: end points (levels, B, N, 2) px on each level, the full
    image last. No gradient passes between levels: through all of them it is chaotic, and the maps go blank."""
    place, found = guess, []
    levels = list(zip(pyramid(before, settings.levels), pyramid(after, settings.levels), strict=True))
    for number in reversed(range(len(levels))):
        size = 2**number
        place = track(*levels[number], pixels / size, place.detach() / size, settings)[-1] * size
        found.append(place)
    return torch.stack(found)
