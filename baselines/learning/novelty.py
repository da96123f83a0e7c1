"""How unlike a picture is to those that a network has learnt from.

Mahalanobis' distance of what the picture is like, as the network's own encoder has it, from the pictures of the
training (Lee et al. 2018), with a covariance that is shrunk (Ledoit & Wolf 2004), as there are no more pictures than
features. What is far is told by the training itself: each of its clips is left out in turn, and measured by the others.
1 is the distance that one in a hundred of its pictures exceeds so.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

USUAL = 0.99
"""Share of the pictures of the training, each measured by other clips, that are nearer than 1."""
FOLDS = 20
"""Groups of clips at most that are left out in turn, and parts of a single clip."""

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Novelty:
    """What pictures were like. centre: (C,); white: (C, C), by which a difference from it becomes one of length
    sqrt(C) in the mean; limit: the length that is 1."""

    centre: Array
    white: Array
    limit: float = 1.0

    def of(self, alike: Array) -> Array:
        """(N,) of pictures (N, C)."""
        return np.asarray(np.linalg.norm((alike - self.centre) @ self.white, axis=1) / self.limit)

    def state(self) -> dict[str, Any]:
        """As a checkpoint has it."""
        return {
            "centre": torch.from_numpy(self.centre.astype(np.float32)),
            "white": torch.from_numpy(self.white.astype(np.float32)),
            "limit": self.limit,
        }

    @classmethod
    def read(cls, state: Mapping[str, Any]) -> Novelty:
        """From `state`."""
        return cls(state["centre"].numpy().astype(float), state["white"].numpy().astype(float), float(state["limit"]))


def learnt(alike: Array, clips: Sequence[str]) -> Novelty:
    """Of the pictures (N, C) of a training, N >= 2, and the clips that they are of."""
    folds = _folds(clips)
    distances = np.concatenate(
        [_spread(alike[folds != fold]).of(alike[folds == fold]) for fold in range(int(folds.max()) + 1)]
    )
    whole = _spread(alike)
    return Novelty(whole.centre, whole.white, float(np.quantile(distances, USUAL)))


def _folds(clips: Sequence[str]) -> NDArray[np.int64]:
    """(N,) which pictures are left out together: those of a clip; where there is one clip, those of a part of it."""
    names = list(dict.fromkeys(clips))
    if len(names) == 1:
        return np.arange(len(clips)) * min(FOLDS, len(clips)) // len(clips)
    places = {name: k % FOLDS for k, name in enumerate(names)}
    return np.array([places[clip] for clip in clips])


def _spread(alike: Array) -> Novelty:
    """Centre and covariance: that of Ledoit & Wolf (2004, lemmas 3.2 to 3.4), of features divided by their
    deviations."""
    centre = alike.mean(axis=0)
    scale = np.maximum(alike.std(axis=0), 1e-6)
    values = (alike - centre) / scale
    count, size = values.shape
    sample = values.T @ values / count
    mean = np.trace(sample) / size
    spread = ((sample - mean * np.eye(size)) ** 2).sum()
    noise = ((values**2).sum(axis=1) ** 2).sum() / count**2 - (sample**2).sum() / count
    share = min(1.0, noise / spread) if spread > 0 else 1.0
    shrunk = (1 - share) * sample + share * mean * np.eye(size)
    variances, axes = np.linalg.eigh(shrunk)
    return Novelty(centre, axes / np.sqrt(np.maximum(variances, 1e-9)) / scale[:, None])
