"""Flow of an image beyond what the camera's rotation explains: where tracks go on to, and how far to search there."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from oysterbench.core.geometry import Array

FEWEST_FOR_FLOW = 12
"""Minimum number of tracks for a fit of the flow: twice as many as it has parameters."""


def homogeneous(rays: Array) -> Array:
    """(N, 3) directions (x, y, 1) of normalised coordinates (N, 2)."""
    return np.column_stack([rays, np.ones(len(rays))])


def fit_flow(rays: Array, flow: Array) -> Array:
    """Fit (3, 2) of a flow (N, 2) that is affine in the rays (N, 2), at least FEWEST_FOR_FLOW: flow = (x, y, 1) fit.

    What moves otherwise than most, such as a fish, is left out.
    """
    places = homogeneous(rays)
    fit = np.linalg.lstsq(places, flow, rcond=None)[0]
    off = np.linalg.norm(flow - places @ fit, axis=1)
    near = off <= 3 * np.median(off)
    return np.asarray(np.linalg.lstsq(places[near], flow[near], rcond=None)[0], dtype=float)


@dataclass(frozen=True)
class Flow:
    """Flow of the last frame that its rotation does not explain.

    fit: (3, 2) px/s, see `fit_flow`. error_px: what nineteen in twenty of its tracks were predicted within; kept: share
    of the tracks that came through.
    """

    fit: Array
    error_px: float
    kept: float

    @classmethod
    def of(cls, rays: Array, moved_px: Array, error_px: Array, kept: float, elapsed_s: float) -> Flow:
        """Fit the motion (N, 2) px of tracks at rays (N, 2), beyond the rotation, within elapsed_s; error_px (N, 2):
        what it differs by from its prediction."""
        if len(rays) < FEWEST_FOR_FLOW or elapsed_s <= 0:
            return UNKNOWN_FLOW
        error = float(np.quantile(np.linalg.norm(error_px, axis=1), 0.95))
        return cls(fit_flow(rays, moved_px) / elapsed_s, error, kept)

    def after(self, rays: Array, elapsed_s: float) -> Array:
        """Motion (N, 2) px of tracks at rays (N, 2) within elapsed_s, if the flow goes on."""
        return np.asarray(homogeneous(rays) @ (self.fit * elapsed_s), dtype=float)


UNKNOWN_FLOW = Flow(np.zeros((3, 2)), np.inf, 0.0)
