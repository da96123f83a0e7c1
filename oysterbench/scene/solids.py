"""Closed solids of a single colour from which machines are assembled; a mesh's marks hold its linear albedo."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike, NDArray

from oysterbench.core.geometry import Array
from oysterbench.scene.mesh import Mesh, build_mesh

Colour = tuple[float, float, float]

SIDES = 28  # around a circular cross-section
EDGE_STEPS = 4  # per quarter circle of a rounded edge


def tube(start: ArrayLike, end: ArrayLike, radius: float, colour: Colour) -> Mesh:
    """Capped cylinder between two points, with hard rims."""
    begin, stop = np.asarray(start, dtype=float), np.asarray(end, dtype=float)
    length = float(np.linalg.norm(stop - begin))
    return _turned(begin, stop - begin, [(0.0, 0.0), (radius, 0.0), (radius, length), (0.0, length)], colour)


def ring(centre: ArrayLike, axis: ArrayLike, outer: float, inner: float, length: float, colour: Colour) -> Mesh:
    """Duct about an axis: a tube whose wall lies between two radii, m."""
    direction = np.asarray(axis, dtype=float)
    half = 0.5 * length
    profile = [(inner, -half), (outer, -half), (outer, half), (inner, half), (inner, -half)]
    return _turned(np.asarray(centre, dtype=float), direction, profile, colour)


def dome(
    centre: ArrayLike, radius: float, colour: Colour, axes: Sequence[Array] | None = None, whole: bool = False
) -> Mesh:
    """Hemisphere that bulges along x, or along `axes` (three half axes in units of the radius); `whole`: full ball."""
    u, v, w = (np.asarray(a, dtype=float) for a in (axes if axes is not None else np.eye(3)))
    steps = 6 if whole else 9
    polar = np.linspace(0.0, np.pi if whole else 0.5 * np.pi, steps)
    turn = 2 * np.pi * np.arange(SIDES) / SIDES
    rings = [np.cos(p) * u + np.sin(p) * (np.cos(turn)[:, None] * v + np.sin(turn)[:, None] * w) for p in polar[1:]]
    if whole:
        rings = rings[:-1]
    end = -u if whole else np.zeros(3)
    points = np.concatenate([u[None], *rings, end[None]])
    return _closed(np.asarray(centre, dtype=float) + radius * points, _stack(len(rings), SIDES), colour)


def bent_tube(path: Array, radius: float, colour: Colour, sides: int = 8) -> Mesh:
    """Hose along points (N, 3), m."""
    along = np.gradient(path, axis=0)
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    across = np.cross(along, [0.0, 1.0, 0.0])
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    other = np.cross(along, across)
    turn = 2 * np.pi * np.arange(sides) / sides
    wall = path[:, None] + radius * (np.cos(turn)[:, None] * across[:, None] + np.sin(turn)[:, None] * other[:, None])
    points = np.concatenate([path[:1], wall.reshape(-1, 3), path[-1:]])
    return _closed(points, _stack(len(path), sides), colour)


def rounded_box(centre: ArrayLike, size: ArrayLike, radius: float, colour: Colour) -> Mesh:
    """Box with edges and corners rounded to a radius, m: a ball pulled apart along its three mid-planes."""
    half = 0.5 * np.asarray(size, dtype=float) - radius
    quarter = np.linspace(0.0, 0.5 * np.pi, EDGE_STEPS + 1)
    turn = np.concatenate([quarter + 0.5 * np.pi * k for k in range(4)])
    polar = np.concatenate([quarter, quarter + 0.5 * np.pi])
    signs = np.array([[1, 1], [-1, 1], [-1, -1], [1, -1]], dtype=float)
    corner = np.repeat(signs, EDGE_STEPS + 1, axis=0)
    rings = []
    for k, p in enumerate(polar):
        level = 1.0 if k <= EDGE_STEPS else -1.0
        flat = radius * np.sin(p) * np.column_stack([np.cos(turn), np.sin(turn)]) + corner * half[:2]
        rings.append(np.column_stack([flat, np.full(len(turn), radius * np.cos(p) + level * half[2])]))
    lid = half[2] + radius
    points = np.concatenate([[[0.0, 0.0, lid]], *rings, [[0.0, 0.0, -lid]]])
    return _closed(np.asarray(centre, dtype=float) + points, _stack(len(rings), len(turn)), colour)


def plate(outline: Array, y: float, thickness: float, colour: Colour) -> Mesh:
    """Flat sheet normal to y with hard rims; outline (N, 2) in x and z, m, star-shaped about its mean."""
    middle = outline.mean(axis=0)
    levels = (y - 0.5 * thickness, y + 0.5 * thickness)
    place = [np.column_stack([outline[:, 0], np.full(len(outline), level), outline[:, 1]]) for level in levels]
    lids = [np.array([[middle[0], level, middle[1]]]) for level in levels]
    # Each rim twice: once for the lid's normals, once for the wall's.
    points = np.concatenate([lids[0], place[0], place[0], place[1], place[1], lids[1]])
    return _closed(points, _stack(4, len(outline), walls=(1,)), colour)


def _turned(origin: Array, axis: Array, profile: Sequence[tuple[float, float]], colour: Colour) -> Mesh:
    """Solid of revolution, closed at both ends, from a profile of (radius, distance along the axis); hard corners."""
    along = axis / np.linalg.norm(axis)
    across = np.cross(along, [0.0, 0.0, 1.0] if abs(along[2]) < 0.9 else [1.0, 0.0, 0.0])
    across /= np.linalg.norm(across)
    other = np.cross(along, across)
    turn = 2 * np.pi * np.arange(SIDES) / SIDES
    spokes = np.cos(turn)[:, None] * across + np.sin(turn)[:, None] * other
    points, faces = [], []
    here = np.arange(SIDES)
    there = (here + 1) % SIDES
    count = 0
    for (r0, a0), (r1, a1) in pairwise(profile):
        points += [origin + r0 * spokes + a0 * along, origin + r1 * spokes + a1 * along]
        low, high = count, count + SIDES
        if r1 > 0:
            faces.append(np.column_stack([low + here, high + there, high + here]))
        if r0 > 0:
            faces.append(np.column_stack([low + here, low + there, high + there]))
        count += 2 * SIDES
    return _closed(np.concatenate(points), np.concatenate(faces), colour)


def _stack(rings: int, sides: int, walls: Sequence[int] | None = None) -> NDArray[np.int64]:
    """Faces over rings of points between a first and a last point; walls: rings followed by a wall (default all)."""
    here = np.arange(sides)
    there = (here + 1) % sides
    faces = [np.column_stack([np.zeros(sides, int), 1 + there, 1 + here])]
    for k in range(rings - 1):
        if walls is not None and k not in walls:
            continue
        low, high = 1 + k * sides, 1 + (k + 1) * sides
        faces += [
            np.column_stack([low + here, low + there, high + there]),
            np.column_stack([low + here, high + there, high + here]),
        ]
    last = 1 + (rings - 1) * sides
    faces.append(np.column_stack([np.full(sides, last + sides), last + here, last + there]))
    return np.concatenate(faces)


def _closed(points: Array, faces: NDArray[np.int64], colour: Colour) -> Mesh:
    """Mesh of a single colour with outward-facing faces."""
    a, b, c = (points[faces[:, k]] for k in range(3))
    inward = np.einsum("fi,fi->", a - points.mean(axis=0), np.cross(b - a, c - a)) < 0
    return build_mesh(points, faces[:, ::-1] if inward else faces, np.tile(colour, (len(points), 1)))
