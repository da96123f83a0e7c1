"""Moving things on a device: rows of Geometry.placed that are updated for each moment, with their own trees.

Swaying plants keep their tree, whose boxes are refitted; that of roaming things is rebuilt, because the tree of a
moment must not depend on which moments came before.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray
from scipy import ndimage

from oysterbench.render.casting import Geometry, Placed
from oysterbench.scene.instances import Instances
from oysterbench.scene.life import Life
from oysterbench.scene.world import World

Rows = NDArray[Any]
"""Rows (N,) of the structure Placed."""

MARGIN_M = 1e-4  # of boxes around shapes
SHADED_CELL_M, SHADED_MARGIN_M = 0.1, 1.0  # cell of the grid of possible shadows, and its margin around the reef
SHADOW_STEPS = 32  # along a direction of the sun
LEAST_SINE = 0.1  # of the sun's elevation under water, which is never below 40 degrees


class Meshes:
    """Location of each mesh in a device's library: roots (K,) of their trees and first_corner (K,)."""

    def __init__(self, roots: NDArray[np.int32], corner_counts: list[int]) -> None:
        self.roots = roots
        self.first_corner = np.cumsum([0, *corner_counts[:-1]])

    def rows(self, instances: Instances, first_shape: int = 0) -> Rows:
        """Rows for a table of instances whose shapes are numbered from first_shape of the library."""
        shapes = instances.shapes + first_shape
        placed = no_rows(len(instances))
        placed["to_shape"] = np.swapaxes(instances.rotations, 1, 2).astype(float) / instances.scales[:, :, None]
        placed["position"] = instances.positions
        placed["root"] = self.roots[shapes]
        placed["rotation"] = instances.rotations
        placed["scale"] = instances.scales
        placed["first_corner"] = self.first_corner[shapes]
        placed["colour"] = instances.colours
        placed["silt"] = instances.silt
        placed["kind"] = instances.classes
        placed["number"] = instances.ids
        return placed


def no_rows(count: int = 0) -> Rows:
    """Rows of zeros."""
    return np.zeros(count, dtype=Placed.numpy_dtype())  # type: ignore[attr-defined]


def _joined(first: Rows, second: Rows) -> Rows:
    """Concatenate rows; numpy's own concatenation would pack the structure more tightly than the device does."""
    rows = no_rows(len(first) + len(second))
    rows[: len(first)], rows[len(first) :] = first, second
    return rows


class Movers:
    """Updates the moving things of a geometry. Their rows are the last ones: swaying plants, then roaming things."""

    def __init__(self, geometry: Geometry, world: World, life: Life, meshes: Meshes, rows: Rows, device: str) -> None:
        """Set the geometry's rows and trees of moving things; rows (N,): those of the world alone."""
        self._geometry, self._life, self._meshes, self._device = geometry, life, meshes, device
        self._shapes = len(world.meshes)
        self.first = len(rows) if life.sway is None else int(life.sway.rows[0])
        self._still = rows[self.first :]
        lowers, uppers = (corner[self.first :].astype(float) for corner in world.boxes)
        self._low, self._high = (c - self._still["position"].astype(float) for c in (lowers, uppers))
        bounds = [(mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)) for mesh in life.meshes]
        self._boxes = np.array(bounds, dtype=float).reshape(-1, 2, 3)
        moving = self.rows_at(0.0)
        geometry.placed = wp.array(_joined(rows[: self.first], moving), dtype=Placed, device=device)
        geometry.first_roaming = self.first + len(self._still)
        self._roamers = len(moving) - len(self._still)
        self._swaying = self._tree(lowers, uppers)
        self._roaming = self._tree(*self._bounds(moving[len(self._still) :]))
        if self._swaying is not None:
            geometry.first_swaying, geometry.swaying_count = self.first, len(self._still)
            geometry.swaying = self._swaying.id
        if self._roaming is not None:
            geometry.roaming = self._roaming.id
        half = world.terrain.coordinates[-world.terrain.rim - 1] + SHADED_MARGIN_M
        cells = int(np.ceil(2 * half / SHADED_CELL_M))
        geometry.shaded = wp.zeros((cells, cells), dtype=wp.uint8, device=device)
        geometry.shaded_start, geometry.shaded_step = -float(half), SHADED_CELL_M
        self._lowest = float(world.terrain.heights.min())
        self._fan = np.zeros((0, 3))
        self.move(None)

    def move(self, time_s: float | None) -> None:
        """Place everything for a time, s; with None, plants stand still and nothing roams."""
        moving = _joined(self._still, no_rows(self._roamers)) if time_s is None else self.rows_at(time_s)
        wp.copy(self._geometry.placed, wp.array(moving, dtype=Placed, device=self._device), dest_offset=self.first)
        plants, others = np.split(moving, [len(self._still)])
        if self._swaying is not None:
            self._assign(self._swaying, *self._leaning(plants, time_s))
            self._swaying.refit()
        self._geometry.roaming_count = 0 if time_s is None else self._roamers
        if self._geometry.roaming_count and len(self._fan):
            shaded = self._shaded(*self._bounds(others))
            self._geometry.shaded.assign(shaded)
        if self._geometry.roaming_count:
            assert self._roaming is not None
            self._assign(self._roaming, *self._bounds(others))
            self._roaming.rebuild()

    def throw_shadows(self, fan: NDArray[np.float32]) -> None:
        """From now on, record where shadows may fall; fan (N, 3): unit vectors towards all light that casts them."""
        self._fan = fan.astype(float)

    def _shaded(self, lowers: NDArray[np.float64], uppers: NDArray[np.float64]) -> NDArray[np.uint8]:
        """Cells of the grid over the reef that may lie in the shadow of a box, along any direction of the fan."""
        middle, radius = 0.5 * (lowers + uppers), 0.5 * float(np.linalg.norm(uppers - lowers, axis=1).max())
        steep = np.maximum(self._fan[:, 2], LEAST_SINE)
        drop = np.maximum(middle[:, 2] - self._lowest, 0.0)
        start = self._geometry.shaded_start
        # Along each direction, from the middle of a box down to the lowest bottom; each axis separately is faster.
        down = drop[:, None] * np.linspace(0, 1, SHADOW_STEPS)
        slant = self._fan[:, :2] / steep[:, None]
        x, y = (
            np.floor((middle[:, axis, None] - slant[:, axis, None, None] * down - start) / SHADED_CELL_M)
            for axis in range(2)
        )
        shaded = np.zeros(self._geometry.shaded.shape, dtype=np.uint8)
        inside = (x >= 0) & (y >= 0) & (x < shaded.shape[1]) & (y < shaded.shape[0])
        shaded[y[inside].astype(np.int64), x[inside].astype(np.int64)] = 1
        runs = np.linalg.norm(slant[:, None] * drop[:, None], axis=-1)
        gap = float(runs.max(initial=0.0)) / (SHADOW_STEPS - 1)
        wide = int(np.ceil((radius + 0.5 * gap) / SHADED_CELL_M)) + 1
        return np.asarray(ndimage.maximum_filter(shaded, size=2 * wide + 1))

    def rows_at(self, time_s: float) -> Rows:
        """All moving rows for a time, s."""
        plants = self._still.copy()
        if self._life.sway is not None:
            x, y, z = self._life.sway.lean(time_s).astype(float).T
            turn = self._still["to_shape"].astype(float)
            # First undo the lean, then into the shape: columns of to_shape times the inverse of [[1, 0, x], ...].
            upright = turn[..., 2] - x[:, None] * turn[..., 0] - y[:, None] * turn[..., 1]
            plants["to_shape"][..., 2] = upright / z[:, None]
        if not len(self._life):
            return plants
        others = self._meshes.rows(self._life.at(time_s), self._shapes)
        return _joined(plants, others)

    def _leaning(self, plants: Rows, time_s: float | None) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Boxes of the plants: those at rest, sheared by the lean."""
        assert self._life.sway is not None
        lean = np.array([[0.0, 0.0, 1.0]]) if time_s is None else self._life.sway.lean(time_s).astype(float)
        ends = np.stack([self._low[:, 2], self._high[:, 2]])[..., None] * lean
        low, high = self._low.copy(), self._high.copy()
        low[:, :2] += ends[..., :2].min(axis=0)
        high[:, :2] += ends[..., :2].max(axis=0)
        low[:, 2], high[:, 2] = ends[..., 2].min(axis=0), ends[..., 2].max(axis=0)
        position = plants["position"].astype(float)
        return low + position - MARGIN_M, high + position + MARGIN_M

    def _bounds(self, others: Rows) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Boxes of roaming things, enclosing the rotated boxes of their meshes."""
        if not len(others):
            return np.zeros((0, 3)), np.zeros((0, 3))
        shape = np.searchsorted(self._meshes.first_corner, others["first_corner"], side="right") - 1 - self._shapes
        scaled = self._boxes[shape] * others["scale"].astype(float)[:, None]
        middle, half = scaled.mean(axis=1), 0.5 * (scaled[:, 1] - scaled[:, 0])
        rotation = others["rotation"].astype(float)
        centre = np.einsum("nij,nj->ni", rotation, middle) + others["position"]
        reach = np.einsum("nij,nj->ni", np.abs(rotation), half) + MARGIN_M
        return centre - reach, centre + reach

    def _tree(self, lowers: NDArray[np.float64], uppers: NDArray[np.float64]) -> wp.Bvh | None:
        if not len(lowers):
            return None
        corners = [wp.array(c.astype(np.float32), dtype=wp.vec3, device=self._device) for c in (lowers, uppers)]
        return wp.Bvh(*corners)

    @staticmethod
    def _assign(tree: wp.Bvh, lowers: NDArray[np.float64], uppers: NDArray[np.float64]) -> None:
        tree.lowers.assign(lowers.astype(np.float32))
        tree.uppers.assign(uppers.astype(np.float32))
