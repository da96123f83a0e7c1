"""Triangle meshes as plain arrays."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial import ConvexHull

POSITION_STEP_M = 2.0**-20
"""Vertices are rounded to this step (about 1 um), so that differences in the last bits of sin() or exp() between CPUs
do not show."""


@dataclass(frozen=True, eq=False)
class Mesh:
    """Triangles: vertices (V, 3) float32, faces (F, 3) int32 counter-clockwise from outside, normals (V, 3) float32.

    marks (V, 3) float32: what the material depends on besides position; for shells: growth, inside and scar.
    """

    vertices: NDArray[np.float32]
    faces: NDArray[np.int32]
    normals: NDArray[np.float32]
    marks: NDArray[np.float32]

    @cached_property
    def hull(self) -> NDArray[np.int64]:
        """Indices of the vertices of the convex hull."""
        return np.sort(ConvexHull(self.vertices.astype(float)).vertices).astype(np.int64)

    def encloses(self, point: ArrayLike) -> bool:
        """Whether a point (3,) lies inside one of the closed solids of a mesh.

        Sum of the solid angles of the triangles (Van Oosterom & Strackee, IEEE Trans. Biomed. Eng. 30, 1983): 4 pi for
        each solid that encloses the point, and 0 otherwise.
        """
        corners = self.vertices[self.faces] - np.asarray(point, dtype=float)  # (F, 3, 3)
        a, b, c = np.moveaxis(corners, 1, 0)
        x, y, z = np.linalg.norm(corners, axis=2).T
        volume = np.einsum("ni,ni->n", a, np.cross(b, c))
        rest = x * y * z + (a * b).sum(1) * z + (b * c).sum(1) * x + (c * a).sum(1) * y
        return bool(np.arctan2(volume, rest).sum() > np.pi)  # halves of the angles


def round_positions(positions: NDArray[np.float64]) -> NDArray[np.float32]:
    """Round positions (...,) to POSITION_STEP_M, as float32."""
    return (np.round(positions / POSITION_STEP_M) * POSITION_STEP_M).astype(np.float32)


def build_mesh(
    vertices: NDArray[np.float64], faces: NDArray[np.integer], marks: NDArray[np.floating] | None = None
) -> Mesh:
    """Build a mesh with area-weighted vertex normals from vertices (V, 3), faces (F, 3) and optional marks (V, 3)."""
    rounded = round_positions(vertices)
    corners = rounded.astype(float)[faces]
    areas = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals = np.zeros((len(rounded), 3))
    for corner in range(3):
        for axis in range(3):
            normals[:, axis] += np.bincount(faces[:, corner], weights=areas[:, axis], minlength=len(rounded))
    lengths = np.linalg.norm(normals, axis=1, keepdims=True)
    normals = np.where(lengths > 0, normals / np.maximum(lengths, 1e-30), [0.0, 0.0, 1.0])
    marked = np.zeros_like(rounded) if marks is None else np.round(marks, 5).astype(np.float32)
    return Mesh(rounded, faces.astype(np.int32), np.round(normals, 6).astype(np.float32), marked)


def join_meshes(meshes: Sequence[Mesh]) -> Mesh:
    """Join meshes into one, without merging vertices."""
    starts = np.cumsum([0, *(len(mesh.vertices) for mesh in meshes[:-1])])
    faces = [mesh.faces + start for mesh, start in zip(meshes, starts, strict=True)]
    return Mesh(
        np.concatenate([mesh.vertices for mesh in meshes]),
        np.concatenate(faces).astype(np.int32),
        np.concatenate([mesh.normals for mesh in meshes]),
        np.concatenate([mesh.marks for mesh in meshes]),
    )
