"""Triangle meshes as plain arrays."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

POSITION_STEP_M = 2.0**-20
"""Vertices are rounded to this step (about 1 um), so that the last bits of a CPU's sin() or exp() do not show."""


@dataclass(frozen=True)
class Mesh:
    """Triangles: vertices (V, 3) float32, faces (F, 3) int32 counter-clockwise from outside, normals (V, 3) float32."""

    vertices: NDArray[np.float32]
    faces: NDArray[np.int32]
    normals: NDArray[np.float32]


def round_positions(positions: NDArray[np.float64]) -> NDArray[np.float32]:
    """Positions (...,) rounded to POSITION_STEP_M, float32."""
    return (np.round(positions / POSITION_STEP_M) * POSITION_STEP_M).astype(np.float32)


def build_mesh(vertices: NDArray[np.float64], faces: NDArray[np.integer]) -> Mesh:
    """Mesh with area-weighted vertex normals, from vertices (V, 3) and faces (F, 3)."""
    rounded = round_positions(vertices)
    corners = rounded.astype(float)[faces]
    areas = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals = np.zeros((len(rounded), 3))
    for corner in range(3):
        for axis in range(3):
            normals[:, axis] += np.bincount(faces[:, corner], weights=areas[:, axis], minlength=len(rounded))
    lengths = np.linalg.norm(normals, axis=1, keepdims=True)
    normals = np.where(lengths > 0, normals / np.maximum(lengths, 1e-30), [0.0, 0.0, 1.0])
    return Mesh(rounded, faces.astype(np.int32), np.round(normals, 6).astype(np.float32))
