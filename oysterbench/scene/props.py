"""Shapes on the bottom that are not oysters: stones, pieces of shell, tufts of plants, sponges; all watertight."""

from __future__ import annotations

import numpy as np
import trimesh
from numpy.typing import NDArray

from oysterbench.scene.mesh import Mesh, build_mesh, join_meshes

Array = NDArray[np.float64]

SUBDIVISIONS = 3  # 1280 faces
LUMPS = 14
FRAGMENT_CORNERS = 11
BLADE_RINGS = 8


def build_stone(generator: np.random.Generator, subdivisions: int = SUBDIVISIONS) -> Mesh:
    """Stone of mean radius about 1: a sphere cut by rounded facets, squeezed along z and worn unevenly."""
    directions, faces = _sphere(subdivisions)
    normals = generator.standard_normal((LUMPS, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    distances = generator.uniform(0.68, 1.0, LUMPS)
    radius = _facets(directions, normals, distances) * (1 + 0.035 * _bumps(directions, 10, 3.0, 11.0, generator))
    squeeze = np.array([1.0, generator.uniform(0.7, 1.0), generator.uniform(0.45, 0.8)])
    return build_mesh(directions * radius[:, None] * squeeze, faces)


def build_sponge(generator: np.random.Generator) -> Mesh:
    """Sponge of radius about 1 on a surface at z = 0: a few lobes grown into one."""
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
    """Piece of broken shell, about 1 across: a bent plate with a jagged rim; marked as shell, one side its inside."""
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


def build_tuft(generator: np.random.Generator, broad: bool) -> Mesh:
    """Tuft of plants, its longest blade about 1, rooted at z = 0: ribbons of seagrass, or broad crumpled algae.

    Marks: share of the blade's length, the blade's tone, place across.
    """
    blades = int(generator.integers(7, 13)) if broad else int(generator.integers(12, 25))
    lean = generator.uniform(0, 2 * np.pi)  # the current bends all blades one way
    return join_meshes([_blade(generator, broad, lean) for _ in range(blades)])


def _blade(generator: np.random.Generator, broad: bool, lean: float) -> Mesh:
    """A blade: a flat closed tube of four corners, standing on its root and bending over."""
    length = generator.uniform(0.45, 1.0)
    width = length * (generator.uniform(0.10, 0.22) if broad else generator.uniform(0.012, 0.022))
    s = np.linspace(0, 1, BLADE_RINGS)
    heading = lean + (1.6 if broad else 0.7) * generator.standard_normal()
    bend = generator.uniform(0.2, 1.3)
    rise = np.pi / 2 - generator.uniform(0.05, 0.5) - bend * s**1.5
    wave = generator.uniform(0.05, 0.3) * np.sin(2 * np.pi * (generator.uniform(0.6, 1.6) * s + generator.uniform()))
    step = length / (BLADE_RINGS - 1)
    along = np.concatenate([[0.0], np.cumsum(step * np.cos(rise)[1:])])
    up = np.concatenate([[0.0], np.cumsum(step * np.sin(rise)[1:])])
    side = wave * s * length * 0.5
    root = 0.08 * generator.standard_normal(2)
    forward = np.array([np.cos(heading), np.sin(heading)])
    left = np.array([-forward[1], forward[0]])
    middle = np.column_stack([root + along[:, None] * forward + side[:, None] * left, up])
    turn = generator.uniform(0, np.pi) + generator.uniform(-1.5, 1.5) * s
    wide = np.column_stack([np.cos(turn)[:, None] * left + np.sin(turn)[:, None] * forward, 0.3 * np.sin(3 * turn)])
    thick = np.cross(wide, np.gradient(middle, axis=0))
    thick /= np.linalg.norm(thick, axis=1, keepdims=True)
    profile = (0.25 + 1.2 * np.sqrt(s)) * np.sqrt(np.maximum(1.02 - s**3, 0.0)) if broad else np.sqrt(1.02 - s**4)
    half = 0.5 * width * profile[:, None]
    thin = 0.06 if broad else 0.12
    corners = [middle - half * wide, middle + thin * half * thick, middle + half * wide, middle - thin * half * thick]
    rings = np.stack(corners, axis=1)
    vertices = np.concatenate([rings.reshape(-1, 3), middle[:1], middle[-1:]])
    tone = generator.uniform()
    marks = np.column_stack([np.repeat(s, 4), np.full(4 * len(s), tone), np.tile([0.0, 0.5, 1.0, 0.5], len(s))])
    marks = np.concatenate([marks, [[0.0, tone, 0.5], [1.0, tone, 0.5]]])
    here = np.arange(4)
    there = (here + 1) % 4
    start = 4 * np.arange(len(s) - 1)[:, None]
    quads = np.stack([start + here, start + there, start + 4 + there, start + 4 + here], axis=-1).reshape(-1, 4)
    last = 4 * (len(s) - 1)
    caps = [np.column_stack([np.full(4, len(vertices) - 2), there, here])]
    caps.append(np.column_stack([np.full(4, len(vertices) - 1), last + here, last + there]))
    faces = np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]], *caps])
    corners_of = vertices[faces]
    turned = np.einsum("fi,fi->", corners_of[:, 0], np.cross(corners_of[:, 1], corners_of[:, 2])) < 0
    return build_mesh(vertices, faces[:, ::-1] if turned else faces, marks)


def _sphere(subdivisions: int) -> tuple[Array, NDArray[np.int64]]:
    sphere = trimesh.creation.icosphere(subdivisions=subdivisions)
    return np.asarray(sphere.vertices, dtype=float), np.asarray(sphere.faces, dtype=np.int64)


def _bumps(directions: Array, count: int, low: float, high: float, generator: np.random.Generator) -> Array:
    """Smooth noise (V,) of about unit size over directions (V, 3)."""
    waves = generator.standard_normal((count, 3))
    waves *= (generator.uniform(low, high, count) / np.linalg.norm(waves, axis=1))[:, None]
    phases = generator.uniform(0, 2 * np.pi, count)
    return np.sin(directions @ waves.T + phases).sum(axis=1) / np.sqrt(0.5 * count)


def _facets(directions: Array, normals: Array, distances: Array) -> Array:
    """Radius (V,) of a unit ball cut by planes: a smooth minimum (p-norm) over the planes and the ball."""
    cosines = np.maximum(np.einsum("vi,li->vl", directions, normals), 0.0) / distances
    sharpness = 14.0
    return (np.sum(cosines**sharpness, axis=1) + 1.0) ** (-1.0 / sharpness)
