"""The ground as animals see it: a smooth upper bound of the reef without its plants, and the surface under feet."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from oysterbench.core.geometry import Array
from oysterbench.scene.terrain import sample_grid
from oysterbench.scene.world import World

CELL_M = 0.10  # of the bound above which swimmers stay
WIDEN_CELLS, BLUR_CELLS = 7, 2.0
FOOTING_BLUR_CELLS = 1.2  # blur of the ground felt by feet, in cells of the envelope


@dataclass(frozen=True)
class Ground:
    """Ground of a reef. over: heights (M, M) m on grid lines `lines`, an upper bound of everything solid within 0.2 m,
    smoothed over the same distance. footing: the solid surface on `footing_lines`, smoothed over a foot."""

    lines: Array
    over: NDArray[np.float64]
    footing_lines: Array
    footing: NDArray[np.float64]

    def bound(self, x: Array, y: Array) -> Array:
        """Height (N,) m above which swimmers stay."""
        return sample_grid(self.lines, self.over, x, y)

    def foothold(self, x: Array, y: Array) -> Array:
        """Height (N,) m of the surface on which feet stand."""
        return sample_grid(self.footing_lines, self.footing, x, y)


def build_ground(world: World) -> Ground:
    """Build the ground of a world."""
    every = max(1, round(CELL_M / float(world.envelope_lines[1] - world.envelope_lines[0])))
    highest = ndimage.maximum_filter(world.solid.astype(float), size=every * 2 + 1)[::every, ::every]
    over = ndimage.gaussian_filter(ndimage.maximum_filter(highest, size=WIDEN_CELLS), BLUR_CELLS)
    footing = ndimage.gaussian_filter(world.solid.astype(float), FOOTING_BLUR_CELLS)
    return Ground(world.envelope_lines[::every], over, world.envelope_lines, footing)
