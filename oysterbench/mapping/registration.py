"""Registration of two images: the shift at which most oysters of one coincide with oysters of the other.

Every pair of an oyster in one and an oyster in the other votes for the displacement between them; the one with the most
votes is that of the images (pose clustering, Stockman 1987; generalised Hough transform, Ballard 1981). Oysters are as
close together as a path errs between two passes, so the nearest oyster is often a neighbour; but neighbours lie in all
directions, and their votes do not accumulate.
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

Indices = NDArray[np.intp]

FEWEST = 4
"""Minimum number of pairs to register an image."""
BIN_M = 0.004  # bin size of the vote table
LEAD = 4.0
"""Standard deviations by which the votes must exceed those that mismatched pairs give by chance."""
REFINED = 5  # iterations
TURN_RAD = 0.05  # 1 sigma of the rotation between two images
FINEST_M = 0.001  # minimum 1 sigma of a shift


@dataclass(frozen=True)
class Registration:
    """Registration of one image onto another. shift: (3,) m; turn_rad: rotation about the vertical through the point
    `about` (3,) m; sigma_m, sigma_rad: their 1 sigma; pairs: number of oyster pairs that agree with them."""

    shift: Array
    turn_rad: float
    about: Array
    sigma_m: float
    sigma_rad: float
    pairs: int


def register(found: Sequence[Patch], known: Sequence[Patch], settings: MapSettings) -> Registration | None:
    """Register one image onto another; None if their oysters do not allow it: too few, or of different ground."""
    found, known = ([one for one in picture if not one.cut] for picture in (found, known))
    if min(len(found), len(known)) < FEWEST:
        return None
    spread = settings.middle_m
    sigma = np.sqrt(sum(float(np.mean([one.pose_sigma_m for one in picture])) ** 2 for picture in (found, known)))
    reach = min(settings.reach_m, 3.0 * sigma + 2.0 * spread)
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
    votes = gaussian_filter(votes, spread / BIN_M, mode="constant") * kernel_m2 / BIN_M**2  # a true pair adds 1
    axis = (np.arange(2 * half + 1) - half) * BIN_M
    votes[np.hypot(*np.meshgrid(axis, axis, indexing="ij")) > reach] = 0.0
    best = np.unravel_index(int(votes.argmax()), votes.shape)
    chance = float(weights.sum()) * kernel_m2 / (np.pi * (reach + 3.0 * spread) ** 2)
    if votes[best] < chance + LEAD * np.sqrt(max(chance, 0.5)):
        return None

    own = np.array([one.centre for one in found])[rows]
    shift, turn, about = np.array([axis[best[0]], axis[best[1]], 0.0]), 0.0, np.zeros(3)
    for _ in range(REFINED):
        left = steps - shift - turn * _across(own - about)
        agreed = _pairs(rows, columns, np.linalg.norm(left[:, :2], axis=1), 2.5 * spread)
        if len(agreed) < FEWEST:
            return None
        about = own[agreed].mean(axis=0)
        arms = _across(own[agreed] - about)
        weight = 1.0 / float((arms**2).sum() + (spread / TURN_RAD) ** 2)
        shift = np.median(steps[agreed] - turn * arms, axis=0)
        turn = weight * float(((steps[agreed] - shift) * arms).sum())
    scatter = 1.4826 * float(np.median(np.abs((steps[agreed] - shift - turn * arms)[:, :2])))
    sigma = max(FINEST_M, 1.25 * scatter / np.sqrt(len(agreed)))
    return Registration(shift, turn, about, sigma, float(max(FINEST_M, scatter) * np.sqrt(weight)), len(agreed))


def _across(arms: Array) -> Array:
    """Displacements (N, 3) m of points (N, 3) m per radian of rotation about the vertical."""
    return np.column_stack([-arms[:, 1], arms[:, 0], np.zeros(len(arms))])


def _pairs(rows: Indices, columns: Indices, off: Array, most: float) -> Indices:
    """Indices (K,) of the pairs whose residual `off` is the smallest for both of their oysters, and below `most`."""
    order = np.argsort(off, kind="stable")
    order = order[off[order] < most]
    first_of_row = order[np.unique(rows[order], return_index=True)[1]]
    first_of_column = order[np.unique(columns[order], return_index=True)[1]]
    return np.intersect1d(first_of_row, first_of_column)
