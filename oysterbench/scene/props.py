"""Things on the bottom that are not oysters: stones, deformed icospheres."""

from __future__ import annotations

import numpy as np
import trimesh
from numpy.typing import NDArray

from oysterbench.scene.mesh import Mesh, build_mesh

SUBDIVISIONS = 3  # 1280 faces
LUMPS = 14


def build_stone(generator: np.random.Generator) -> Mesh:
    """Watertight stone of mean radius about 1: a sphere cut by rounded facets and squeezed along z."""
    sphere = trimesh.creation.icosphere(subdivisions=SUBDIVISIONS)
    directions = np.asarray(sphere.vertices, dtype=float)
    normals = generator.standard_normal((LUMPS, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    distances = generator.uniform(0.68, 1.0, LUMPS)
    radius = _facets(directions, normals, distances)
    squeeze = np.array([1.0, generator.uniform(0.7, 1.0), generator.uniform(0.45, 0.8)])
    return build_mesh(directions * radius[:, None] * squeeze, np.asarray(sphere.faces, dtype=np.int64))


def _facets(directions: NDArray[np.float64], normals: NDArray[np.float64], distances: NDArray[np.float64]):
    """Radius (V,) of a unit ball cut by planes: a smooth minimum (p-norm) over the planes and the ball."""
    cosines = np.maximum(np.einsum("vi,li->vl", directions, normals), 0.0) / distances
    sharpness = 14.0
    return (np.sum(cosines**sharpness, axis=1) + 1.0) ** (-1.0 / sharpness)
