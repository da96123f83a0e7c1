"""Losses over known pixels."""

from __future__ import annotations

import torch
from torch.nn import functional

DICE = 0.5
STATE = 0.3
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
    live oysters from dead ones, `STATE` times `state_entropy`. truth: (B, 4, h, w), as `LabelledDataset` has it."""
    logits = model(pixels)
    loss = bce_dice(logits[:, :2], truth[:, :2], known)
    if logits.shape[1] > 2:
        loss = loss + STATE * state_entropy(logits[:, 2:], truth[:, 2:3] * known, truth[:, 3:] * known)
    return loss


def state_entropy(logits: torch.Tensor, live: torch.Tensor, told: torch.Tensor) -> torch.Tensor:
    """Binary cross-entropy of being alive over what is told of oysters; 0 where nothing is. All (B, 1, h, w); live and
    told: shares of a pixel, live of which is within told."""
    entropy = told * functional.softplus(logits) - live * logits
    return entropy.sum() / told.sum().clamp(min=1)
