"""Point clouds: coloured points in the trajectory's world frame, thinned, with outliers removed, and written as PLY."""

from __future__ import annotations

import os
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from oysterbench.core.errors import TrajectoryError
from oysterbench.core.geometry import Array
from oysterbench.core.ply import write_ply
from oysterbench.mapping.cloud_settings import CloudSettings

POINT = np.dtype(
    [("x", "<f8"), ("y", "<f8"), ("z", "<f8"), ("red", "u1"), ("green", "u1"), ("blue", "u1"), ("observations", "<i4")]
)
"""Record of a point in the PLY file; in float32, coordinates in UTM would be half a metre apart."""

HALF = 1 << 20
"""Voxels on either side of the first point along each axis, 21 bits in all: 10 km of 1 cm."""
BATCH = 1_000_000  # points that are buffered before they are merged into the voxels: 56 MB


@dataclass(frozen=True)
class PointCloud:
    """Points (N, 3) float m in the world frame; colours (N, 3) uint8 RGB; observations (N,) int, behind each."""

    points: Array
    colours: NDArray[np.uint8]
    observations: NDArray[np.int32]

    def __len__(self) -> int:
        return len(self.points)

    def select(self, index: NDArray[np.bool_]) -> PointCloud:
        """Return the points at `index`, a mask (N,)."""
        return PointCloud(self.points[index], self.colours[index], self.observations[index])

    def write(self, path: str | os.PathLike[str], comment: str) -> None:
        """Write the cloud as binary PLY: x, y, z (m, world frame), red, green, blue, observations."""
        rows = np.zeros(len(self), dtype=POINT)
        rows["x"], rows["y"], rows["z"] = self.points.T
        rows["red"], rows["green"], rows["blue"] = self.colours.T
        rows["observations"] = self.observations
        write_ply(path, rows, comment)


class Voxels:
    """Mean point and colour of each voxel; memory grows with the number of voxels, not of points."""

    def __init__(self, edge_m: float) -> None:
        self.edge_m = edge_m
        self._first: NDArray[np.int64] | None = None  # the cell of the first point, wherever the world's origin is
        self._keys = np.zeros(0, dtype=np.int64)
        self._sums = np.zeros((0, 7))
        self._waiting: list[Array] = []

    def add(self, points: Array, colours: NDArray[np.uint8]) -> None:
        """Add points (N, 3) m and their colours (N, 3). These are merged in batches, by `cloud` at the latest, which
        raises TrajectoryError where some lie more than `HALF` voxels from the first one."""
        self._waiting.append(np.column_stack([points, colours, np.ones(len(points))]))
        if sum(map(len, self._waiting)) > BATCH:
            self._merge()

    def cloud(self) -> PointCloud:
        """Return a cloud with one point per voxel."""
        self._merge()
        counts = self._sums[:, 6]
        means = self._sums[:, :6] / counts[:, None]
        return PointCloud(means[:, :3], np.rint(means[:, 3:]).astype(np.uint8), counts.astype(np.int32))

    def _merge(self) -> None:
        fresh = np.concatenate([np.zeros((0, 7)), *self._waiting])
        self._waiting = []
        cells = np.floor(fresh[:, :3] / self.edge_m).astype(np.int64)
        if self._first is None and len(cells):
            self._first = cells[0]
        if self._first is not None:
            cells += HALF - self._first
        if not ((cells >= 0) & (cells < 2 * HALF)).all():
            raise TrajectoryError(
                f"the points of the cloud lie more than {HALF * self.edge_m:.0f} m from the first one: expected fewer "
                f"at voxels of {self.edge_m:g} m (--voxel); has the trajectory diverged?"
            )
        keys = np.concatenate([self._keys, (cells[:, 0] << 42) | (cells[:, 1] << 21) | cells[:, 2]])
        sums = np.concatenate([self._sums, fresh])
        self._keys, rows = np.unique(keys, return_inverse=True)
        summed = [np.bincount(rows, weights=sums[:, k], minlength=len(self._keys)) for k in range(7)]
        self._sums = np.column_stack(summed)


def thinned(parts: Iterable[tuple[Array, NDArray[np.uint8]]], edge_m: float) -> PointCloud:
    """Thin parts, each with points (N, 3) m and colours (N, 3), to one point per voxel, at the mean of its points."""
    voxels = Voxels(edge_m)
    for points, colours in parts:
        voxels.add(points, colours)
    return voxels.cloud()


def without_outliers(cloud: PointCloud, settings: CloudSettings) -> PointCloud:
    """Remove points whose neighbours are farther away than usual: statistical outlier removal (Rusu et al. 2008)."""
    if len(cloud) <= settings.neighbours:
        return cloud
    distances, _ = cKDTree(cloud.points).query(cloud.points, k=settings.neighbours + 1)
    mean = np.asarray(distances)[:, 1:].mean(axis=1)
    return cloud.select(mean <= mean.mean() + settings.max_spread * mean.std())
