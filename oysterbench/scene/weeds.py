"""Plants that grow on shells and stones in summer or drift in and stay: filamentous algae, dead blades, stalks."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from oysterbench.core.geometry import Array
from oysterbench.core.streams import Streams
from oysterbench.recipe import ReefRecipe
from oysterbench.scene.clutter import upper_sides
from oysterbench.scene.instances import Instances, make_instances
from oysterbench.scene.library import THREADS_FROM, Library
from oysterbench.scene.terrain import sample_grid

BUNCH_M = (0.025, 0.10)  # length; Cladophora and ectocarpoids on shells
BUNCH_PATCH_M = 0.5  # wavelength of the patches in which bunches of one colour stand
GREEN, BROWN = (0.050, 0.120, 0.014), (0.095, 0.055, 0.025)  # linear albedo
STRAND_M = (0.04, 0.25)
STRAND_COLOURS = ((0.055, 0.075, 0.020), (0.100, 0.070, 0.030), (0.070, 0.035, 0.020), (0.200, 0.165, 0.090))
BLADE_SHARE = 0.4  # share of blades among the strands; the others are stalks and threads
LIES_AT = 0.6  # quantile of the surface below a strand at which it lies: it drapes over low objects


def place_algae(reef: ReefRecipe, library: Library, hosts: Instances, streams: Streams) -> Instances:
    """Place bunches of filamentous algae in patches on the upper sides of oysters and stones; `hosts` must be the first
    rows of the world's table."""
    generator = streams.generator("algae")
    n = round(reef.algae_per_m2 * reef.size_m**2) if len(hosts) else 0
    host = _patchy(hosts, n, generator)
    points, _ = upper_sides(hosts, host, library.meshes, generator.random(n))
    small, large = BUNCH_M
    length = small * (large / small) ** generator.random(n)
    waves = generator.standard_normal((6, 2)) * 2 * np.pi / BUNCH_PATCH_M
    kind = np.sin(points[:, :2] @ waves.T + generator.uniform(0, 2 * np.pi, 6)).sum(axis=1)
    tone = np.clip(0.5 + 0.45 * kind + 0.15 * generator.standard_normal(n), 0, 1)[:, None]
    colours = np.array(GREEN) + (np.array(BROWN) - np.array(GREEN)) * np.round(tone, 6)
    turn = Rotation.from_euler("z", generator.uniform(-0.8, 0.8, (n, 1))).as_matrix().reshape(n, 3, 3)
    return make_instances(
        "plant",
        library.pick("bunch", generator.random(n)) if n else np.zeros(0, int),
        points,
        turn,
        length[:, None] * np.exp(0.2 * generator.standard_normal((n, 3))),
        colours * np.exp(0.25 * generator.standard_normal((n, 1))),
        np.zeros(n),
        hosts=host + 1,
    )


def place_litter(
    reef: ReefRecipe, library: Library, lines: Array, solid: NDArray[np.float32], streams: Streams
) -> Instances:
    """Place blades, stalks and threads on the highest surface below them; solid (M, M): its height on grid lines (M,),
    m."""
    generator = streams.generator("litter")
    half = reef.size_m / 2
    n = round(reef.litter_per_m2 * reef.size_m**2)
    places = generator.uniform(-half, half, (n, 2))
    small, large = STRAND_M
    length = small * (large / small) ** generator.random(n)
    heading = generator.uniform(-np.pi, np.pi, n)
    along = length[:, None] * np.linspace(-0.45, 0.45, 9)
    x, y = places[:, :1] + np.cos(heading)[:, None] * along, places[:, 1:] + np.sin(heading)[:, None] * along
    under = np.quantile(sample_grid(lines, solid, x, y), LIES_AT, axis=1) if n else np.zeros(0)
    tilt = np.column_stack([heading, 0.06 * generator.standard_normal((n, 2))])
    colours = np.array(STRAND_COLOURS)[generator.integers(0, len(STRAND_COLOURS), n)]
    share = generator.random(n)
    blade = generator.random(n) < BLADE_SHARE
    shapes = library.pick("strand", np.where(blade, THREADS_FROM * share, THREADS_FROM + (1 - THREADS_FROM) * share))
    return make_instances(
        "plant",
        shapes if n else np.zeros(0, int),
        np.column_stack([places, under]),
        Rotation.from_euler("ZYX", tilt).as_matrix().reshape(n, 3, 3),
        length[:, None] * np.ones(3),
        colours * np.exp(0.25 * generator.standard_normal((n, 1))),
        np.zeros(n),
    )


def _patchy(hosts: Instances, n: int, generator: np.random.Generator) -> NDArray[np.int64]:
    """Draw n rows of hosts, with a higher density where a patchiness field is high."""
    if not n:
        return np.zeros(0, dtype=np.int64)
    waves = generator.standard_normal((6, 2)) * 2 * np.pi / BUNCH_PATCH_M
    field = np.sin(hosts.positions[:, :2].astype(float) @ waves.T + generator.uniform(0, 2 * np.pi, 6)).sum(axis=1)
    weights = np.cumsum(np.round(np.exp(1.6 * field), 6))
    return np.asarray(np.searchsorted(weights, generator.random(n) * weights[-1]), dtype=np.int64)
