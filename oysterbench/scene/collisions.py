"""Overlap of a shell about to be placed with others: probe points of the one against ellipsoids around the others."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.spatial import cKDTree

from oysterbench.core.geometry import Array
from oysterbench.scene.instances import Instances

ELLIPSOID = (np.array([0.50, 0.0, -0.05]), np.array([0.50, 0.33, 0.15]))  # of a shell: centre, half axes, in heights
REACH = 0.52  # extent of a shell from its ellipsoid's centre, in heights


class Crowd:
    """Spatial index of placed shells: positions (N, 3) m, rotations (N, 3, 3), scales (N, 3) m."""

    def __init__(self, positions: Array, rotations: Array, scales: Array) -> None:
        self._positions, self._rotations, self._scales = positions, rotations, scales
        self._widest = REACH * float(scales[:, 0].max(initial=0.0))
        self._tree = cKDTree(_centres(positions, rotations, scales)) if len(positions) else None

    @classmethod
    def of(cls, instances: Instances) -> Crowd:
        """Build the index from an instance table."""
        return cls(*(values.astype(float) for values in (instances.positions, instances.rotations, instances.scales)))

    def overlap(self, positions: Array, rotations: Array, scales: Array) -> Array:
        """Overlap (C,) of shells (C, ...) with the crowd: 0 if free; each probe point at another shell's centre adds
        1."""
        total = np.zeros(len(positions))
        if self._tree is None or not len(positions):
            return total
        centres = _centres(positions, rotations, scales)
        # The reach only saves time: pairs at its edge do not touch, so their last bits do not matter.
        reach = REACH * scales[:, 0]
        pairs = cKDTree(centres).sparse_distance_matrix(
            self._tree, float(reach.max()) + self._widest, output_type="ndarray"
        )
        close = pairs["v"] < reach[pairs["i"]] + REACH * self._scales[pairs["j"], 0]
        own, other = pairs["i"][close], pairs["j"][close]
        local = probe_points(positions, rotations, scales)[own] - self._positions[other][:, None]
        local = np.einsum("coi,cpo->cpi", self._rotations[other], local) / self._scales[other][:, None]
        inside = 1 - np.sqrt((((local - ELLIPSOID[0]) / ELLIPSOID[1]) ** 2).sum(axis=-1))
        total += np.bincount(own, np.maximum(inside, 0.0).sum(axis=1), len(positions))
        return total


def probe_points(positions: Array, rotations: Array, scales: Array) -> Array:
    """Probe points (N, P, 3), m, of shells that should not lie inside anything else."""
    return np.asarray(np.einsum("nij,npj->npi", rotations, PROBES * scales[:, None]) + positions[:, None])


def total_overlap(crowds: Sequence[Crowd], positions: Array, rotations: Array, scales: Array) -> Array:
    """Sum of Crowd.overlap (C,) over several crowds."""
    return np.asarray(np.sum([crowd.overlap(positions, rotations, scales) for crowd in crowds], axis=0))


def _centres(positions: Array, rotations: Array, scales: Array) -> Array:
    """Centres (N, 3) of the ellipsoids, m."""
    return np.asarray(positions + np.einsum("nij,nj->ni", rotations, ELLIPSOID[0] * scales))


def _probes() -> Array:
    """Points (P, 3) in a shell of height 1 that should lie in no other shell; its hinge may."""
    x, y = np.meshgrid([0.3, 0.55, 0.8, 0.98], [-0.25, 0.0, 0.25], indexing="ij")
    flat = np.column_stack([x.ravel(), y.ravel(), np.zeros(x.size)])
    return np.concatenate([flat, [[0.45, 0.0, -0.15], [0.45, 0.0, 0.06]]])


PROBES = _probes()
