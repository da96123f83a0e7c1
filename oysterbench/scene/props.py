"""Shapes of non-oyster objects on the bottom: stones, pieces of shell, sponges; all watertight."""

from __future__ import annotations

import numpy as np
import trimesh
from numpy.typing import NDArray

from oysterbench.core.geometry import Array
from oysterbench.scene.mesh import Mesh, build_mesh

SUBDIVISIONS = 3  # 1280 faces
LUMPS = 14
FRAGMENT_CORNERS = 11


def build_stone(generator: np.random.Generator, subdivisions: int = SUBDIVISIONS) -> Mesh:
    """Build a stone of mean radius about 1: a sphere cut by rounded facets, squeezed along z and worn unevenly."""
    directions, faces = _sphere(subdivisions)
    normals = generator.standard_normal((LUMPS, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    distances = generator.uniform(0.68, 1.0, LUMPS)
    radius = _facets(directions, normals, distances) * (1 + 0.035 * _bumps(directions, 10, 3.0, 11.0, generator))
    squeeze = np.array([1.0, generator.uniform(0.7, 1.0), generator.uniform(0.45, 0.8)])
    return build_mesh(directions * radius[:, None] * squeeze, faces)


def build_sponge(generator: np.random.Generator) -> Mesh:
    """Build a sponge of radius about 1 on a surface at z = 0: a few lobes merged into one."""
    directions, faces = _sphere(SUBDIVISIONS)
    lobes = generator.standard_normal((7, 3))
    lobes[:, 2] = np.abs(lobes[:, 2])
    lobes /= np.linalg.norm(lobes, axis=1, keepdims=True)
    cosines = np.einsum("vi,li->vl", directions, lobes)
    swell = np.exp(9.0 * (cosines - 1.0)) @ generator.uniform(0.25, 0.75, 7)
    radius = 0.65 + swell + 0.05 * _bumps(directions, 12, 3.0, 9.0, generator)
    vertices = directions * radius[:, None]
    vertices[:, 2] = np.where(vertices[:, 2] > 0, vertices[:, 2], 0.35 * vertices[:, 2])
    return build_mesh(vertices, faces)


def build_fragment(generator: np.random.Generator) -> Mesh:
    """Build a piece of broken shell about 1 across: a bent plate with a jagged rim, marked as shell with one side as
    its inside."""
    n = FRAGMENT_CORNERS
    angle = 2 * np.pi * (np.arange(n) + generator.uniform(-0.35, 0.35, n)) / n
    radius = 0.5 * np.exp(0.22 * generator.standard_normal(n))
    stretch = generator.uniform(0.45, 0.9)
    rim = np.column_stack([radius * np.cos(angle), stretch * radius * np.sin(angle)])
    places = np.concatenate([rim, 0.62 * rim, [[0.0, 0.0]]])
    bend = generator.uniform(-0.5, 0.5, 3)
    height = bend[0] * places[:, 0] ** 2 + bend[1] * places[:, 1] ** 2 + bend[2] * places[:, 0] * places[:, 1]
    thickness = generator.uniform(0.025, 0.06)
    sides = []
    for side in (1, -1):
        wall = np.concatenate([np.full(n, 0.45), np.ones(n + 1)]) * thickness * side
        sides.append(np.column_stack([places, height + wall]))
    vertices = np.concatenate(sides)
    here = np.arange(n)
    there = (here + 1) % n
    ring = np.concatenate([np.column_stack([here, there, n + there]), np.column_stack([here, n + there, n + here])])
    top = np.concatenate([ring, np.column_stack([n + here, n + there, np.full(n, 2 * n)])])
    below = top[:, ::-1] + len(places)
    low = here + len(places), there + len(places)
    edge = np.concatenate([np.column_stack([here, low[0], low[1]]), np.column_stack([here, low[1], there])])
    marks = np.zeros((len(vertices), 3))
    marks[:, 0] = 0.5 + 0.3 * vertices[:, 0]
    marks[len(places) :, 1] = 1.0
    return build_mesh(vertices, np.concatenate([top, below, edge]), marks)


def _sphere(subdivisions: int) -> tuple[Array, NDArray[np.int64]]:
    sphere = trimesh.creation.icosphere(subdivisions=subdivisions)
    return np.asarray(sphere.vertices, dtype=float), np.asarray(sphere.faces, dtype=np.int64)


def _bumps(directions: Array, count: int, low: float, high: float, generator: np.random.Generator) -> Array:
    """Smooth noise (V,) of about unit amplitude over directions (V, 3)."""
    waves = generator.standard_normal((count, 3))
    waves *= (generator.uniform(low, high, count) / np.linalg.norm(waves, axis=1))[:, None]
    phases = generator.uniform(0, 2 * np.pi, count)
    return np.asarray(np.sin(directions @ waves.T + phases).sum(axis=1) / np.sqrt(0.5 * count))


def _facets(directions: Array, normals: Array, distances: Array) -> Array:
    """Radius (V,) of a unit ball cut by planes: a smooth minimum (p-norm) of the planes and the ball."""
    cosines = np.maximum(np.einsum("vi,li->vl", directions, normals), 0.0) / distances
    sharpness = 14.0
    return np.asarray((np.sum(cosines**sharpness, axis=1) + 1.0) ** (-1.0 / sharpness))
