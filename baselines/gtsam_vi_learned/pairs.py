"""Pairs of images of the same ground, cropped and disturbed, with points and their true positions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import cv2
import numpy as np
import torch
from numpy.typing import NDArray

from oysterbench.core.errors import LabelError
from oysterbench.core.geometry import Array
from oysterbench.core.streams import Streams
from oysterbench_baselines.gtsam_vi.frontend import follow
from oysterbench_baselines.gtsam_vi.pictures import even_contrast, without_veil
from oysterbench_baselines.gtsam_vi.settings import FrontEndSettings
from oysterbench_baselines.gtsam_vi_learned.correspondence import Anchor, Footage
from oysterbench_baselines.gtsam_vi_learned.disturbances import Disturbances, disturbed

NAME = "gtsam_vi_learned"
Floats = NDArray[np.float32]

Batch = tuple[torch.Tensor, ...]
"""Images before and after (B, 1, C, C), as `as_seen` gives them; points (B, N, 2), their true positions, and the start
of the search for them, (B, N, 2) px; error of gtsam_vi, which tracks them in the images, (B, N) px; and whether the
truth is known (B, N); float32."""


@dataclass(frozen=True)
class PairSettings:
    """Settings of the pairs.

    crop: px, side of a crop; border: px around it, over which contrast and veil are computed as well; points: per pair,
    half of them corners; margin: px between points and a crop's border; start_px: 1 sigma of where the search for them
    starts; lost_px: error assumed where tracking itself reports a loss; most_s: between the images; tries: to find a
    crop with `least_points`.
    """

    crop: int = 128
    border: int = 32
    points: int = 64
    margin: int = 10
    start_px: float = 4.0
    lost_px: float = 8.0
    most_s: float = 0.45
    tries: int = 8
    least_points: int = 12
    disturbances: Disturbances = field(default_factory=Disturbances)
    frontend: FrontEndSettings = field(default_factory=FrontEndSettings)


def as_seen(even: NDArray[np.uint8]) -> Floats:
    """Convert an image (H, W) of even contrast (`even_contrast`) to the network's input: mean 0, contrast 1."""
    return (even.astype(np.float32) - 128) / np.float32(FrontEndSettings().contrast_grey)


class Pairs:
    """All pairs of several sequences. Raises LabelError where there are none."""

    def __init__(self, footages: Sequence[Footage], settings: PairSettings) -> None:
        self.footages, self.settings = footages, settings
        self._pairs = [footage.pairs(settings.most_s) for footage in footages]
        if not footages or not all(self._pairs):
            names = ", ".join(one.name for one, pairs in zip(footages, self._pairs, strict=True) if not pairs) or NAME
            raise LabelError(f"{names}: expected images with depth to learn tracking from, got none")

    def __len__(self) -> int:
        return sum(map(len, self._pairs))

    def batch(self, streams: Streams, step: int, count: int) -> Batch:
        """Draw pairs at random, each with a stream of its own; all sequences are equally likely."""
        rows = [self._drawn(streams.generator("pair", step, k)) for k in range(count)]
        before, after, *others = (np.stack(part) for part in zip(*rows, strict=True))
        pictures = [torch.from_numpy(as_seen(one))[:, None] for one in (before, after)]
        return *pictures, *(torch.from_numpy(one.astype(np.float32)) for one in others)

    def _drawn(self, rng: np.random.Generator) -> tuple[NDArray[Any], ...]:
        for _ in range(self.settings.tries):
            number = int(rng.integers(len(self.footages)))
            footage, pairs = self.footages[number], self._pairs[number]
            k, picture = pairs[int(rng.integers(len(pairs)))]
            found = self._cut(footage, footage.anchors[k], picture, rng)
            if found[-1].sum() >= self.settings.least_points:
                break
        return found  # pairs with few points count by these few

    def _cut(
        self, footage: Footage, anchor: Anchor, picture: int, rng: np.random.Generator
    ) -> tuple[NDArray[Any], ...]:
        """One row of a batch: a crop of an anchor and one of the other image that shows the same, with points."""
        s = self.settings
        first, second = footage.pictures[anchor.picture], footage.pictures[picture]
        room = np.array(first.shape[::-1]) - s.crop
        corner = np.array([rng.integers(n + 1) for n in room])
        before = self._even(first, corner, rng)
        points = self._points(before, rng)
        ends, known = footage.warp(anchor, picture, points + corner)
        moved = np.median((ends - points)[known], axis=0) if known.any() else corner
        # A few pixels more or less, so that the place of the other crop does not tell where a point is.
        other = np.clip(np.round(moved + rng.uniform(-8, 8, 2)), 0, room).astype(int)
        ends = ends - other
        known &= (ends >= s.margin).all(axis=1) & (ends < s.crop - s.margin).all(axis=1)
        ends = np.where(known[:, None], ends, points)
        after = self._even(second, other, rng)
        before, after, (points, ends) = _flipped(before, after, (points, ends), rng)
        starts = ends + rng.normal(0, s.start_px, ends.shape)
        found, good = follow(before, after, points, starts, s.frontend)
        off = np.where(good, np.linalg.norm(found - ends, axis=1), s.lost_px)
        return before, after, points, ends, starts, off, known

    def _even(
        self, picture: NDArray[np.uint8], corner: NDArray[np.int64], rng: np.random.Generator
    ) -> NDArray[np.uint8]:
        """Crop (C, C) of an image, disturbed, and then prepared as in the front end."""
        s = self.settings
        left, top = np.maximum(corner - s.border, 0)
        right, bottom = corner + s.crop + s.border
        part = disturbed(picture[top:bottom, left:right], s.disturbances, rng)
        even = even_contrast(without_veil(part, s.frontend), s.frontend)
        x, y = corner - (left, top)
        return even[y : y + s.crop, x : x + s.crop]

    def _points(self, even: NDArray[np.uint8], rng: np.random.Generator) -> Array:
        """Integer pixels (N, 2) of a crop: corners, and random places to learn where not to track from."""
        s = self.settings
        corners = cv2.goodFeaturesToTrack(even, s.points // 2, 0.01, 8, blockSize=s.frontend.corner_block_px)
        found = np.zeros((0, 2)) if corners is None else corners.reshape(-1, 2)
        found = found[((found >= s.margin) & (found < s.crop - s.margin)).all(axis=1)]
        rest = rng.integers(s.margin, s.crop - s.margin, (s.points - len(found), 2))
        return np.round(np.concatenate([found, rest])).astype(float)


def _flipped(
    before: NDArray[np.uint8], after: NDArray[np.uint8], points: tuple[Array, Array], rng: np.random.Generator
) -> tuple[NDArray[np.uint8], NDArray[np.uint8], tuple[Array, Array]]:
    """Mirror or transpose both crops alike, at random."""
    first, second = points
    last = before.shape[0] - 1
    if rng.random() < 0.5:
        before, after = before[:, ::-1], after[:, ::-1]
        first, second = (np.column_stack([last - one[:, 0], one[:, 1]]) for one in (first, second))
    if rng.random() < 0.5:
        before, after = before.T, after.T
        first, second = first[:, ::-1], second[:, ::-1]
    return np.ascontiguousarray(before), np.ascontiguousarray(after), (first.copy(), second.copy())
