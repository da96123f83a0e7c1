"""Losses over known pixels."""

from __future__ import annotations

import torch
from torch.nn import functional

SMOOTH = 1.0
"""Pixels added to both sums of Dice: an empty crop that is called empty has the loss 0."""


def bce_dice(logits: torch.Tensor, truth: torch.Tensor, known: torch.Tensor) -> torch.Tensor:
    """Binary cross-entropy plus 1 - Dice (Milletari et al. 2016, squares left out), each the mean over channels.

    logits, truth: (B, K, h, w); known: (B, 1, h, w), 0 where nothing is learnt. Dice is of the sums over the batch: of
    single crops it would be that of the rarest ones.
    """
    weight = known.expand_as(logits)
    entropy = functional.binary_cross_entropy_with_logits(logits, truth, weight=weight, reduction="sum")
    entropy = entropy / weight.sum().clamp(min=1)
    prediction = torch.sigmoid(logits) * weight
    truth = truth * weight
    both = 2 * (prediction * truth).sum(dim=(0, 2, 3)) + SMOOTH
    dice = both / (prediction.sum(dim=(0, 2, 3)) + truth.sum(dim=(0, 2, 3)) + SMOOTH)
    return entropy + 1 - dice.mean()


def mask_loss(model: torch.nn.Module, pixels: torch.Tensor, truth: torch.Tensor, known: torch.Tensor) -> torch.Tensor:
    """`bce_dice` of what a network of masks says of pixels (B, 3, h, w)."""
    return bce_dice(model(pixels), truth, known)
