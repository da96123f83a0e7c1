"""A world: the seabed and everything on it, as arrays in `map` (ENU, z = 0 at the mean water surface)."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import ndimage

from oysterbench.errors import RecipeError
from oysterbench.recipe import SequenceRecipe
from oysterbench.scene.mesh import Mesh
from oysterbench.scene.oyster import build_shell, draw_form
from oysterbench.scene.props import build_stone
from oysterbench.scene.reef import (
    CLASS_NUMBERS,
    Instances,
    join_instances,
    place_oysters,
    place_stones,
    placed_vertices,
)
from oysterbench.scene.terrain import Terrain, build_terrain, sample_grid
from oysterbench.streams import Streams

SHELLS = 24
STONES = 8
ENVELOPE_CELL_M = 0.025
MAX_ENVELOPE_CELLS = 2000  # per side: bounds the memory of a large reef
MAX_INSTANCES = 2**16 - 1


@dataclass(frozen=True)
class World:
    """Seabed, shapes and their instances; oysters come first, stones continue their ids.

    meshes: the library that `instances.shapes` points into. texture_seed: uint32 for the procedural albedo.
    envelope_lines (M,) float64: grid lines of the envelope along x and y, m. envelope (M, M) float32, indexed [y, x]:
    height in `map` of the highest surface around a grid point, m.
    """

    terrain: Terrain
    meshes: tuple[Mesh, ...]
    instances: Instances
    texture_seed: int
    envelope_lines: NDArray[np.float64]
    envelope: NDArray[np.float32]

    @property
    def oysters(self) -> Instances:
        """The oysters' rows of the instance table."""
        return self.instances.take(self.instances.classes == CLASS_NUMBERS["oyster"])

    @property
    def stones(self) -> Instances:
        """The stones' rows of the instance table."""
        return self.instances.take(self.instances.classes == CLASS_NUMBERS["stone"])

    def boxes(self) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Lower and upper corners (N, 3) of the instances' boxes in `map`, m, a hair wider than the shapes."""
        lowers = np.empty((len(self.instances), 3), dtype=np.float32)
        uppers = np.empty_like(lowers)
        for chosen, vertices in placed_vertices(self.meshes, self.instances):
            lowers[chosen], uppers[chosen] = vertices.min(axis=1) - 1e-4, vertices.max(axis=1) + 1e-4
        return lowers, uppers

    def ground_height(self, x: ArrayLike, y: ArrayLike) -> NDArray[np.float64]:
        """z of the bare seabed at x, y (m, `map`), m; bilinear on the mesh's grid."""
        return self.terrain.height(x, y)

    def obstacle_height(self, x: ArrayLike, y: ArrayLike) -> NDArray[np.float64]:
        """Upper bound of z of seabed, oysters and stones at x, y (m, `map`), m.

        Conservative: the highest point within about two cells (5 cm on reefs up to 50 m) counts.
        """
        bound = sample_grid(self.envelope_lines, self._highest_around, x, y)
        inside = np.maximum(np.abs(x), np.abs(y)) <= self.envelope_lines[-1]
        return np.where(inside, np.maximum(bound, self.ground_height(x, y)), self.ground_height(x, y))

    @cached_property
    def _highest_around(self) -> NDArray[np.float32]:
        """The envelope widened by a cell each way, so that interpolating it never cuts a tip off."""
        return ndimage.maximum_filter(self.envelope, size=3)


def build_world(recipe: SequenceRecipe, streams: Streams) -> World:
    """The world of a sequence; the same recipe and streams give the same arrays.

    Raises RecipeError when oysters and stones together do not fit the instance ids.
    """
    reef = recipe.reef
    if reef.oysters + reef.stones > MAX_INSTANCES:
        raise RecipeError(
            f"sequence {recipe.name}: keys 'reef.oysters' + 'reef.stones': expected at most {MAX_INSTANCES} together, "
            f"got {reef.oysters + reef.stones}"
        )
    scene = streams.at("scene")
    terrain = build_terrain(reef, scene.generator("terrain"))
    shells = []
    for k in range(SHELLS):
        generator = scene.generator("shell", k)
        shells.append(build_shell(draw_form(generator), generator))
    stones = [build_stone(scene.generator("stone", k)) for k in range(STONES)]
    oysters = place_oysters(reef, terrain, shells, scene)
    rocks = place_stones(reef, terrain, stones, scene)
    rocks = join_instances([rocks])
    rocks.shapes[:] += SHELLS
    meshes = (*shells, *stones)
    instances = join_instances([oysters, rocks])
    lines, envelope = _envelope(reef.size_m, terrain, meshes, instances)
    texture_seed = int(scene.generator("texture").integers(0, 2**32))
    return World(terrain, meshes, instances, texture_seed, lines, envelope)


def _envelope(
    size: float, terrain: Terrain, meshes: tuple[Mesh, ...], instances: Instances
) -> tuple[NDArray[np.float64], NDArray[np.float32]]:
    """Grid lines (M,) and the highest surface near each grid point (M, M), from the vertices of all instances."""
    margin = 0.3  # shells on the reef's border reach over it
    cell = max(ENVELOPE_CELL_M, size / MAX_ENVELOPE_CELLS)
    count = int(np.ceil((size + 2 * margin) / cell)) + 1
    lines: NDArray[np.float64] = (np.arange(count, dtype=float) - (count - 1) / 2) * cell
    x, y = np.meshgrid(lines, lines)
    envelope = terrain.height(x, y).astype(np.float32)
    for _, vertices in placed_vertices(meshes, instances):
        place = np.clip(np.round((vertices[..., :2] - lines[0]) / cell).astype(int), 0, count - 1)
        np.maximum.at(envelope, (place[..., 1].ravel(), place[..., 0].ravel()), vertices[..., 2].ravel())
    return lines, envelope
