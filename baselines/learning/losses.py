"""Losses over known pixels."""

from __future__ import annotations

import torch
from torch.nn import functional

DICE = 0.5
STATE = 0.3
CENTRE, RADIUS = 0.5, 0.2
UNIT, USUAL = 16.0, 8.0
"""px: of the planes that say where the centre is, and the radius that 0 stands for in the plane of its logarithm."""
LEAST = 2.0
"""px, of the radius by which errors are divided, at least."""
SMOOTH = 1.0
"""Pixels added to both sums of Dice: an empty crop that is called empty has the loss 0."""


def bce_dice(logits: torch.Tensor, truth: torch.Tensor, known: torch.Tensor) -> torch.Tensor:
    """Binary cross-entropy, the mean over channels, plus `DICE` times 1 - Dice of the first (Milletari et al. 2016,
    squares left out).

    logits, truth: (B, K, h, w); known: (B, 1, h, w), 0 where nothing is learnt. Dice is of the sums over the batch: of
    single crops it would be that of the rarest ones. Of a plane of shares, such as depth, it would make steps.
    """
    weight = known.expand_as(logits)
    entropy = functional.binary_cross_entropy_with_logits(logits, truth, weight=weight, reduction="sum")
    entropy = entropy / weight.sum().clamp(min=1)
    prediction, first = torch.sigmoid(logits[:, :1]) * known, truth[:, :1] * known
    dice = (2 * (prediction * first).sum() + SMOOTH) / (prediction.sum() + first.sum() + SMOOTH)
    return entropy + DICE * (1 - dice)


def mask_loss(model: torch.nn.Module, pixels: torch.Tensor, truth: torch.Tensor, known: torch.Tensor) -> torch.Tensor:
    """Of what a network of masks says of pixels (B, 3, h, w): `bce_dice` of oyster and depth, and where it tells
    live oysters from dead ones, `STATE` times `state_entropy`; and where it also says to which centre a pixel belongs,
    `centre_error`. truth: (B, 7, h, w), as `LabelledDataset` has it."""
    logits = model(pixels)
    loss = bce_dice(logits[:, :2], truth[:, :2], known)
    if logits.shape[1] > 2:
        loss = loss + STATE * state_entropy(logits[:, 2:3], truth[:, 2:3] * known, truth[:, 3:4] * known)
    if logits.shape[1] > 3:
        loss = loss + centre_error(logits[:, 3:], truth[:, 4:], known)
    return loss


def centre_error(planes: torch.Tensor, truth: torch.Tensor, known: torch.Tensor) -> torch.Tensor:
    """Over known pixels of oysters, `CENTRE` times the distance from the true centre, in radii of the oyster, plus
    `RADIUS` times the error of the logarithm of its radius; an oyster weighs as its radius, not as its area. 0 where
    there are none.

    planes: (B, 3, h, w), x and y to the centre in `UNIT`s, and the logarithm of the radius over `USUAL`; truth:
    (B, 3, h, w) px, as `samples.offsets` has it.
    """
    radius = truth[:, 2:].clamp(min=LEAST)
    weight = (truth[:, 2:] > 0) * known / radius
    apart = functional.smooth_l1_loss(UNIT * planes[:, :2], truth[:, :2], reduction="none").sum(dim=1, keepdim=True)
    size = (planes[:, 2:] - torch.log(radius / USUAL)).abs()
    return (weight * (CENTRE * apart / radius + RADIUS * size)).sum() / weight.sum().clamp(min=1e-3)


def state_entropy(logits: torch.Tensor, live: torch.Tensor, told: torch.Tensor) -> torch.Tensor:
    """Binary cross-entropy of being alive over what is told of oysters; 0 where nothing is. All (B, 1, h, w); live and
    told: shares of a pixel, live of which is within told."""
    entropy = told * functional.softplus(logits) - live * logits
    return entropy.sum() / told.sum().clamp(min=1)
