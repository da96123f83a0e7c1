"""Placed meshes: a table of instances, and lowering things onto the relief."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from oysterbench.core.geometry import Array
from oysterbench.recipe import CLASSES
from oysterbench.scene.mesh import Mesh, round_positions
from oysterbench.scene.terrain import Terrain

CLASS_NUMBERS = {name: number for number, name in CLASSES.items()}
ROWS_AT_ONCE = 512  # bounds the memory needed for placing


@dataclass(frozen=True)
class Instances:
    """Placed meshes. A point p of shape `shape` lies at `rotation @ (scale * p) + position` in `map`.

    ids (N,) uint16 from 1; classes (N,) uint8 as in recipe.CLASSES; shapes (N,) int32, index of the mesh; positions
    (N, 3) m and rotations (N, 3, 3); scales (N, 3) m per unit of the mesh; colours (N, 3) linear albedo; silt (N,)
    share of an upward face that is covered with silt; sunk (N,) depth (m) of the lowest point below the seabed, for
    instances that rest on it; hosts (N,) uint16, id of the instance that this one grows on, 0 for the seabed.
    """

    ids: NDArray[np.uint16]
    classes: NDArray[np.uint8]
    shapes: NDArray[np.int32]
    positions: NDArray[np.float32]
    rotations: NDArray[np.float32]
    scales: NDArray[np.float32]
    colours: NDArray[np.float32]
    silt: NDArray[np.float32]
    sunk: NDArray[np.float32]
    hosts: NDArray[np.uint16]

    def __len__(self) -> int:
        return len(self.ids)

    def take(self, chosen: NDArray[np.generic]) -> Instances:
        """Select instances by index array or mask."""
        return Instances(**{f.name: getattr(self, f.name)[chosen] for f in fields(self)})

    def vertices(self, meshes: Sequence[Mesh], index: int) -> Array:
        """Vertices (V, 3) of the instance in row `index`, in `map`, m."""
        local = meshes[self.shapes[index]].vertices * self.scales[index].astype(float)
        return np.asarray(np.einsum("ij,vj->vi", self.rotations[index].astype(float), local) + self.positions[index])


def make_instances(
    class_name: str,
    shapes: NDArray[np.integer],
    positions: Array,
    rotations: Array,
    scales: Array,
    colours: Array,
    silt: Array,
    sunk: Array | None = None,
    hosts: NDArray[np.integer] | None = None,
) -> Instances:
    """Table of instances with ids from 1, its values rounded so that they are the same on every processor."""
    n = len(shapes)
    return Instances(
        ids=np.arange(1, n + 1).astype(np.uint16),
        classes=np.full(n, CLASS_NUMBERS[class_name], dtype=np.uint8),
        shapes=shapes.astype(np.int32),
        positions=round_positions(positions),
        rotations=np.round(rotations, 6).astype(np.float32),
        scales=round_positions(scales),
        colours=np.round(np.clip(colours, 0.02, 0.8), 5).astype(np.float32),
        silt=np.round(silt, 5).astype(np.float32),
        sunk=round_positions(np.zeros(n) if sunk is None else sunk),
        hosts=np.zeros(n, dtype=np.uint16) if hosts is None else hosts.astype(np.uint16),
    )


def join_instances(parts: Sequence[Instances]) -> Instances:
    """Join tables into one, with ids renumbered from 1; hosts must already be ids in the joint table."""
    values = {f.name: np.concatenate([getattr(part, f.name) for part in parts]) for f in fields(Instances)}
    values["ids"] = np.arange(1, len(values["ids"]) + 1).astype(np.uint16)
    return Instances(**values)


def placed_vertices(
    meshes: Sequence[Mesh], instances: Instances, hulls: bool = False
) -> Iterator[tuple[NDArray[np.intp], Array]]:
    """Yield rows (n,) of instances that share a shape, with their vertices (n, V, 3) in `map`, m; each row occurs once.

    hulls: only the vertices of the convex hulls, which suffice for boxes and for lowering things onto the relief.
    """
    for shape, mesh in enumerate(meshes):
        rows = np.flatnonzero(instances.shapes == shape)
        if not len(rows):
            continue
        points = (mesh.vertices[mesh.hull] if hulls else mesh.vertices).astype(float)
        for chosen in np.array_split(rows, len(rows) // ROWS_AT_ONCE + 1):
            if len(chosen):
                # Written out: as fast as a matrix product, whose order of summation depends on the CPU.
                matrix = instances.rotations[chosen].astype(float) * instances.scales[chosen, None]
                placed = np.empty((len(chosen), len(points), 3))
                for axis in range(3):
                    a, b, c = (matrix[:, axis, k, None] * points[:, k] for k in range(3))
                    placed[..., axis] = a + b + c + instances.positions[chosen, axis, None]
                yield chosen, placed


def rest(instances: Instances, terrain: Terrain, meshes: Sequence[Mesh]) -> Instances:
    """Lower each instance at its x, y until, relative to the relief below, its lowest point is `sunk` m deep."""
    positions = instances.positions.copy()
    for chosen, vertices in placed_vertices(meshes, instances, hulls=True):
        ground = terrain.height(vertices[..., 0], vertices[..., 1])
        clearance = (vertices[..., 2] - ground).min(axis=1)
        positions[chosen, 2] = round_positions(instances.positions[chosen, 2] - clearance - instances.sunk[chosen])
    values = {f.name: getattr(instances, f.name) for f in fields(Instances)}
    return Instances(**{**values, "positions": positions})


def lean_with(terrain: Terrain, places: Array, rotations: Array, reach: float) -> Array:
    """Tilt rotations (N, 3, 3), given for level ground, with the slope at places (N, 2), taken over +-`reach` m."""
    x, y = places.T
    slope_x = (terrain.height(x + reach, y) - terrain.height(x - reach, y)) / (2 * reach)
    slope_y = (terrain.height(x, y + reach) - terrain.height(x, y - reach)) / (2 * reach)
    lean = Rotation.from_rotvec(np.column_stack([np.arctan(slope_y), -np.arctan(slope_x), np.zeros(len(x))]))
    return np.asarray(np.einsum("nij,njk->nik", lean.as_matrix().reshape(-1, 3, 3), rotations))
