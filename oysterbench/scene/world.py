"""A world: the seabed and everything on it, as arrays in `map` (ENU, z = 0 at the mean water surface)."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import ndimage
from scipy.spatial.transform import Rotation

from oysterbench.core.errors import RecipeError
from oysterbench.core.streams import Streams
from oysterbench.recipe import ReefRecipe, SequenceRecipe
from oysterbench.scene.clutter import place_fragments, place_plants, place_rocks, place_sponges, place_stones
from oysterbench.scene.infill import fill_in
from oysterbench.scene.instances import CLASS_NUMBERS, Instances, join_instances, placed_vertices
from oysterbench.scene.library import Library, build_library
from oysterbench.scene.mesh import Mesh
from oysterbench.scene.reef import place_oysters, state_names
from oysterbench.scene.terrain import Terrain, build_terrain, sample_grid
from oysterbench.scene.weeds import place_algae, place_litter

if TYPE_CHECKING:
    import pandas as pd

ENVELOPE_CELL_M = 0.025
MAX_ENVELOPE_CELLS = 2000  # per side: bounds the memory of a large reef
MAX_INSTANCES = 2**16 - 1


@dataclass(frozen=True)
class World:
    """Seabed, shapes and their instances: oysters, stones, rocks, broken shell, sponges, plants, algae and litter.

    library: the meshes that `instances.shapes` points into. appearance: streams of what is drawn while rendering
    (waves, snow, patches, spots on a port); their seed, a uint32, is also that of the procedural albedo. They have the
    salt of a hidden split: spots are at one place in all its images, so a seed of 32 bits could be found by trying.
    envelope_lines (M,) float64: grid lines of the envelope along x and y, m. envelope (M, M) float32, indexed [y, x]:
    height in `map` of the highest surface around a grid point, m; solid (M, M): the same without plants.
    """

    terrain: Terrain
    library: Library
    instances: Instances
    appearance: Streams
    envelope_lines: NDArray[np.float64]
    envelope: NDArray[np.float32]
    solid: NDArray[np.float32]

    @property
    def meshes(self) -> tuple[Mesh, ...]:
        """All meshes of the library."""
        return self.library.meshes

    @property
    def oysters(self) -> Instances:
        """Rows of the instance table that are oysters."""
        return self.of_class("oyster")

    @property
    def stones(self) -> Instances:
        """Rows of the instance table that are stones."""
        return self.of_class("stone")

    def of_class(self, name: str) -> Instances:
        """Rows of the instance table that belong to a class of recipe.CLASSES."""
        return self.instances.take(self.of_class_mask(name))

    def of_class_mask(self, name: str) -> NDArray[np.bool_]:
        """Mask (N,) of the rows of the instance table that belong to a class of recipe.CLASSES."""
        return np.asarray(self.instances.classes == CLASS_NUMBERS[name])

    def oyster_table(self) -> pd.DataFrame:
        """Ground truth of the oysters, one row each.

        id: as in instance images. state: as in oyster.STATES. host: id of the oyster on which it grows, 0 for the
        bottom. height_m, length_m, width_m: of the closed shell or the single valve, along its own axes. volume_m3:
        displaced volume (including the contents of a live oyster; the shell alone of a dead one). x, y, z: position of
        the umbo in `map`, m. qx, qy, qz, qw: from the shell's frame (x to the bill, z out of the right valve) to `map`.
        """
        import pandas as pd

        oysters = self.oysters
        shells = self.library.shells
        scales = oysters.scales.astype(float)
        extents = np.array([shell.extent for shell in shells])[oysters.shapes] * scales
        volumes = np.array([shell.volume for shell in shells])[oysters.shapes] * scales.prod(axis=1)
        positions = oysters.positions.astype(float)
        quaternions = Rotation.from_matrix(oysters.rotations.astype(float).reshape(-1, 3, 3)).as_quat(canonical=True)
        columns = {
            "id": oysters.ids.astype(np.int64),
            "state": state_names(self.library, oysters),
            "host": oysters.hosts.astype(np.int64),
            **{f"{name}_m": np.round(extents[:, k], 6) for k, name in enumerate(("height", "length", "width"))},
            "volume_m3": np.round(volumes, 10),
            **{name: positions[:, k] for k, name in enumerate("xyz")},
            **{f"q{name}": np.round(quaternions[:, k], 6) for k, name in enumerate("xyzw")},
        }
        return pd.DataFrame(columns)

    @cached_property
    def boxes(self) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Lower and upper corners (N, 3) of the instances' bounding boxes in `map`, m, slightly wider than the shapes;
        read-only, as all cameras and sonars share them."""
        lowers = np.empty((len(self.instances), 3), dtype=np.float32)
        uppers = np.empty_like(lowers)
        for chosen, vertices in placed_vertices(self.meshes, self.instances, hulls=True):
            lowers[chosen], uppers[chosen] = vertices.min(axis=1) - 1e-4, vertices.max(axis=1) + 1e-4
        for shared in (lowers, uppers):
            shared.setflags(write=False)
        return lowers, uppers

    def ground_height(self, x: ArrayLike, y: ArrayLike) -> NDArray[np.float64]:
        """Height z (m) of the bare seabed at x, y (m, `map`), interpolated bilinearly on the mesh's grid."""
        return self.terrain.height(x, y)

    def obstacle_height(self, x: ArrayLike, y: ArrayLike) -> NDArray[np.float64]:
        """Upper bound (m) of the height z of the seabed and everything on it except plants, at x, y (m, `map`).

        Conservative: the highest point within about two cells (5 cm on reefs up to 50 m) counts.
        """
        bound = sample_grid(self.envelope_lines, self._highest_around, x, y)
        inside = np.maximum(np.abs(x), np.abs(y)) <= self.envelope_lines[-1]
        ground = self.ground_height(x, y)
        return np.where(inside, np.maximum(bound, ground), ground)

    @cached_property
    def _highest_around(self) -> NDArray[np.float32]:
        """Solid envelope dilated by one cell in each direction, so that interpolation never cuts off a tip."""
        return ndimage.maximum_filter(self.solid, size=3)


def build_world(recipe: SequenceRecipe, streams: Streams) -> World:
    """Build the world of a sequence; the same recipe and streams give the same arrays.

    Raises RecipeError when there are more instances than instance ids.
    """
    reef = recipe.reef
    _check_count(reef, recipe.name)
    scene = streams.at("scene")
    terrain = build_terrain(reef, scene.generator("terrain"))
    library = build_library(reef, scene)
    oysters = place_oysters(reef, terrain, library, scene)
    stones = place_stones(reef, terrain, library, scene)
    rocks = place_rocks(reef, terrain, library, scene)
    hard = join_instances([oysters, stones, rocks])
    if reef.infill_mm:
        silted = _envelope(reef.size_m, terrain, library.meshes, hard)
        terrain = fill_in(terrain, *silted, depth_m=reef.infill_mm * 1e-3)
    fragments = place_fragments(reef, terrain, library, oysters, scene)
    sponges = place_sponges(reef, library, hard, scene)
    plants = place_plants(reef, terrain, library, hard, scene)
    parts = [hard, fragments, sponges, plants]
    lines, solid = _envelope(reef.size_m, terrain, library.meshes, join_instances([hard, sponges]))
    if reef.algae_per_m2:
        parts.append(place_algae(reef, library, hard, scene))
    if reef.litter_per_m2:
        parts.append(place_litter(reef, library, lines, solid, scene))
    instances = join_instances(parts)
    if len(instances) > MAX_INSTANCES:
        raise RecipeError(_crowded(recipe.name, len(instances)))
    envelope = solid
    if len(plants):
        envelope = np.maximum(solid, _envelope(reef.size_m, terrain, library.meshes, plants)[1])
    appearance = Streams(int(scene.generator("texture").integers(0, 2**32)), streams.salt)
    return World(terrain, library, instances, appearance, lines, envelope, solid)


def _check_count(reef: ReefRecipe, name: str) -> None:
    """Refuse a recipe with too many instances before time is spent on building them."""
    area = reef.size_m**2
    scattered = reef.hash_per_m2 + reef.sponges_per_m2 + reef.algae_per_m2 + reef.litter_per_m2
    count = reef.oyster_count + reef.stones + reef.rocks + round(scattered * area)
    if count > MAX_INSTANCES:
        raise RecipeError(_crowded(name, count))


def _crowded(name: str, count: int) -> str:
    return (
        f"sequence {name}: keys 'reef.oysters' (or 'reef.density_per_m2'), 'stones', 'rocks', 'hash_per_m2', "
        "'sponges_per_m2', 'algae_per_m2', 'litter_per_m2', 'plant_cover': expected at most "
        f"{MAX_INSTANCES} things together, got {count}"
    )


def _envelope(
    size: float, terrain: Terrain, meshes: tuple[Mesh, ...], instances: Instances
) -> tuple[NDArray[np.float64], NDArray[np.float32]]:
    """Grid lines (M,), m, and height (M, M), m, of the highest surface near each grid point, from all vertices."""
    margin = 0.3  # shells on the reef's border overhang it
    cell = max(ENVELOPE_CELL_M, size / MAX_ENVELOPE_CELLS)
    count = int(np.ceil((size + 2 * margin) / cell)) + 1
    lines: NDArray[np.float64] = (np.arange(count, dtype=float) - (count - 1) / 2) * cell
    x, y = np.meshgrid(lines, lines)
    envelope = terrain.height(x, y).astype(np.float32)
    flat = envelope.ravel()
    for _, vertices in placed_vertices(meshes, instances):
        column, row = (np.clip(np.rint((vertices[..., k] - lines[0]) / cell), 0, count - 1) for k in (0, 1))
        place = (row * count + column).astype(np.intp).ravel()
        np.maximum.at(flat, place, vertices[..., 2].astype(np.float32).ravel())
    return lines, envelope
