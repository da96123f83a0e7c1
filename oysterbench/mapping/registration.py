"""Where a picture lies on the map: the shift at which most of its oysters fall on known ones.

Every pair of an oyster of the picture and a known one votes for the step between them, and the step with the most votes
is the picture's (pose clustering, Stockman 1987; generalised Hough transform, Ballard 1981). Oysters are as near to
each other as a path errs between two passes, so that the nearest known one is often a neighbour; but neighbours lie in
all directions, and their votes do not add up.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from oysterbench.core.geometry import Array
from oysterbench.mapping.projection import Patch
from oysterbench.mapping.settings import MapSettings
from oysterbench.mapping.track import OysterTrack

Indices = NDArray[np.intp]

FEWEST = 5
"""Pairs, for a picture to be laid by them."""
BIN_M = 0.004  # of the table of votes
LEAD = 4.0
"""Standard deviations by which the votes of a step exceed those of chance, which are of pairs that are none."""
FINEST_M = 0.002  # 1 sigma of where a picture is laid, at least


@dataclass(frozen=True)
class Registration:
    """shift: (3,) m, of a picture onto the map; sigma_m: 1 sigma of it; pairs: that agree on it."""

    shift: Array
    sigma_m: float
    pairs: int


def register(found: Sequence[Patch], known: Sequence[OysterTrack], settings: MapSettings) -> Registration | None:
    """The shift of a picture; None where its oysters do not tell, as they are too few or fall on none."""
    if min(len(found), len(known)) < FEWEST:
        return None
    spread = settings.middle_m
    reach = min(settings.reach_m, 3.0 * float(np.mean([one.pose_sigma_m for one in found])) + 2.0 * spread)
    between = np.array([one.centre for one in known])[None] - np.array([one.centre for one in found])[:, None]
    far = np.linalg.norm(between[..., :2], axis=2)
    rows, columns = np.nonzero((far < reach + 3.0 * spread) & (np.abs(between[..., 2]) < settings.reach_m))
    steps = between[rows, columns]
    sizes = np.log([one.area_m2 for one in found])[rows] - np.log([one.area_m2 for one in known])[columns]
    weights = np.exp(-0.5 * (sizes / settings.size_sigma) ** 2)

    half = int(np.ceil((reach + 3.0 * spread) / BIN_M))
    votes = np.zeros((2 * half + 1, 2 * half + 1))
    np.add.at(votes, tuple(np.rint(steps[:, :2] / BIN_M).astype(int).T + half), weights)
    kernel_m2 = 2.0 * np.pi * spread**2
    votes = gaussian_filter(votes, spread / BIN_M, mode="constant") * kernel_m2 / BIN_M**2  # a pair that is there: 1
    axis = (np.arange(2 * half + 1) - half) * BIN_M
    votes[np.hypot(*np.meshgrid(axis, axis, indexing="ij")) > reach] = 0.0
    best = np.unravel_index(int(votes.argmax()), votes.shape)
    chance = float(weights.sum()) * kernel_m2 / (np.pi * (reach + 3.0 * spread) ** 2)
    if votes[best] < chance + LEAD * np.sqrt(max(chance, 0.5)):
        return None

    shift, agreed = np.array([axis[best[0]], axis[best[1]], 0.0]), steps[:0]
    for _ in range(3):
        agreed = steps[_pairs(rows, columns, np.linalg.norm(steps[:, :2] - shift[:2], axis=1), 2.5 * spread)]
        if len(agreed) < FEWEST:
            return None
        shift = np.median(agreed, axis=0)
    scatter = 1.4826 * float(np.median(np.abs(agreed[:, :2] - shift[:2])))
    return Registration(shift, max(FINEST_M, 1.25 * scatter / np.sqrt(len(agreed))), len(agreed))


def _pairs(rows: Indices, columns: Indices, off: Array, most: float) -> Indices:
    """(K,) indices of pairs that are nearest to the step for both of theirs, and nearer than `most`."""
    order = np.argsort(off, kind="stable")
    order = order[off[order] < most]
    first_of_row = order[np.unique(rows[order], return_index=True)[1]]
    first_of_column = order[np.unique(columns[order], return_index=True)[1]]
    return np.intersect1d(first_of_row, first_of_column)
