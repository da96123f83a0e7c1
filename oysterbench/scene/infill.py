"""Loose silt that gathers among objects on the bottom: it raises the bottom there and buries their feet and edges."""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from oysterbench.core.geometry import Array
from oysterbench.scene.mesh import round_positions
from oysterbench.scene.terrain import Terrain, sample_grid

REACH_M = 0.030  # standard deviation of the blur with which the silt's surface follows the objects around it
FULL = 0.75  # largest share of the surrounding objects' height that silt fills


def fill_in(terrain: Terrain, lines: Array, envelope: NDArray[np.float32], depth_m: float) -> Terrain:
    """Return the seabed raised by at most `depth_m` of silt among the objects on it.

    envelope (M, M), indexed [y, x], on grid lines (M,), m: height of the highest surface. The silt's own surface is
    smooth: it slopes down from the objects that hold it and levels the gaps between them.
    """
    if depth_m <= 0:
        return terrain
    cell = float(lines[1] - lines[0])
    standing = envelope - terrain.height(*np.meshgrid(lines, lines))
    risen = FULL * ndimage.gaussian_filter(np.maximum(standing, 0.0), REACH_M / cell)
    # Saturates smoothly at the maximum depth: x / (1 + (x / d)^2)^(1/2).
    silt = risen / np.sqrt(1.0 + (risen / depth_m) ** 2)
    grid = np.meshgrid(terrain.coordinates, terrain.coordinates)
    inside = np.maximum(np.abs(grid[0]), np.abs(grid[1])) <= lines[-1]
    raised = np.where(inside, sample_grid(lines, silt, *grid), 0.0)
    return dataclasses.replace(terrain, heights=round_positions(terrain.heights.astype(float) + raised))
