"""How far the shells of a reef stand in one another: the share of each one's solid that lies in another's."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from oysterbench.core.geometry import Array
from oysterbench.scene.mesh import Mesh
from oysterbench.scene.world import World

CELLS = 36  # along each side of the box around a shell
POINTS = 96  # of a shell's solid that are looked for in others
DEEP_SHARE = 0.20  # of a shell's solid in another clump's: more can be seen to be no growth of one on another


@dataclass(frozen=True)
class Crowding:
    """For each oyster (N,), the share of its solid that lies in oysters of other clumps (`strange`) and of its own
    (`kin`), both 0 to 1. A loose valve is a clump of its own.
    """

    strange: Array
    kin: Array

    @property
    def deep_share(self) -> float:
        """Share of the oysters more than DEEP_SHARE of which lies in other clumps; NaN without oysters."""
        return float(np.mean(self.strange > DEEP_SHARE)) if len(self.strange) else float("nan")


def measure_crowding(world: World) -> Crowding:
    """Shares by counting points: those of one oyster's solid that fall into the solid cells of another."""
    oysters = world.oysters
    shells = world.library.shells
    # A live shell holds an animal: the room between its valves is taken.
    solids = {int(k): _Solid(shells[k].mesh, shells[k].state == "live") for k in np.unique(oysters.shapes)}
    roots = clump_roots(oysters.hosts)
    rotations, scales = oysters.rotations.astype(float), oysters.scales.astype(float)
    positions = oysters.positions.astype(float)
    middles, reaches = np.empty((len(oysters), 3)), np.empty(len(oysters))
    for row, shape in enumerate(oysters.shapes):
        solid = solids[int(shape)]
        middles[row] = rotations[row] @ (solid.middle * scales[row]) + positions[row]
        reaches[row] = 0.5 * np.linalg.norm(solid.size * scales[row])
    strange, kin = np.zeros((len(oysters), POINTS), bool), np.zeros((len(oysters), POINTS), bool)
    pairs = cKDTree(middles).query_pairs(2 * reaches.max(initial=0.0), output_type="ndarray")
    gap = np.linalg.norm(middles[pairs[:, 0]] - middles[pairs[:, 1]], axis=1)
    pairs = pairs[gap < reaches[pairs].sum(axis=1)]
    for own, other in np.concatenate([pairs, pairs[:, ::-1]]):
        points = solids[int(oysters.shapes[own])].points * scales[own]
        points = points @ rotations[own].T + positions[own] - positions[other]
        inside = solids[int(oysters.shapes[other])].contains(points @ rotations[other] / scales[other])
        (kin if roots[own] == roots[other] else strange)[own] |= inside
    return Crowding(strange.mean(axis=1), kin.mean(axis=1))


def clump_roots(hosts: NDArray[np.integer]) -> NDArray[np.int64]:
    """Row (N,) of the oyster that each one's clump stands on; hosts (N,): ids from 1, 0 for the bottom."""
    roots = np.where(hosts > 0, hosts.astype(np.int64) - 1, np.arange(len(hosts)))
    while not np.array_equal(roots, roots[roots]):
        roots = roots[roots]
    return roots


class _Solid:
    """The cells of the box around a mesh whose middles lie in it, and some of those middles."""

    def __init__(self, mesh: Mesh, filled: bool) -> None:
        vertices = mesh.vertices.astype(float)
        self.low = vertices.min(axis=0)
        self.size = np.ptp(vertices, axis=0)
        self.middle = self.low + 0.5 * self.size
        unit = (vertices - self.low) / self.size * CELLS
        self.cells = np.zeros((CELLS, CELLS, CELLS), dtype=bool)
        crossings = _crossings(unit[mesh.faces])
        for (i, j), heights in crossings.items():
            levels = np.sort(heights)
            if filled:
                levels = levels[[0, -1]]
            below = np.searchsorted(levels, np.arange(CELLS) + 0.5)
            self.cells[i, j] = below % 2 == 1
        taken = np.argwhere(self.cells)
        chosen = taken[np.linspace(0, len(taken) - 1, POINTS).astype(int)]
        self.points = self.low + (chosen + 0.5) / CELLS * self.size

    def contains(self, points: Array) -> NDArray[np.bool_]:
        """Whether points (P, 3) in the mesh's own frame lie in it."""
        cell = np.floor((points - self.low) / self.size * CELLS).astype(int)
        within = np.all((cell >= 0) & (cell < CELLS), axis=1)
        cell = np.where(within[:, None], cell, 0)
        return within & self.cells[cell[:, 0], cell[:, 1], cell[:, 2]]


def _crossings(triangles: Array) -> dict[tuple[int, int], list[float]]:
    """Heights at which upright lines through the middles of cells (i, j) pass the triangles (F, 3, 3), in cells."""
    found: dict[tuple[int, int], list[float]] = {}
    for a, b, c in triangles:
        low = np.ceil(np.minimum(np.minimum(a, b), c)[:2] - 0.5).astype(int)
        high = np.floor(np.maximum(np.maximum(a, b), c)[:2] - 0.5).astype(int)
        area = (b[0] - a[0]) * (c[1] - a[1]) - (c[0] - a[0]) * (b[1] - a[1])
        if area == 0.0:
            continue
        for i in range(max(low[0], 0), min(high[0], CELLS - 1) + 1):
            for j in range(max(low[1], 0), min(high[1], CELLS - 1) + 1):
                x, y = i + 0.5, j + 0.5
                v = ((x - a[0]) * (c[1] - a[1]) - (c[0] - a[0]) * (y - a[1])) / area
                w = ((b[0] - a[0]) * (y - a[1]) - (x - a[0]) * (b[1] - a[1])) / area
                if v >= 0 and w >= 0 and v + w <= 1:
                    found.setdefault((i, j), []).append(a[2] + v * (b[2] - a[2]) + w * (c[2] - a[2]))
    return found
