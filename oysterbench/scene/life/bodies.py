"""Parts from which bodies are assembled: skins over rings, limbs, and thin blades; all closed."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from oysterbench.core.geometry import Array
from oysterbench.scene.mesh import Mesh, build_mesh


def skin(rings: Array, ends: Array, marks: Array, end_marks: Array) -> Mesh:
    """Closed skin over rings (R, P, 3) of points between two end points (2, 3), with marks (R, P, 3) and (2, 3)."""
    count, sides = rings.shape[:2]
    here = np.arange(sides)
    there = (here + 1) % sides
    low = sides * np.arange(count - 1)[:, None]
    quads = np.stack([low + here, low + there, low + sides + there, low + sides + here], axis=-1).reshape(-1, 4)
    first, last = count * sides, count * sides + 1
    top = sides * (count - 1)
    faces = np.concatenate(
        [
            quads[:, [0, 1, 2]],
            quads[:, [0, 2, 3]],
            np.column_stack([np.full(sides, first), there, here]),
            np.column_stack([np.full(sides, last), top + here, top + there]),
        ]
    )
    points = np.concatenate([rings.reshape(-1, 3), ends])
    return outward(points, faces, np.concatenate([marks.reshape(-1, 3), end_marks]))


def limb(path: Array, radii: Array, mark: tuple[float, float, float], sides: int = 6) -> Mesh:
    """Limb of circular section along points (N, 3), of radii (N,), with pointed ends."""
    along = np.gradient(path, axis=0)
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    span = path[-1] - path[0]
    aside = np.eye(3)[np.argmin(np.abs(span))]
    across = np.cross(along, aside)
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    other = np.cross(along, across)
    turn = 2 * np.pi * np.arange(sides) / sides
    wall = np.cos(turn)[:, None] * across[:, None] + np.sin(turn)[:, None] * other[:, None]
    rings = path[:, None] + radii[:, None, None] * wall
    ends = np.stack([path[0] - radii[0] * along[0], path[-1] + radii[-1] * along[-1]])
    return skin(rings, ends, np.broadcast_to(mark, rings.shape), np.broadcast_to(mark, (2, 3)))


def ball(centre: Array, half_axes: Array, mark: tuple[float, float, float], sides: int = 10) -> Mesh:
    """Ellipsoid with half axes (3,) along x, y, z."""
    polar = np.linspace(0, np.pi, sides // 2 + 2)[1:-1]
    turn = 2 * np.pi * np.arange(sides) / sides
    x = np.cos(polar)[:, None] * np.ones(sides)
    y, z = (np.sin(polar)[:, None] * wave(turn) for wave in (np.cos, np.sin))
    rings = centre + half_axes * np.stack([x, y, z], axis=-1)
    ends = centre + half_axes * np.array([[1.0, 0.0, 0.0], [-1.0, 0.0, 0.0]])
    return skin(rings, ends, np.broadcast_to(mark, rings.shape), np.broadcast_to(mark, (2, 3)))


def blade(root: Array, tip: Array, thick: Array, root_marks: Array, tip_marks: Array) -> Mesh:
    """Thin sheet between two edges (N, 3), with half thickness `thick` (3,) or (N, 3) at its root and 0.3 times that at
    its tip; with marks (N, 3) along both edges."""
    rings = np.stack([root - thick, root + thick, tip + 0.3 * thick, tip - 0.3 * thick], axis=1)
    marks = np.stack([root_marks, root_marks, tip_marks, tip_marks], axis=1)
    ends = rings[[0, -1]].mean(axis=1)
    return skin(rings, ends, marks, marks[[0, -1]].mean(axis=1))


def outward(points: Array, faces: NDArray[np.integer], marks: Array) -> Mesh:
    """Closed mesh with faces oriented so that its volume is positive."""
    a, b, c = (points[faces[:, k]] - points.mean(axis=0) for k in range(3))
    volume = np.einsum("fi,fi->", a, np.cross(b, c))
    return build_mesh(points, faces[:, ::-1] if volume < 0 else faces, marks)
