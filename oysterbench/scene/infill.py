"""Loose silt that gathers among what stands on the bottom: it raises the bottom there, and buries feet and edges."""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from oysterbench.core.geometry import Array
from oysterbench.scene.mesh import round_positions
from oysterbench.scene.terrain import Terrain, sample_grid

REACH_M = 0.030  # standard deviation of the blur by which the silt's surface follows what it gathers about
FULL = 0.75  # of the height of what stands around that silt fills at most


def fill_in(terrain: Terrain, lines: Array, envelope: NDArray[np.float32], depth_m: float) -> Terrain:
    """The seabed with at most `depth_m` of silt among all that stands on it.

    envelope (M, M), indexed [y, x], on grid lines (M,), m: height of the highest surface. The silt's own surface is
    smooth: it slopes down from what holds it, and levels what lies between.
    """
    if depth_m <= 0:
        return terrain
    cell = float(lines[1] - lines[0])
    standing = envelope - terrain.height(*np.meshgrid(lines, lines))
    risen = FULL * ndimage.gaussian_filter(np.maximum(standing, 0.0), REACH_M / cell)
    # Rounds off where the silt has reached its depth: x / (1 + (x / d)^2)^(1/2).
    silt = risen / np.sqrt(1.0 + (risen / depth_m) ** 2)
    grid = np.meshgrid(terrain.coordinates, terrain.coordinates)
    inside = np.maximum(np.abs(grid[0]), np.abs(grid[1])) <= lines[-1]
    raised = np.where(inside, sample_grid(lines, silt, *grid), 0.0)
    return dataclasses.replace(terrain, heights=round_positions(terrain.heights.astype(float) + raised))
