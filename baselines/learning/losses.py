"""Losses over known pixels."""

from __future__ import annotations

import torch
from torch.nn import functional

DICE = 0.5
STATE = 0.3
CENTRE, RADIUS = 0.5, 0.2
UNIT, USUAL = 16.0, 8.0
"""px: unit of the planes of offsets to the centre, and the radius for which the plane of its logarithm is 0."""
LEAST = 2.0
"""Lower limit of the radius by which errors are divided, px."""
SMOOTH = 1.0
"""Pixels added to both sums of Dice: an empty crop predicted as empty has a loss of 0."""


def bce_dice(logits: torch.Tensor, truth: torch.Tensor, known: torch.Tensor) -> torch.Tensor:
    """Binary cross-entropy, averaged over channels, plus `DICE` times 1 - Dice of the first channel (Milletari et al.
    2016, without the squares).

    logits, truth: (B, K, h, w); known: (B, 1, h, w), 0 where nothing is learnt. Dice uses sums over the batch: per crop
    it would be dominated by those with the fewest pixels of oyster. It would turn a plane of fractions, such as depth,
    into steps, and is left out there.
    """
    weight = known.expand_as(logits)
    entropy = functional.binary_cross_entropy_with_logits(logits, truth, weight=weight, reduction="sum")
    entropy = entropy / weight.sum().clamp(min=1)
    prediction, first = torch.sigmoid(logits[:, :1]) * known, truth[:, :1] * known
    dice = (2 * (prediction * first).sum() + SMOOTH) / (prediction.sum() + first.sum() + SMOOTH)
    return entropy + DICE * (1 - dice)


def mask_loss(model: torch.nn.Module, pixels: torch.Tensor, truth: torch.Tensor, known: torch.Tensor) -> torch.Tensor:
    """Loss of a mask network on pixels (B, 3, h, w): `bce_dice` of oyster and depth, plus `STATE` times `state_entropy`
    where it tells live oysters from dead ones, plus `centre_error` where it also predicts the centre to which a pixel
    belongs. truth: (B, 7, h, w), as in `LabelledDataset`."""
    logits = model(pixels)
    loss = bce_dice(logits[:, :2], truth[:, :2], known)
    if logits.shape[1] > 2:
        loss = loss + STATE * state_entropy(logits[:, 2:3], truth[:, 2:3] * known, truth[:, 3:4] * known)
    if logits.shape[1] > 3:
        loss = loss + centre_error(logits[:, 3:], truth[:, 4:], known)
    return loss


def centre_error(planes: torch.Tensor, truth: torch.Tensor, known: torch.Tensor) -> torch.Tensor:
    """Error of the centres over known pixels of oysters: `CENTRE` times the distance from the true centre, in radii of
    the oyster, plus `RADIUS` times the error of the logarithm of its radius; an oyster's weight is proportional to its
    radius, not its area. 0 where there are no oysters.

    planes: (B, 3, h, w), x and y to the centre in units of `UNIT`, and the logarithm of the radius over `USUAL`; truth:
    (B, 3, h, w) px, as `samples.offsets` returns it.
    """
    radius = truth[:, 2:].clamp(min=LEAST)
    weight = (truth[:, 2:] > 0) * known / radius
    apart = functional.smooth_l1_loss(UNIT * planes[:, :2], truth[:, :2], reduction="none").sum(dim=1, keepdim=True)
    size = (planes[:, 2:] - torch.log(radius / USUAL)).abs()
    return (weight * (CENTRE * apart / radius + RADIUS * size)).sum() / weight.sum().clamp(min=1e-3)


def state_entropy(logits: torch.Tensor, live: torch.Tensor, told: torch.Tensor) -> torch.Tensor:
    """Binary cross-entropy of being alive over pixels of oysters whose state is known; 0 where there are none. All
    (B, 1, h, w); live, told: fractions of a pixel that are live oyster, and oyster of known state; live <= told."""
    entropy = told * functional.softplus(logits) - live * logits
    return entropy.sum() / told.sum().clamp(min=1)
