"""The relief of a reef as divers measure it: canopy height, its spread, and rugosity by the chain."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from oysterbench.scene.instances import CLASS_NUMBERS, placed_vertices
from oysterbench.scene.world import World

CELL_M = 0.005
TILE_M = 0.05
TILE = round(TILE_M / CELL_M)
LINK_M = 0.015  # of the chain
BARE_M = 0.002  # less than this above the bottom is bottom


@dataclass(frozen=True)
class Relief:
    """cover: share of the bottom under shells or stones; canopy_height_m: mean over tiles of TILE_M, of those with
    anything on them, of the highest point over the bare bottom, as a ruler finds it; sigma_m: its standard deviation;
    rugosity: length of a chain laid along the whole surface over its straight length, mean over transects. NaN where
    nothing lies.
    """

    cover: float
    canopy_height_m: float
    sigma_m: float
    rugosity: float


def measure_relief(world: World, centre: tuple[float, float] = (0.0, 0.0), side_m: float = 1.0) -> Relief:
    """Relief of the reef in a square quadrat, plants left out; centre in m in `map`."""
    surface, ground = _surface(world, centre, side_m)
    rise = surface - ground
    tiles = rise.shape[0] // TILE
    tops = rise[: tiles * TILE, : tiles * TILE].reshape(tiles, TILE, tiles, TILE).max(axis=(1, 3))
    height = tops[tops > BARE_M]
    every = round(LINK_M / CELL_M)
    chains = []
    for profile in (surface[:, ::every], surface[::every].T):
        steps = np.diff(profile, axis=1)
        chains.append(np.sqrt(steps**2 + LINK_M**2).sum(axis=1) / (LINK_M * steps.shape[1]))
    mean, sigma = (float(height.mean()), float(height.std())) if height.size else (np.nan, np.nan)
    return Relief(float(np.mean(rise > BARE_M)), mean, sigma, float(np.concatenate(chains).mean()))


def _surface(world: World, centre: tuple[float, float], side: float) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Upper surface and bare bottom (M, M), indexed [y, x], z in `map`, m: triangles drawn into a height field."""
    count = round(side / CELL_M)
    low = np.array(centre) - side / 2
    lines = (np.arange(count) + 0.5) * CELL_M
    ground = world.ground_height(*np.meshgrid(low[0] + lines, low[1] + lines))
    surface = ground.copy()
    solid = world.instances.take(world.instances.classes != CLASS_NUMBERS["plant"])
    lowers, uppers = world.boxes
    boxes = world.instances.classes != CLASS_NUMBERS["plant"]
    near = np.all((uppers[boxes, :2] > low) & (lowers[boxes, :2] < low + side), axis=1)
    solid = solid.take(near)
    for rows, vertices in placed_vertices(world.meshes, solid):
        faces = world.meshes[solid.shapes[rows[0]]].faces
        corners = vertices[:, faces].reshape(-1, 3, 3)
        # Points over each triangle, closer than a cell: shells have triangles of a few cells.
        for weights in _weights(2):
            points = np.einsum("c,fcd->fd", weights, corners)
            column, row = np.floor((points[:, :2] - low) / CELL_M).astype(int).T
            inside = (column >= 0) & (row >= 0) & (column < count) & (row < count)
            np.maximum.at(surface, (row[inside], column[inside]), points[inside, 2])
    return surface, ground


def _weights(steps: int) -> NDArray[np.float64]:
    """Barycentric weights (K, 3) spread evenly over a triangle."""
    grid = [(i, j, steps - i - j) for i in range(steps + 1) for j in range(steps + 1 - i)]
    return np.array(grid, dtype=float) / steps
