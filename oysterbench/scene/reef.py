"""The oysters of a reef: their states and sizes, their clumps, and the loose valves between them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from scipy.special import ndtr, ndtri

from oysterbench.core.geometry import Array
from oysterbench.core.streams import Streams
from oysterbench.recipe import ReefRecipe
from oysterbench.scene.clump import Growth, clump_centres, clump_sizes, grow_clumps
from oysterbench.scene.collisions import Crowd, total_overlap
from oysterbench.scene.instances import CLASS_NUMBERS, Instances, join_instances, lean_with, make_instances, rest
from oysterbench.scene.library import Library
from oysterbench.scene.terrain import Terrain
from oysterbench.scene.variety import vary_colours, vary_proportions

__all__ = ["CLASS_NUMBERS", "Instances", "place_oysters"]


SIZE_SPREAD = 0.28  # standard deviation of ln(height)
SIZE_LIMITS_M = (0.0249, 0.172)  # the range measured in 1122 Virginia oysters
CLUMP_SPACING = 0.75  # of clump centres, in shell heights times the square root of the clump size
SINK_HEIGHTS_M = (0.04, 0.10)  # range of shell heights over which founders sink increasingly deep,
STANDING_SINK, LYING_SINK = (0.10, 0.60), (0.03, 0.15)  # to these depths, in heights: ageing reefs gather sediment
MOST_SUNK = 0.65  # largest sunk share of a founder's standing height: enough of each remains visible
THICKNESS = np.array([1.0, 0.55, 0.22])  # lower bound of a shell's extent along its axes, in heights
STANDING_FOUNDERS = {"sand": 0.45, "mud": 0.70, "gravel": 0.35, "shell": 0.50}
SOFT = {"sand": 0.10, "mud": 0.35, "gravel": 0.0, "shell": 0.0}  # added slenderness: larger on soft bottom
VALVE_SPREAD = 1.7  # standard deviation of loose valves about a clump, in heights
STRAY_VALVES = 0.25  # share of loose valves that lie anywhere
VALVE_TRIES, VALVE_TURNS = 12, 4  # places tried for each; rounds of laying valves, each avoiding those of earlier ones
VALVE_RISE_M = 0.008  # height of a lying valve's hinge above the bottom
SLOPE_REACH_M = 0.03


def place_oysters(reef: ReefRecipe, terrain: Terrain, library: Library, streams: Streams) -> Instances:
    """Place the oysters of a reef: those of the clumps, clump by clump, then the loose valves."""
    generator = streams.generator("oysters")
    n = reef.oyster_count
    loose = int(generator.binomial(n, reef.valve_share)) if n else 0
    grown = n - loose
    sizes = clump_sizes(grown, reef.clump_size, streams.generator("clumps", "sizes"))
    spacing = CLUMP_SPACING * reef.oyster_size_mm * 1e-3 * np.sqrt(reef.clump_size)
    centres = clump_centres(len(sizes), reef.size_m, spacing, reef.patchiness, streams.generator("clumps", "centres"))
    clumped = _clumped(reef, terrain, library, sizes, centres, streams)
    valves = _loose(reef, terrain, library, loose, centres, clumped, streams)
    return join_instances([clumped, valves])


def draw_heights(median_m: float, count: int, generator: np.random.Generator) -> Array:
    """Draw shell heights (N,), m, from a log-normal distribution truncated at SIZE_LIMITS_M."""
    low, high = ndtr(np.log(np.array(SIZE_LIMITS_M) / median_m) / SIZE_SPREAD)
    heights: Array = median_m * np.exp(SIZE_SPREAD * ndtri(low + (high - low) * generator.random(count)))
    return np.clip(heights, *SIZE_LIMITS_M)


def state_names(library: Library, oysters: Instances) -> list[str]:
    """State of each oyster."""
    return [library.shells[shape].state for shape in oysters.shapes]


def _clumped(
    reef: ReefRecipe, terrain: Terrain, library: Library, sizes: NDArray[np.int64], centres: Array, streams: Streams
) -> Instances:
    """Place the oysters of the clumps; the first of each clump lies on the bottom, the others grow on older ones."""
    generator = streams.generator("clumps", "oysters")
    n = int(sizes.sum())
    clump = np.repeat(np.arange(len(sizes)), sizes)
    first = np.cumsum(sizes) - sizes
    order = np.arange(n) - np.repeat(first, sizes)
    heights = draw_heights(reef.oyster_size_mm * 1e-3, n, generator)
    # The founders are the oldest: within a clump, sizes roughly decrease.
    rank = np.lexsort((-heights * np.exp(0.35 * generator.standard_normal(n)), clump))
    heights = heights[rank]
    boxes = generator.random(n) < reef.box_share / max(1 - reef.valve_share, 1e-9)
    slender = 0.25 + 0.06 * order + SOFT[reef.bottom] + 0.22 * generator.standard_normal(n)
    shapes = np.where(boxes, library.pick("box", generator.random(n)), library.pick("live", np.clip(slender, 0, 1)))
    scales = heights[:, None] * np.column_stack([np.ones(n), np.exp(0.08 * generator.standard_normal((n, 2)))])
    standing = generator.random(n) < STANDING_FOUNDERS[reef.bottom]
    rise = np.where(standing, generator.uniform(0.8, 1.4, n), generator.normal(0.15, 0.15, n))
    roll = np.where(standing, generator.uniform(-np.pi, np.pi, n), 0.25 * generator.standard_normal(n))
    rotations = _turned(generator.uniform(-np.pi, np.pi, n), rise, roll)
    places = np.zeros((n, 3))
    places[:, :2] = centres[clump] - 0.35 * (1 - standing[:, None]) * heights[:, None] * rotations[:, :2, 0]
    rotations = lean_with(terrain, places[:, :2], rotations, SLOPE_REACH_M)
    white = np.where(boxes, 0.5, 0.0)
    colours = _shell_colours(n, white, generator)
    if reef.shell_spread:
        varied = streams.generator("clumps", "variety")
        scales = vary_proportions(scales, reef.shell_spread, varied)
        colours = vary_colours(colours, reef.shell_spread, varied)
    parts = {
        "class_name": "oyster",
        "shapes": shapes,
        "scales": scales,
        "colours": colours,
        "silt": generator.beta(2.2, 1.8, n),
    }
    depths = [np.interp(heights, SINK_HEIGHTS_M, depth) for depth in (STANDING_SINK, LYING_SINK)]
    sunk = heights * np.where(standing, *depths) * generator.uniform(0.8, 1.2, n)
    stands = heights * np.abs(rotations[:, 2] * THICKNESS).max(axis=1)
    sunk = np.where(order == 0, np.minimum(sunk, MOST_SUNK * stands), 0.0)
    founders = rest(make_instances(**parts, positions=places, rotations=rotations, sunk=sunk), terrain, library.meshes)
    start = Growth(founders.positions.astype(float), founders.rotations.astype(float), np.full(n, -1))
    growth = grow_clumps(
        sizes,
        start,
        shapes,
        founders.scales.astype(float),
        library.meshes,
        terrain,
        streams.generator("clumps", "grow"),
    )
    return make_instances(
        **parts, positions=growth.positions, rotations=growth.rotations, sunk=sunk, hosts=growth.hosts + 1
    )


def _loose(
    reef: ReefRecipe,
    terrain: Terrain,
    library: Library,
    n: int,
    centres: Array,
    clumped: Instances,
    streams: Streams,
) -> Instances:
    """Place single valves around the clumps, either side up, each at the freest of several candidate places."""
    generator = streams.generator("valves")
    half = reef.size_m / 2
    heights = draw_heights(reef.oyster_size_mm * 1e-3, n, generator)
    tries = generator.uniform(-half, half, (n, VALVE_TRIES, 2))
    if len(centres):
        about = centres[generator.integers(0, len(centres), n)][:, None]
        # The later tries look farther off.
        spread = VALVE_SPREAD * reef.oyster_size_mm * 1e-3 * np.linspace(1.0, 2.5, VALVE_TRIES)[:, None]
        near = about + spread * generator.standard_normal((n, VALVE_TRIES, 2))
        tries = np.where((generator.random(n) < STRAY_VALVES)[:, None, None], tries, near)
    tries = np.clip(tries, -half, half)
    left = generator.random(n) < 0.5
    share = generator.random(n)
    shapes = np.where(left, library.pick("left valve", share), library.pick("right valve", share))
    # A cupped valve lies more stably with its hollow down, but both occur.
    over = generator.random(n) < 0.5
    rotations = _turned(
        generator.uniform(-np.pi, np.pi, n),
        0.10 * generator.standard_normal(n),
        np.where(over, np.pi, 0.0) + 0.12 * generator.standard_normal(n),
    )
    scales = heights[:, None] * np.column_stack([np.ones(n), np.exp(0.08 * generator.standard_normal((n, 2)))])
    # Roughly at rest on level ground: overlap with others depends on the place, hardly on the slope.
    lying = np.concatenate([tries, terrain.height(tries[..., 0], tries[..., 1])[..., None] + VALVE_RISE_M], axis=2)
    places = np.zeros((n, 2))
    crowds = [Crowd.of(clumped)]
    for turn in range(VALVE_TURNS):
        rows = np.arange(turn, n, VALVE_TURNS)
        every = lying[rows].reshape(-1, 3), *(np.repeat(v[rows], VALVE_TRIES, axis=0) for v in (rotations, scales))
        overlap = np.round(total_overlap(crowds, *every).reshape(-1, VALVE_TRIES), 6)
        chosen = lying[rows, np.argmin(overlap, axis=1)]
        places[rows] = chosen[:, :2]
        crowds.append(Crowd(chosen, rotations[rows], scales[rows]))
    colours = _shell_colours(n, np.full(n, 0.7), generator)
    if reef.shell_spread:
        colours = vary_colours(colours, reef.shell_spread, streams.generator("valves", "variety"))
    return rest(
        make_instances(
            class_name="oyster",
            shapes=shapes,
            positions=np.column_stack([places, np.zeros(n)]),
            rotations=lean_with(terrain, places, rotations, SLOPE_REACH_M),
            scales=scales,
            colours=colours,
            silt=generator.beta(1.8, 1.8, n),
            sunk=heights * generator.uniform(0.02, 0.07, n),
        ),
        terrain,
        library.meshes,
    )


def _turned(heading: Array, rise: Array, roll: Array) -> Array:
    """Rotations (N, 3, 3) of shells from heading, rise above the horizontal and roll about the long axis, (N,) rad."""
    angles = np.column_stack([heading, -rise, roll])
    return Rotation.from_euler("ZYX", angles).as_matrix().reshape(len(heading), 3, 3)


def _shell_colours(n: int, white: Array, generator: np.random.Generator) -> Array:
    """Linear albedo (N, 3) of shells: grey-brown to dirty white, a few dark; `white` (N,): bleaching of dead ones."""
    brown, grey, pale = np.array([0.17, 0.135, 0.09]), np.array([0.22, 0.21, 0.185]), np.array([0.50, 0.47, 0.40])
    mix = generator.dirichlet([1.6, 1.6, 0.7], n)
    colours = mix[:, :1] * brown + mix[:, 1:2] * grey + mix[:, 2:] * pale
    colours = colours * np.exp(0.18 * generator.standard_normal((n, 1)))
    return np.asarray(colours + (pale - colours) * (white * generator.random(n))[:, None])
