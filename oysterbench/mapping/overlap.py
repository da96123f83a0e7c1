"""Overlap of shells, computed from points on them."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from oysterbench.core.geometry import Array
from oysterbench.mapping.projection import Patch
from oysterbench.mapping.settings import MapSettings
from oysterbench.mapping.track import OysterTrack

Numbers = NDArray[np.integer]
NEIGHBOURS = 6  # nearest points whose owners are considered for each point


def overlaps(found: Sequence[Patch], known: Sequence[OysterTrack], settings: MapSettings) -> Array:
    """Overlap (N, M) from 0 to 1 of N oysters of an image with M known ones, as a share of the smaller of the two."""
    own = np.repeat(np.arange(len(found)), [len(patch.points) for patch in found])
    theirs = np.repeat(np.arange(len(known)), [len(track.points) for track in known])
    points = np.concatenate([patch.points for patch in found])
    others = np.concatenate([track.points for track in known])
    sigma = _sigma(found, settings)
    there = _laid(points, own, others, theirs, (len(found), len(known)), sigma)
    back = _laid(others, theirs, points, own, (len(known), len(found)), sigma)
    return np.maximum(there, back.T)


def own_overlaps(tracks: Sequence[OysterTrack], settings: MapSettings) -> dict[tuple[int, int], float]:
    """Overlap of each pair of tracks (i, j), i < j, that overlap at all, as a share of the smaller of the two."""
    owners = np.repeat(np.arange(len(tracks)), [len(track.points) for track in tracks])
    points = np.concatenate([track.points for track in tracks])
    sizes = np.bincount(owners, minlength=len(tracks))
    sigma = _sigma([track.patches[0] for track in tracks], settings)
    distances, nearest = cKDTree(points).query(points, k=3 * NEIGHBOURS, distance_upper_bound=3.0 * sigma)
    closeness = np.exp(-0.5 * (distances / sigma) ** 2)
    found = np.asarray(nearest < len(points))
    owner = np.where(found, owners[np.minimum(nearest, len(points) - 1)], -1)
    sums: Counter[tuple[int, int]] = Counter()
    for k in range(1, owner.shape[1]):
        first = found[:, k] & (owner[:, k] != owners) & (owner[:, :k] != owner[:, k, None]).all(axis=1)
        keys, inverse = np.unique(owners[first] * len(tracks) + owner[first, k], return_inverse=True)
        for key, value in zip(keys.tolist(), np.bincount(inverse, weights=closeness[first, k]).tolist(), strict=True):
            sums[divmod(key, len(tracks))] += value
    shares: dict[tuple[int, int], float] = {}
    for (i, j), value in sums.items():
        pair = (min(i, j), max(i, j))
        shares[pair] = max(shares.get(pair, 0.0), value / float(sizes[i]))
    return shares


def _sigma(patches: Sequence[Patch], settings: MapSettings) -> float:
    """1 sigma of the distance between points of one shell in two images, m."""
    return float(np.sqrt(settings.shell_m**2 + 2.0 * np.mean([patch.sigma_m for patch in patches]) ** 2))


def _laid(a: Array, of_a: Numbers, b: Array, of_b: Numbers, shape: tuple[int, int], sigma_m: float) -> Array:
    """Closeness (N, M): mean over the points of each a of exp(-d^2 / 2 sigma^2), d to the nearest point of each b."""
    distances, nearest = cKDTree(b).query(a, k=NEIGHBOURS, distance_upper_bound=3.0 * sigma_m)
    closeness = np.exp(-0.5 * (distances / sigma_m) ** 2)  # 0 for what is too far
    best = np.zeros(shape)
    found = np.asarray(nearest < len(b))
    owner = np.where(found, of_b[np.minimum(nearest, len(b) - 1)], -1)
    for k in range(NEIGHBOURS):
        # Neighbours come nearest first: only the first point of each b counts.
        first = found[:, k] & (owner[:, :k] != owner[:, k, None]).all(axis=1)
        np.add.at(best, (of_a[first], owner[first, k]), closeness[first, k])
    return best / np.bincount(of_a, minlength=shape[0])[:, None]
