"""Objects between and on the oysters: stones, rocks, broken shell, plants, and sponges on shells and stones."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from oysterbench.core.geometry import Array
from oysterbench.core.streams import Streams
from oysterbench.recipe import ReefRecipe
from oysterbench.scene.instances import Instances, lean_with, make_instances, placed_vertices, rest
from oysterbench.scene.library import BROAD_SHARE, Library
from oysterbench.scene.mesh import Mesh
from oysterbench.scene.terrain import Terrain

STONE_RADIUS_M = (0.02, 0.11)
ROCK_RADIUS_M = (0.10, 0.20)
STONE_SINK = (0.25, 0.6)  # depth in the bottom, in stone radii
FRAGMENT_M = (0.008, 0.035)
GRASS_M = (0.12, 0.32)  # length of a tuft's longest blade
ALGAE_M = (0.05, 0.13)
TUFTS_PER_M2 = 45.0  # where plants cover the bottom completely
FOOTPRINT_CELL_M = 0.02
TAKEN = 20.0  # penalty for a place covered by something hard, in units of a meadow's strength
MEADOW_M = 3.0  # wavelength of plant patches
SPONGE_M = (0.006, 0.022)
SPONGE_COLOURS = ((0.32, 0.19, 0.08), (0.27, 0.24, 0.13), (0.26, 0.12, 0.08), (0.22, 0.23, 0.12))


def place_stones(reef: ReefRecipe, terrain: Terrain, library: Library, streams: Streams) -> Instances:
    """Place the stones of a reef uniformly over its square; small ones are the most frequent."""
    return _stones("stone", reef.stones, STONE_RADIUS_M, reef, terrain, library, streams.generator("stones"))


def place_rocks(reef: ReefRecipe, terrain: Terrain, library: Library, streams: Streams) -> Instances:
    """Place the rocks of a reef, 0.2 to 0.4 m across."""
    return _stones("rock", reef.rocks, ROCK_RADIUS_M, reef, terrain, library, streams.generator("rocks"))


def place_fragments(
    reef: ReefRecipe, terrain: Terrain, library: Library, oysters: Instances, streams: Streams
) -> Instances:
    """Place broken shell: half of it around the oysters, half anywhere."""
    generator = streams.generator("fragments")
    half = reef.size_m / 2
    n = round(reef.hash_per_m2 * reef.size_m**2)
    places = generator.uniform(-half, half, (n, 2))
    if len(oysters):
        near = oysters.positions[generator.integers(0, len(oysters), n), :2] + 0.10 * generator.standard_normal((n, 2))
        places = np.clip(np.where(generator.random((n, 1)) < 0.5, near, places), -half, half)
    small, large = FRAGMENT_M
    size = small * (large / small) ** (generator.random(n) ** 1.5)
    turn = Rotation.from_euler("zxy", generator.uniform(-np.pi, np.pi, (n, 3)) * [1.0, 0.08, 0.08])
    flip = Rotation.from_euler("x", np.pi * (generator.random((n, 1)) < 0.5))
    pale = generator.random((n, 1))
    colours = np.array([0.20, 0.185, 0.15]) + pale**2 * np.array([0.30, 0.29, 0.26])
    rotations = (turn * flip).as_matrix().reshape(n, 3, 3)
    return rest(
        make_instances(
            "hash",
            library.pick("fragment", generator.random(n)) if n else np.zeros(0, int),
            np.column_stack([places, np.zeros(n)]),
            lean_with(terrain, places, rotations, 0.015),
            size[:, None] * np.ones(3),
            colours,
            generator.beta(1.5, 1.8, n),
            sunk=0.06 * size,
        ),
        terrain,
        library.meshes,
    )


def place_plants(reef: ReefRecipe, terrain: Terrain, library: Library, hard: Instances, streams: Streams) -> Instances:
    """Place tufts of seagrass and algae in meadows with bare ground between them; few root on hard objects."""
    generator = streams.generator("plants")
    half = reef.size_m / 2
    n = round(TUFTS_PER_M2 * reef.plant_cover * reef.size_m**2)
    candidates = generator.uniform(-half, half, (3 * n, 2))
    waves = generator.standard_normal((10, 2)) * 2 * np.pi / MEADOW_M
    patch = np.sin(candidates @ waves.T + generator.uniform(0, 2 * np.pi, 10)).sum(axis=1)
    preference = patch + 1.2 * generator.standard_normal(3 * n) - TAKEN * _covered(candidates, hard, library.meshes)
    best = np.argsort(-np.round(preference, 6), kind="stable")[:n]
    places = candidates[np.sort(best)]
    kind = np.sin(places @ (waves[:3, ::-1].T * 0.4)).sum(axis=1) + 0.8 * generator.standard_normal(n)
    broad = kind < -0.6
    share = generator.random(n)
    shapes = library.pick("tuft", np.where(broad, BROAD_SHARE * share, BROAD_SHARE + (1 - BROAD_SHARE) * share))
    length = np.where(broad, generator.uniform(*ALGAE_M, n), generator.uniform(*GRASS_M, n))
    green, brown = np.array([0.075, 0.120, 0.030]), np.array([0.110, 0.085, 0.035])
    tone = np.clip(np.where(broad, 0.55, 0.25) + 0.25 * generator.standard_normal(n), 0, 1)[:, None]
    turn = Rotation.from_euler("z", 0.6 * generator.standard_normal((n, 1))).as_matrix().reshape(n, 3, 3)
    return rest(
        make_instances(
            "plant",
            shapes if n else np.zeros(0, int),
            np.column_stack([places, np.zeros(n)]),
            turn,
            length[:, None] * np.exp(0.1 * generator.standard_normal((n, 3))),
            (green + (brown - green) * tone) * np.exp(0.2 * generator.standard_normal((n, 1))),
            np.zeros(n),
            sunk=0.03 * length,
        ),
        terrain,
        library.meshes,
    )


def place_sponges(reef: ReefRecipe, library: Library, hosts: Instances, streams: Streams) -> Instances:
    """Place sponges on the upper sides of oysters and stones; `hosts` must be the first rows of the world's table."""
    generator = streams.generator("sponges")
    n = round(reef.sponges_per_m2 * reef.size_m**2) if len(hosts) else 0
    host = generator.integers(0, max(len(hosts), 1), n)
    small, large = SPONGE_M
    size = small * (large / small) ** generator.random(n)
    points, normals = upper_sides(hosts, host, library.meshes, generator.random(n))
    turn = Rotation.from_euler("z", generator.uniform(-np.pi, np.pi, (n, 1))).as_matrix().reshape(n, 3, 3)
    colours = np.array(SPONGE_COLOURS)[generator.integers(0, len(SPONGE_COLOURS), n)]
    return make_instances(
        "sponge",
        library.pick("sponge", generator.random(n)) if n else np.zeros(0, int),
        points,
        np.einsum("nij,njk->nik", _upright(normals), turn),
        size[:, None] * np.exp(0.15 * generator.standard_normal((n, 3))),
        colours * np.exp(0.2 * generator.standard_normal((n, 1)) + 0.04 * generator.standard_normal((n, 3))),
        np.zeros(n),
        hosts=host + 1,
    )


def _stones(
    kind: str,
    n: int,
    radius_m: tuple[float, float],
    reef: ReefRecipe,
    terrain: Terrain,
    library: Library,
    generator: np.random.Generator,
) -> Instances:
    small, large = radius_m
    radii = small * (large / small) ** (generator.random(n) ** 1.8)
    places = generator.uniform(-reef.size_m / 2, reef.size_m / 2, (n, 2))
    tilt = Rotation.from_rotvec(0.25 * generator.standard_normal((n, 3)))
    turn = Rotation.from_euler("z", generator.uniform(0, 2 * np.pi, (n, 1)))
    grey = generator.uniform(0.08, 0.24, (n, 1))
    return rest(
        make_instances(
            "stone",
            library.pick(kind, generator.random(n)) if n else np.zeros(0, int),
            np.column_stack([places, np.zeros(n)]),
            (tilt * turn).as_matrix().reshape(n, 3, 3),
            radii[:, None] * np.exp(0.12 * generator.standard_normal((n, 3))),
            grey * np.array([1.05, 1.0, 0.9]) * np.exp(0.06 * generator.standard_normal((n, 3))),
            generator.beta(3.0, 1.5, n),
            sunk=radii * generator.uniform(*STONE_SINK, n),
        ),
        terrain,
        library.meshes,
    )


def _covered(places: Array, things: Instances, meshes: Sequence[Mesh]) -> NDArray[np.bool_]:
    """Mask (N,) of the places (N, 2) that lie under or on a thing, to within a cell of FOOTPRINT_CELL_M."""
    if not len(things) or not len(places):
        return np.zeros(len(places), dtype=bool)
    corner = np.floor(places.min(axis=0) / FOOTPRINT_CELL_M).astype(np.int64)
    shape = np.floor(places.max(axis=0) / FOOTPRINT_CELL_M).astype(np.int64) - corner + 1
    taken = np.zeros(shape, dtype=bool)
    for _, vertices in placed_vertices(meshes, things):
        x, y = (np.floor(vertices[..., k] / FOOTPRINT_CELL_M).astype(np.int64) - corner[k] for k in (0, 1))
        inside = (x >= 0) & (x < shape[0]) & (y >= 0) & (y < shape[1])
        taken[x[inside], y[inside]] = True
    cell = np.floor(places / FOOTPRINT_CELL_M).astype(np.int64) - corner
    return np.asarray(taken[cell[:, 0], cell[:, 1]])


def upper_sides(
    hosts: Instances, host: NDArray[np.int64], meshes: Sequence[Mesh], chance: Array
) -> tuple[Array, Array]:
    """Upward-facing surface points (N, 3), m in `map`, of the hosts in rows `host` (N,), and the normals (N, 3) there.

    chance (N,) from 0 to 1 selects a vertex among the host's most upward-facing third.
    """
    points, normals = np.empty((len(host), 3)), np.empty((len(host), 3))
    for k, row in enumerate(host):
        mesh, rotation = meshes[hosts.shapes[row]], hosts.rotations[row].astype(float)
        turned = (mesh.normals / hosts.scales[row]) @ rotation.T
        turned /= np.linalg.norm(turned, axis=1, keepdims=True)
        best = np.argsort(-np.round(turned[:, 2], 5), kind="stable")[: len(turned) // 3]
        vertex = best[int(chance[k] * len(best))]
        points[k] = rotation @ (mesh.vertices[vertex] * hosts.scales[row].astype(float)) + hosts.positions[row]
        normals[k] = turned[vertex]
    return points, normals


def _upright(normals: Array) -> Array:
    """Rotations (N, 3, 3) that map z to unit normals (N, 3)."""
    side = np.cross(normals, np.where(np.abs(normals[:, :1]) < 0.7, [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]))
    side /= np.linalg.norm(side, axis=1, keepdims=True)
    return np.stack([side, np.cross(normals, side), normals], axis=-1)
