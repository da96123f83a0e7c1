"""The two objectives of a translation: to look real (least-squares GAN), and to keep its content (PatchNCE)."""

from __future__ import annotations

from collections.abc import Mapping

import torch
from torch.nn import functional


def patch_nce(
    queries: Mapping[str, torch.Tensor], keys: Mapping[str, torch.Tensor], temperature: float
) -> torch.Tensor:
    """Mean over layers and patches of -log softmax(q . k / tau) at the query's own place (Park et al. 2020, eq. 3).

    queries: unit vectors (B, P, D) of the translation by layer, keys: of its input at the same places. The negatives of
    a patch are the other patches of the same image; no gradient flows into the keys.
    """
    losses = []
    for name, query in queries.items():
        logits = query @ keys[name].detach().transpose(1, 2) / temperature
        own = torch.arange(query.shape[1], device=query.device).expand(query.shape[:2])
        losses.append(functional.cross_entropy(logits.flatten(0, 1), own.flatten()))
    return torch.stack(losses).mean()


def looks(verdicts: torch.Tensor, real: bool) -> torch.Tensor:
    """Mean squared distance of the discriminator's verdicts from 1 for real, or from 0 (Mao et al. 2017)."""
    return torch.mean((verdicts - float(real)) ** 2)
