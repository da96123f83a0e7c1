"""Trees of boxes, four per node: a ray is tested against the boxes of a node, or the triangles of a leaf, in parallel.

Wide and shallow as in Dammertz, Hanika & Keller (2008, "Shallow bounding volume hierarchies for fast SIMD ray
tracing"), split at medians along the longest axis; triangles as in Woop, Benthin & Wald (2013, "Watertight
ray/triangle intersection").
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import warp as wp
from numpy.typing import NDArray

from oysterbench.scene.mesh import Mesh

WIDTH = 4
MARGIN = 1e-6  # margin of boxes for rounding, relative to their coordinates


@dataclass(frozen=True)
class Forest:
    """Trees over items stored consecutively.

    planes (6 N, 4) float32: for each node, the low and the high sides of its four boxes along x, y and z. children
    (N, 4) int32: a node, or -1 - leaf. roots (M,) int32: root node of each tree. leaves (L, leaf) int32: items, -1 for
    none.
    """

    planes: NDArray[np.float32]
    children: NDArray[np.int32]
    roots: NDArray[np.int32]
    leaves: NDArray[np.int32]


@wp.struct
class Library:
    """Meshes on a device, each with a tree. triangles (9 L,): x, y, z of the three corners of the four triangles of
    each leaf; faces (4 L,): index of each triangle in its mesh."""

    planes: wp.array(dtype=wp.vec4)
    children: wp.array(dtype=wp.vec4i)
    triangles: wp.array(dtype=wp.vec4)
    faces: wp.array(dtype=wp.int32)


@wp.struct
class Tree:
    """A tree on a device, as in Forest, whose leaves are single items: a child is a node, or -1 - item."""

    planes: wp.array(dtype=wp.vec4)
    children: wp.array(dtype=wp.vec4i)


def build_forest(low: NDArray[np.float32], high: NDArray[np.float32], counts: list[int], leaf: int) -> Forest:
    """Build trees over boxes from low (N, 3) to high (N, 3), counts[k] of them in tree k and up to `leaf` per leaf."""
    order = np.arange(len(low))
    centre = low.astype(float) + high
    size = np.array(counts)
    start = np.cumsum(size) - size
    roots = np.arange(len(counts), dtype=np.int32)
    planes, children, leaves = [], [], []
    nodes, filled = len(counts), 0
    while len(start):
        for _ in range(2):
            start, size = _halve(start, size, order, centre, leaf)
        some = size > 0
        low_corner, high_corner = np.full((len(size), 3), np.inf), np.full((len(size), 3), -np.inf)
        place, owner = _places(start[some], size[some])
        first = np.flatnonzero(np.diff(owner, prepend=-1))
        low_corner[some] = np.minimum.reduceat(low[order[place]], first)
        high_corner[some] = np.maximum.reduceat(high[order[place]], first)
        slack = MARGIN * np.maximum(np.abs(low_corner), np.abs(high_corner)).max(axis=1, keepdims=True, initial=0.0)
        slack = np.where(some[:, None], slack, 0.0)
        sides = np.stack([low_corner - slack, high_corner + slack], axis=2).reshape(-1, WIDTH, 6)
        planes.append(sides.transpose(0, 2, 1).astype(np.float32))
        last, inner = some & (size <= leaf), size > leaf
        child = np.full(len(size), -1, dtype=np.int32)
        child[last] = -1 - (filled + np.arange(last.sum()))
        child[inner] = nodes + np.arange(inner.sum())
        children.append(child.reshape(-1, WIDTH))
        slots = start[last, None] + np.arange(leaf)
        within = np.arange(leaf) < size[last, None]
        leaves.append(np.where(within, order[np.minimum(slots, len(order) - 1)], -1))
        filled += int(last.sum())
        nodes += int(inner.sum())
        start, size = start[inner], size[inner]
    return Forest(
        np.concatenate(planes).reshape(-1, WIDTH),
        np.concatenate(children),
        roots,
        np.concatenate(leaves).astype(np.int32),
    )


def _places(start: NDArray[np.int64], size: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Positions of all items of non-empty runs, and the run to which each belongs."""
    owner = np.repeat(np.arange(len(size)), size)
    return start[owner] + np.arange(len(owner)) - (np.cumsum(size) - size)[owner], owner


def _halve(
    start: NDArray[np.int64], size: NDArray[np.int64], order: NDArray[np.int64], centre: NDArray[np.float64], leaf: int
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Halve runs of `order` in whole leaves, sorting them in place along the longest axis; runs that fit into a leaf
    stay whole. Returns start and size of the halves."""
    wide = size > leaf
    if wide.any():
        place, owner = _places(start[wide], size[wide])
        at = centre[order[place]]
        first = np.flatnonzero(np.diff(owner, prepend=-1))
        extent = np.maximum.reduceat(at, first) - np.minimum.reduceat(at, first)
        along = at[np.arange(len(at)), np.argmax(extent, axis=1)[owner]]
        order[place] = order[place][np.lexsort((along, owner))]
    blocks = -(-size // leaf)
    left = np.where(wide, np.minimum(-(-blocks // 2) * leaf, size), size)
    return np.stack([start, start + left], axis=1).ravel(), np.stack([left, size - left], axis=1).ravel()


def upload_tree(low: NDArray[np.float32], high: NDArray[np.float32], device: str) -> Tree:
    """Build a tree over boxes from low (N, 3) to high (N, 3) on a device."""
    forest = build_forest(low, high, [len(low)], 1)
    children = forest.children.copy()
    children[children < 0] = -1 - forest.leaves[-1 - children[children < 0], 0]
    tree = Tree()
    tree.planes = wp.array(forest.planes, dtype=wp.vec4, device=device)
    tree.children = wp.array(children, dtype=wp.vec4i, device=device)
    return tree


@lru_cache(maxsize=1)
def upload_library(meshes: tuple[Mesh, ...], device: str) -> tuple[Library, NDArray[np.int32]]:
    """Meshes on a device, uploaded once for all cameras and sonars of a reef, and the roots (M,) of their trees."""
    corners = np.concatenate([mesh.vertices[mesh.faces] for mesh in meshes])
    counts = [len(mesh.faces) for mesh in meshes]
    forest = build_forest(corners.min(axis=1), corners.max(axis=1), counts, WIDTH)
    there = (forest.leaves >= 0)[..., None, None]
    triangles = np.where(there, corners[forest.leaves], np.float32(0.0))
    number = np.concatenate([np.arange(count) for count in counts])
    library = Library()
    library.planes = wp.array(forest.planes, dtype=wp.vec4, device=device)
    library.children = wp.array(forest.children, dtype=wp.vec4i, device=device)
    sides = np.ascontiguousarray(triangles.transpose(0, 2, 3, 1)).reshape(-1, WIDTH)
    library.triangles = wp.array(sides, dtype=wp.vec4, device=device)
    library.faces = wp.array(number[forest.leaves].ravel(), dtype=wp.int32, device=device)
    return library, forest.roots
