"""Clumps: oysters grown on one another, each cemented by its hinge to an older one, rising where there is room."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from oysterbench.core.geometry import Array
from oysterbench.scene.collisions import Crowd, probe_points, total_overlap
from oysterbench.scene.mesh import Mesh
from oysterbench.scene.terrain import Terrain

CLUMP_LIMITS = (3, 15)
SIZE_SHAPE = 5.0  # shape parameter of the gamma distribution of clump sizes
PUSHES = 14  # iterations in which neighbouring clumps push one another apart
PATCH_M = 5.0  # wavelength of bare and covered patches
TRIES = 12  # candidate places for each oyster
CLUMPS_AT_ONCE = 256  # bounds the memory that growing needs
TURNS = 5  # smallest number of turns over which the clumps of a reef add their next oyster
SET = 0.045  # depth to which a hinge is set into its host, in heights
SITES = (0.05, 0.45)  # growth mark of the host where hinges settle: near its base, away from its living margin
OVERLAP = 4.0  # cost of a probe at the centre of another shell
LOW = 1.5  # cost of settling one shell height higher
CANOPY_M, TALL = 0.060, 12.0  # oysters rarely rise higher than this above the bottom; cost of rising twice as high
RISE, STAND_OFF, SPREAD, WANDER = 1.0, 0.40, 0.30, 0.36  # weights of up, host's normal, outward and random direction
ERECT_M = 0.045  # larger shells are too heavy to stand as steeply
LIVING = slice(3, None)  # probe points that the bottom must not cover: all but those next to the hinge


@dataclass(frozen=True)
class Growth:
    """Oysters of all clumps: positions (N, 3) m and rotations (N, 3, 3) in `map`; hosts (N,), row of the host or -1."""

    positions: Array
    rotations: Array
    hosts: NDArray[np.int64]


def clump_sizes(count: int, mean: float, generator: np.random.Generator) -> NDArray[np.int64]:
    """Draw sizes (K,) of clumps that hold `count` oysters in total: 3 to 15 each but for a single small one, with wider
    limits where the mean requires them."""
    if count == 0:
        return np.zeros(0, dtype=np.int64)
    low, high = min(CLUMP_LIMITS[0], round(mean)), max(CLUMP_LIMITS[1], round(1.5 * mean))
    draws = generator.gamma(SIZE_SHAPE, mean / SIZE_SHAPE, int(2 * count / mean) + 8)
    sizes = np.clip(np.round(draws), max(low, 1), high).astype(np.int64)
    while sizes.sum() < count:
        sizes = np.concatenate([sizes, sizes])
    last = int(np.searchsorted(np.cumsum(sizes), count))
    sizes = sizes[: last + 1]
    sizes[-1] -= sizes.sum() - count
    # A remainder too small for a clump of its own is distributed over the smallest clumps.
    if len(sizes) > 1 and sizes[-1] < low:
        left, sizes = int(sizes[-1]), sizes[:-1]
        order = np.argsort(sizes, kind="stable")
        for k in range(left):
            sizes[order[k % len(order)]] += 1
    return sizes


def clump_centres(count: int, side: float, spacing: float, patchiness: float, generator: np.random.Generator) -> Array:
    """Draw clump centres (K, 2), m: the parents of a Thomas process (1949) that avoid bare patches and, where possible,
    one another.

    spacing: distance below which neighbours repel one another, m. patchiness: 0 for none, 1 for hard edges.
    """
    half = side / 2
    centres = generator.uniform(-half, half, (3 * count + 1, 2))
    waves = generator.standard_normal((12, 2)) * 2 * np.pi / PATCH_M
    phases = generator.uniform(0, 2 * np.pi, 12)
    patches = np.sin(np.einsum("pi,wi->pw", centres, waves) + phases).sum(axis=1) / np.sqrt(6.0)
    preference = patchiness * patches + (1 - patchiness) * generator.standard_normal(len(centres))
    keep = np.argsort(-np.round(preference, 6), kind="stable")[:count]
    centres = centres[np.sort(keep)]
    for _ in range(PUSHES):
        pairs = cKDTree(centres).query_pairs(spacing, output_type="ndarray") if count > 1 else np.zeros((0, 2), int)
        if not len(pairs):
            break
        pairs = pairs[np.lexsort(pairs.T)]
        gap = centres[pairs[:, 0]] - centres[pairs[:, 1]]
        length = np.maximum(np.sqrt((gap**2).sum(axis=1, keepdims=True)), 1e-6)
        push = 0.3 * (spacing - length) * gap / length
        for axis in (0, 1):
            centres[:, axis] += np.bincount(pairs[:, 0], push[:, axis], count)
            centres[:, axis] -= np.bincount(pairs[:, 1], push[:, axis], count)
        centres = np.clip(centres, -half, half)
    return np.round(centres, 6)


def grow_clumps(
    sizes: NDArray[np.int64],
    founders: Growth,
    shapes: NDArray[np.integer],
    scales: Array,
    meshes: Sequence[Mesh],
    terrain: Terrain,
    generator: np.random.Generator,
) -> Growth:
    """Grow clumps on founders already in place, putting each oyster where it has room among those already there.

    sizes (K,): the rows of a clump are consecutive, its founder first; founders: poses (N, ...), of which only the
    founders' rows matter; shapes (N,), scales (N, 3): of all oysters.
    """
    n = len(shapes)
    positions, rotations = founders.positions.copy(), founders.rotations.copy()
    hosts = np.full(n, -1, dtype=np.int64)
    grove = _Grove(positions, rotations, hosts, shapes, scales, meshes, terrain)
    first = np.concatenate([[0], np.cumsum(sizes)[:-1]]).astype(np.int64) if n else np.zeros(0, np.int64)
    placed = first
    for step in range(1, int(sizes.max(initial=1))):
        growing = first[sizes > step]
        generator_of_step = np.random.Generator(np.random.Philox(key=generator.integers(0, 2**63, 2, dtype=np.uint64)))
        settled = grove.crowd(placed)
        # Take clumps at a stride, as those that grow in the same turn cannot see one another's new oyster.
        parts = max(TURNS, len(growing) // CLUMPS_AT_ONCE + 1)
        fresh: list[NDArray[np.int64]] = []
        for k in range(parts):
            part = growing[k::parts]
            if len(part):
                crowds = [settled, grove.crowd(np.concatenate(fresh))] if fresh else [settled]
                grove.add(step, part, crowds, generator_of_step)
                fresh.append(part + step)
        placed = np.concatenate([placed, growing + step])
    return Growth(positions, rotations, hosts)


@dataclass(frozen=True)
class _Grove:
    """All clumps while they grow: poses (N, ...) filled in row by row, and the shapes and scales of the rows."""

    positions: Array
    rotations: Array
    hosts: NDArray[np.int64]
    shapes: NDArray[np.integer]
    scales: Array
    meshes: Sequence[Mesh]
    terrain: Terrain

    def crowd(self, rows: NDArray[np.int64]) -> Crowd:
        """Index of the oysters in rows that have already been placed."""
        return Crowd(self.positions[rows], self.rotations[rows], self.scales[rows])

    @cached_property
    def sites(self) -> list[NDArray[np.intp]]:
        """For each shell, indices of the vertices on which hinges may settle."""
        low, high = SITES
        marks = [mesh.marks for mesh in self.meshes]
        return [np.flatnonzero((m[:, 0] > low) & (m[:, 0] < high) & (m[:, 1] < 0.5)) for m in marks]

    def add(self, step: int, first: NDArray[np.int64], crowds: Sequence[Crowd], generator: np.random.Generator) -> None:
        """Add oyster number `step` to the clumps that start at rows `first` (A,), at the best of TRIES places."""
        a = len(first)
        scale = self.scales[first + step]
        height = scale[:, 0]
        host = first[:, None] + generator.integers(0, step, (a, TRIES))
        contact, normal = self._contacts(host, generator.random((a, TRIES)))
        centre = self.positions[first][:, None]
        outward = contact - centre
        outward[..., 2] = 0.0
        outward /= np.maximum(_length(outward), 1e-9)
        axis = STAND_OFF * normal + SPREAD * outward + WANDER * generator.standard_normal((a, TRIES, 3))
        axis[..., 2] += RISE * np.minimum((ERECT_M / height[:, None]) ** 0.5, 1.0)
        axis /= np.maximum(_length(axis), 1e-9)
        # The flat valve faces roughly out of the clump, like the pages of a book that falls open.
        facing = outward + 0.6 * generator.standard_normal((a, TRIES, 3))
        across = np.cross(facing, axis)
        across /= np.maximum(_length(across), 1e-9)
        rotation = np.stack([axis, across, np.cross(axis, across)], axis=-1)
        position = contact - SET * height[:, None, None] * axis

        every = position.reshape(-1, 3), rotation.reshape(-1, 3, 3), np.repeat(scale, TRIES, axis=0)
        overlap = total_overlap(crowds, *every).reshape(a, TRIES)
        points = probe_points(*every).reshape(a, TRIES, -1, 3)
        depth = self.terrain.height(points[..., 0], points[..., 1]) - points[..., 2]
        buried = np.maximum(depth / height[:, None, None] + 0.02, 0.0)[..., LIVING].sum(axis=2)
        tall = np.maximum(-depth.min(axis=2) / CANOPY_M - 1.0, 0.0)
        downward = np.maximum(0.1 - normal[..., 2], 0.0) + np.maximum(0.2 - (axis * normal).sum(axis=-1), 0.0)
        level = (contact[..., 2] - centre[..., 2]) / height[:, None]
        cost = np.round(OVERLAP * overlap + 2.0 * buried + 1.5 * downward + LOW * level + TALL * tall, 6)
        best = np.argmin(cost, axis=1)
        row = np.arange(a)
        self.positions[first + step] = position[row, best]
        self.rotations[first + step] = rotation[row, best]
        self.hosts[first + step] = host[row, best]

    def _contacts(self, host: NDArray[np.int64], chance: Array) -> tuple[Array, Array]:
        """Points (A, T, 3) on the outsides of the hosts in rows (A, T), m in `map`, and the unit normals there.

        chance (A, T) from 0 to 1 selects a vertex among the host's `sites`.
        """
        points, normals = np.empty((*host.shape, 3)), np.empty((*host.shape, 3))
        shape = self.shapes[host]
        for k in np.unique(shape):
            at = shape == k
            vertex = self.sites[k][(chance[at] * len(self.sites[k])).astype(int)]
            points[at] = self.meshes[k].vertices[vertex] * self.scales[host[at]]
            normals[at] = self.meshes[k].normals[vertex] / self.scales[host[at]]
        points = np.einsum("atij,atj->ati", self.rotations[host], points) + self.positions[host]
        normals = np.einsum("atij,atj->ati", self.rotations[host], normals)
        return points, normals / np.maximum(_length(normals), 1e-9)


def _length(vectors: Array) -> Array:
    """Lengths (..., 1) of vectors (..., 3)."""
    return np.asarray(np.sqrt((vectors**2).sum(axis=-1, keepdims=True)))
