"""Clumps: oysters grown on one another, each cemented at its hinge to an older one, rising where there is room."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from oysterbench.scene.mesh import Mesh
from oysterbench.scene.terrain import Terrain

Array = NDArray[np.float64]

CLUMP_LIMITS = (3, 15)
SIZE_SHAPE = 5.0  # of the gamma distribution of clump sizes
PATCH_M = 5.0  # wavelength of bare and covered patches
TRIES = 12  # places tried for each oyster
CLUMPS_AT_ONCE = 256  # bounds the memory that growing needs
SET = 0.045  # depth to which a hinge is set into its host, in heights
ELLIPSOID = (np.array([0.50, 0.0, -0.05]), np.array([0.50, 0.33, 0.15]))  # a shell for collisions: centre, half axes
SITES = (0.10, 0.75)  # growth of the host where hinges settle: near its base, away from its living margin
LOW = 1.5  # cost of settling a height higher
RISE, STAND_OFF, SPREAD, WANDER = 1.0, 0.40, 0.30, 0.33  # weights of up, host's normal, outward and chance


@dataclass(frozen=True)
class Growth:
    """Oysters of all clumps: positions (N, 3) m and rotations (N, 3, 3) in `map`; hosts (N,), row or -1."""

    positions: Array
    rotations: Array
    hosts: NDArray[np.int64]


def clump_sizes(count: int, mean: float, generator: np.random.Generator) -> NDArray[np.int64]:
    """Sizes (K,) of clumps that hold `count` oysters, 3 to 15 each but for the last, or as near as the mean allows."""
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
    # A rest too small for a clump of its own joins the smallest ones.
    if len(sizes) > 1 and sizes[-1] < low:
        left, sizes = int(sizes[-1]), sizes[:-1]
        order = np.argsort(sizes, kind="stable")
        for k in range(left):
            sizes[order[k % len(order)]] += 1
    return sizes


def clump_centres(count: int, side: float, spacing: float, patchiness: float, generator: np.random.Generator) -> Array:
    """Centres (K, 2), m: the parents of a Thomas process (1949) that avoid bare patches and, where they can, another.

    spacing: distance at which neighbours push one another away, m. patchiness: 0 for none, 1 for hard edges.
    """
    half = side / 2
    centres = generator.uniform(-half, half, (3 * count + 1, 2))
    waves = generator.standard_normal((12, 2)) * 2 * np.pi / PATCH_M
    phases = generator.uniform(0, 2 * np.pi, 12)
    patches = np.sin(np.einsum("pi,wi->pw", centres, waves) + phases).sum(axis=1) / np.sqrt(6.0)
    worth = patchiness * patches + (1 - patchiness) * generator.standard_normal(len(centres))
    keep = np.argsort(-np.round(worth, 6), kind="stable")[:count]
    centres = centres[np.sort(keep)]
    for _ in range(6):
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
    """Grow clumps on founders that lie where they are.

    sizes (K,): the rows of a clump follow one another, its founder first; founders: poses (N, ...) of which only
    those rows count; shapes (N,), scales (N, 3): of all oysters.
    """
    n = len(shapes)
    positions, rotations = founders.positions.copy(), founders.rotations.copy()
    hosts = np.full(n, -1, dtype=np.int64)
    first = np.concatenate([[0], np.cumsum(sizes)[:-1]]).astype(np.int64) if n else np.zeros(0, np.int64)
    low, high = SITES
    growth = [mesh.marks[:, 0] for mesh in meshes]
    outside = [mesh.marks[:, 1] < 0.5 for mesh in meshes]
    sites = [np.flatnonzero((g > low) & (g < high) & o) for g, o in zip(growth, outside, strict=True)]
    for step in range(1, int(sizes.max(initial=1))):
        growing = first[sizes > step]
        generator_of_step = np.random.Generator(np.random.Philox(key=generator.integers(0, 2**63, 2, dtype=np.uint64)))
        for part in np.array_split(growing, len(growing) // CLUMPS_AT_ONCE + 1):
            if len(part):
                _add(step, part, positions, rotations, hosts, shapes, scales, meshes, sites, terrain, generator_of_step)
    return Growth(positions, rotations, hosts)


def _add(
    step: int,
    first: NDArray[np.int64],
    positions: Array,
    rotations: Array,
    hosts: NDArray[np.int64],
    shapes: NDArray[np.integer],
    scales: Array,
    meshes: Sequence[Mesh],
    sites: Sequence[NDArray[np.int64]],
    terrain: Terrain,
    generator: np.random.Generator,
) -> None:
    """Add oyster number `step` to the clumps that begin at rows `first` (A,), at the best of TRIES places."""
    a = len(first)
    height = scales[first + step, 0]
    host = first[:, None] + generator.integers(0, step, (a, TRIES))
    contact, normal = _contacts(host, positions, rotations, shapes, scales, meshes, sites, generator.random((a, TRIES)))
    centre = positions[first][:, None]
    outward = contact - centre
    outward[..., 2] = 0.0
    outward /= np.maximum(_length(outward), 1e-9)
    axis = STAND_OFF * normal + SPREAD * outward + WANDER * generator.standard_normal((a, TRIES, 3))
    axis[..., 2] += RISE
    axis /= np.maximum(_length(axis), 1e-9)
    # The flat valve faces out of the clump, more or less, as pages of a book that falls open.
    facing = outward + 0.6 * generator.standard_normal((a, TRIES, 3))
    across = np.cross(facing, axis)
    across /= np.maximum(_length(across), 1e-9)
    rotation = np.stack([axis, across, np.cross(axis, across)], axis=-1)
    position = contact - SET * height[:, None, None] * axis
    probes = _probes() * scales[first + step][:, None]
    points = np.einsum("atij,apj->atpi", rotation, probes) + position[:, :, None]
    depth = terrain.height(points[..., 0], points[..., 1]) - points[..., 2]
    buried = np.maximum(depth / height[:, None, None] + 0.02, 0.0).sum(axis=2)
    older = first[:, None] + np.arange(step)
    local = points[:, :, :, None] - positions[older][:, None, None]
    local = np.einsum("aoij,atpoi->atpoj", rotations[older], local) / scales[older][:, None, None]
    inside = 1 - _length((local - ELLIPSOID[0]) / ELLIPSOID[1])[..., 0]
    overlap = np.maximum(inside, 0.0).sum(axis=(2, 3))
    downward = np.maximum(0.1 - normal[..., 2], 0.0) + np.maximum(0.2 - (axis * normal).sum(axis=-1), 0.0)
    level = (contact[..., 2] - centre[..., 2]) / height[:, None]
    cost = np.round(overlap + 2.0 * buried + 1.5 * downward + LOW * level, 6)
    best = np.argmin(cost, axis=1)
    row = np.arange(a)
    positions[first + step] = position[row, best]
    rotations[first + step] = rotation[row, best]
    hosts[first + step] = host[row, best]


def _contacts(
    host: NDArray[np.int64],
    positions: Array,
    rotations: Array,
    shapes: NDArray[np.integer],
    scales: Array,
    meshes: Sequence[Mesh],
    sites: Sequence[NDArray[np.int64]],
    chance: Array,
) -> tuple[Array, Array]:
    """Points (A, T, 3) on the outsides of hosts (A, T), in `map`, and the normals there."""
    points, normals = np.empty((*host.shape, 3)), np.empty((*host.shape, 3))
    shape = shapes[host]
    for k in np.unique(shape):
        at = shape == k
        vertex = sites[k][(chance[at] * len(sites[k])).astype(int)]
        points[at] = meshes[k].vertices[vertex] * scales[host[at]]
        normals[at] = meshes[k].normals[vertex] / scales[host[at]]
    points = np.einsum("atij,atj->ati", rotations[host], points) + positions[host]
    normals = np.einsum("atij,atj->ati", rotations[host], normals)
    return points, normals / np.maximum(_length(normals), 1e-9)


def _probes() -> Array:
    """Points (P, 3) in a shell of height 1 that should lie in no other."""
    x, y = np.meshgrid([0.3, 0.55, 0.8, 0.98], [-0.25, 0.0, 0.25], indexing="ij")
    flat = np.column_stack([x.ravel(), y.ravel(), np.zeros(x.size)])
    return np.concatenate([flat, [[0.45, 0.0, -0.15], [0.45, 0.0, 0.06]]])


def _length(vectors: Array) -> Array:
    """Lengths (..., 1) of vectors (..., 3)."""
    return np.sqrt((vectors**2).sum(axis=-1, keepdims=True))
