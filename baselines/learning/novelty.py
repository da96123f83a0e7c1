"""Novelty of an image: how unlike it is to those that a network was trained on.

The Mahalanobis distance of the image's features in the network's own encoder from those of the training images (Lee et
al. 2018), with a shrunk covariance (Ledoit & Wolf 2004), as there are no more images than features. The scale comes
from the training data itself: each of its clips is left out in turn and measured against the others; where clips are
not known, parts of the images in the order of their names. 1 is the distance that one in a hundred training images
exceeds in this way.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from oysterbench.annotations import Entry, runs_of

USUAL = 0.99
"""Share of the training images, each measured against the other clips, with a distance below 1."""
FOLDS = 20
"""Maximum number of groups of clips that are left out in turn, or of parts where there is a single clip."""

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Novelty:
    """Distribution of the features of images. centre: (C,); white: (C, C), whitening matrix, by which a difference from
    the centre has a mean length of sqrt(C); limit: the length that counts as 1."""

    centre: Array
    white: Array
    limit: float = 1.0

    def of(self, alike: Array) -> Array:
        """Novelty (N,) of images with features (N, C)."""
        return np.asarray(np.linalg.norm((alike - self.centre) @ self.white, axis=1) / self.limit)

    def state(self) -> dict[str, Any]:
        """State as stored in a checkpoint."""
        return {
            "centre": torch.from_numpy(self.centre.astype(np.float32)),
            "white": torch.from_numpy(self.white.astype(np.float32)),
            "limit": self.limit,
        }

    @classmethod
    def read(cls, state: Mapping[str, Any]) -> Novelty:
        """Restore from the result of `state`."""
        return cls(state["centre"].numpy().astype(float), state["white"].numpy().astype(float), float(state["limit"]))


def clips_of(entries: Sequence[Entry]) -> list[str]:
    """Name of what each image is left out with: its clip, or, where that is not known, a part of the images that follow
    each other (`annotations.runs_of`), as neighbours resemble each other as those of a clip do."""
    runs = runs_of(entries)
    unknown = [run for run in runs if not run.known]
    parts = max(1, (FOLDS - len(runs) + len(unknown)) // max(1, len(unknown)))
    names: dict[str, str] = {}
    for k, run in enumerate(runs):
        count = 1 if run.known else min(parts, len(run.entries))
        for place, entry in enumerate(run.entries):
            names[entry.name] = f"{k}/{place * count // len(run.entries)}"
    return [names[entry.name] for entry in entries]


def learnt(alike: Array, clips: Sequence[str]) -> Novelty:
    """Fit the novelty to the features (N, C) of the training images, N >= 2. clips: what each image is left out with
    (`clips_of`)."""
    folds = _folds(clips)
    distances = np.concatenate(
        [_spread(alike[folds != fold]).of(alike[folds == fold]) for fold in range(int(folds.max()) + 1)]
    )
    whole = _spread(alike)
    return Novelty(whole.centre, whole.white, float(np.quantile(distances, USUAL)))


def _folds(clips: Sequence[str]) -> NDArray[np.int64]:
    """Fold (N,) of each image: images of a clip are left out together; where there is one clip, those of a part of
    it."""
    names = list(dict.fromkeys(clips))
    if len(names) == 1:
        return np.arange(len(clips)) * min(FOLDS, len(clips)) // len(clips)
    places = {name: k % FOLDS for k, name in enumerate(names)}
    return np.array([places[clip] for clip in clips])


def _spread(alike: Array) -> Novelty:
    """Estimate centre and covariance: that of Ledoit & Wolf (2004, lemmas 3.2 to 3.4), for features divided by their
    standard deviations."""
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
