"""Where oysters and stones lie: clumps of a Thomas process, each shell resting in the relief."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from oysterbench.recipe import CLASSES, ReefRecipe
from oysterbench.scene.mesh import Mesh, round_positions
from oysterbench.scene.terrain import Terrain
from oysterbench.streams import Streams

Array = NDArray[np.float64]

CLASS_NUMBERS = {name: number for number, name in CLASSES.items()}
CLUMP_SPREAD = 0.8  # standard deviation of a clump, in shell heights
LYING_SHARE = 0.3
SIZE_SPREAD = 0.28  # standard deviation of ln(height)
SIZE_LIMITS_M = (0.025, 0.172)  # the range measured in 1122 Virginia oysters
SPACING = 0.34  # least distance of neighbours' hinges, in shell heights
STONE_RADIUS_M = (0.025, 0.11)
OYSTER_SINK = (0.03, 0.12)  # of the shell's height
ROWS_AT_ONCE = 512  # bounds the memory that placing needs
STONE_SINK = (0.25, 0.6)  # of the stone's radius


@dataclass(frozen=True)
class Instances:
    """Placed meshes. A point p of shape `shape` lies at `rotation @ (scale * p) + position` in `map`.

    ids (N,) uint16 from 1; classes (N,) uint8 as in recipe.CLASSES; shapes (N,) int32, index of the mesh; positions
    (N, 3) m and rotations (N, 3, 3); scales (N, 3) m per unit of the mesh; colours (N, 3) linear albedo; silt (N,)
    share of an upward face that is covered with silt; sunk (N,) m by which the lowest point is below the seabed.
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

    def __len__(self) -> int:
        return len(self.ids)

    def take(self, chosen: NDArray[np.generic]) -> Instances:
        """The instances at an index or mask."""
        return Instances(**{f.name: getattr(self, f.name)[chosen] for f in fields(self)})

    def vertices(self, meshes: Sequence[Mesh], index: int) -> Array:
        """Vertices (V, 3) of one instance in `map`, m."""
        local = meshes[self.shapes[index]].vertices * self.scales[index].astype(float)
        return np.einsum("ij,vj->vi", self.rotations[index].astype(float), local) + self.positions[index]


def placed_vertices(meshes: Sequence[Mesh], instances: Instances) -> Iterator[tuple[NDArray[np.intp], Array]]:
    """Rows (n,) of instances that share a shape, and their vertices (n, V, 3) in `map`, m; all rows come once."""
    for shape, mesh in enumerate(meshes):
        rows = np.flatnonzero(instances.shapes == shape)
        for chosen in np.array_split(rows, len(rows) // ROWS_AT_ONCE + 1):
            if len(chosen):
                local = mesh.vertices[None] * instances.scales[chosen, None].astype(float)
                turned = np.einsum("nij,nvj->nvi", instances.rotations[chosen].astype(float), local)
                yield chosen, turned + instances.positions[chosen, None]


def join_instances(parts: Sequence[Instances]) -> Instances:
    """Several tables as one, with ids renumbered from 1."""
    values = {f.name: np.concatenate([getattr(part, f.name) for part in parts]) for f in fields(Instances)}
    values["ids"] = np.arange(1, len(values["ids"]) + 1).astype(np.uint16)
    return Instances(**values)


def place_oysters(reef: ReefRecipe, terrain: Terrain, meshes: Sequence[Mesh], streams: Streams) -> Instances:
    """Oysters of a reef; `meshes` is the library, of which every shape may be a shell."""
    generator = streams.generator("oysters")
    n = reef.oysters
    heights = reef.oyster_size_mm * 1e-3 * np.exp(SIZE_SPREAD * generator.standard_normal(n))
    heights = np.clip(heights, *SIZE_LIMITS_M)
    places, outward = _clumps(reef, heights, generator)
    rotations = _poses(n, outward, generator)
    aspect = np.exp(0.10 * generator.standard_normal((n, 2)))
    scales = heights[:, None] * np.column_stack([np.ones(n), aspect])
    return _rest(
        class_name="oyster",
        shapes=generator.integers(0, len(meshes), n),
        places=places,
        rotations=rotations,
        scales=scales,
        colours=_shell_colours(n, generator),
        silt=generator.beta(2.2, 1.8, n),
        sunk=heights * generator.uniform(*OYSTER_SINK, n),
        terrain=terrain,
        meshes=meshes,
    )


def place_stones(reef: ReefRecipe, terrain: Terrain, meshes: Sequence[Mesh], streams: Streams) -> Instances:
    """Stones of a reef, uniform over its square; small ones are many."""
    generator = streams.generator("stones")
    n = reef.stones
    small, large = STONE_RADIUS_M
    radii = small * (large / small) ** (generator.random(n) ** 1.8)
    places = generator.uniform(-reef.size_m / 2, reef.size_m / 2, (n, 2))
    tilt = Rotation.from_rotvec(0.25 * generator.standard_normal((n, 3)))
    turn = Rotation.from_euler("z", generator.uniform(0, 2 * np.pi, (n, 1)))
    grey = generator.uniform(0.08, 0.24, (n, 1))
    return _rest(
        class_name="stone",
        shapes=generator.integers(0, len(meshes), n),
        places=places,
        rotations=(tilt * turn).as_matrix().reshape(n, 3, 3),
        scales=radii[:, None] * np.exp(0.12 * generator.standard_normal((n, 3))),
        colours=grey * np.array([1.05, 1.0, 0.9]) * np.exp(0.06 * generator.standard_normal((n, 3))),
        silt=generator.beta(3.0, 1.5, n),
        sunk=radii * generator.uniform(*STONE_SINK, n),
        terrain=terrain,
        meshes=meshes,
    )


def _clumps(reef: ReefRecipe, heights: Array, generator: np.random.Generator) -> tuple[Array, Array]:
    """Hinge positions (N, 2) in m of a Thomas process, and each shell's offset (N, 2) from its clump's centre.

    Thomas (1949): Poisson parents, Gaussian offspring; here the number of all offspring is given. Parents avoid the
    bare patches of the reef. A shell too near an earlier one is drawn again a few times.
    """
    n = len(heights)
    parents = max(1, round(n / reef.clump_size))
    half = reef.size_m / 2
    centres = generator.uniform(-half, half, (4 * parents, 2))
    waves = generator.standard_normal((12, 2)) * 2 * np.pi / 5.0  # patches of a few metres
    phases = generator.uniform(0, 2 * np.pi, 12)
    patchiness = np.sin(np.einsum("pi,wi->pw", centres, waves) + phases).sum(axis=1)
    keep = np.argsort(-(patchiness + 2.0 * generator.standard_normal(len(centres))), kind="stable")[:parents]
    centres = centres[np.sort(keep)]
    weights = generator.gamma(1.2, 1.0, parents)
    parent = generator.choice(parents, size=n, p=weights / weights.sum())
    tries = generator.standard_normal((n, 6, 2))
    cell = float(SIZE_LIMITS_M[1])
    taken: dict[tuple[int, int], list[tuple[float, float, float]]] = {}
    places = np.empty((n, 2))
    for i in range(n):
        for attempt in range(tries.shape[1]):
            spread = CLUMP_SPREAD * reef.oyster_size_mm * 1e-3 * (1 + 0.25 * attempt)
            x, y = np.clip(centres[parent[i]] + spread * tries[i, attempt], -half, half).tolist()
            column, row = int(x // cell), int(y // cell)
            near = [p for a in (-1, 0, 1) for b in (-1, 0, 1) for p in taken.get((column + a, row + b), ())]
            if all((x - p) ** 2 + (y - q) ** 2 > (SPACING * 0.5 * (heights[i] + h)) ** 2 for p, q, h in near):
                break
        taken.setdefault((column, row), []).append((x, y, heights[i]))
        places[i] = x, y
    return places, places - centres[parent]


def _poses(n: int, outward: Array, generator: np.random.Generator) -> Array:
    """Rotations (N, 3, 3): most shells stand on the hinge and lean out of the clump, the others lie on a valve."""
    heading = np.arctan2(outward[:, 1], outward[:, 0]) + 0.7 * generator.standard_normal(n)
    lying = generator.random(n) < LYING_SHARE
    rise = np.where(lying, generator.normal(0.06, 0.12, n), generator.uniform(0.45, 1.35, n))
    # Lying shells rest on either valve; standing ones turn any way about their long axis.
    flip = np.where(generator.random(n) < 0.6, 0.0, np.pi)
    roll = np.where(lying, flip + 0.2 * generator.standard_normal(n), generator.uniform(-np.pi, np.pi, n))
    angles = np.column_stack([heading, -rise, roll])
    return Rotation.from_euler("ZYX", angles).as_matrix().reshape(n, 3, 3)


def _shell_colours(n: int, generator: np.random.Generator) -> Array:
    """Linear albedo (N, 3) of shells: grey-brown to dirty white, a few dark."""
    brown, grey, white = np.array([0.17, 0.135, 0.09]), np.array([0.22, 0.21, 0.185]), np.array([0.50, 0.47, 0.40])
    mix = generator.dirichlet([1.6, 1.6, 0.7], n)
    colours = mix[:, :1] * brown + mix[:, 1:2] * grey + mix[:, 2:] * white
    return colours * np.exp(0.18 * generator.standard_normal((n, 1)))


def _rest(
    class_name: str,
    shapes: NDArray[np.integer],
    places: Array,
    rotations: Array,
    scales: Array,
    colours: Array,
    silt: Array,
    sunk: Array,
    terrain: Terrain,
    meshes: Sequence[Mesh],
) -> Instances:
    """Let each mesh down at its place until its lowest point, over the relief below it, is `sunk` m deep."""
    n = len(shapes)
    level = Instances(
        ids=np.zeros(n, dtype=np.uint16),
        classes=np.full(n, CLASS_NUMBERS[class_name], dtype=np.uint8),
        shapes=shapes.astype(np.int32),
        positions=round_positions(np.column_stack([places, np.zeros(n)])),
        rotations=np.round(rotations, 6).astype(np.float32),
        scales=round_positions(scales),
        colours=np.round(np.clip(colours, 0.02, 0.8), 5).astype(np.float32),
        silt=np.round(silt, 5).astype(np.float32),
        sunk=round_positions(sunk),
    )
    for chosen, vertices in placed_vertices(meshes, level):
        ground = terrain.height(vertices[..., 0], vertices[..., 1])
        clearance = (vertices[..., 2] - ground).min(axis=1)
        level.positions[chosen, 2] = round_positions(-clearance - sunk[chosen])
    return level
