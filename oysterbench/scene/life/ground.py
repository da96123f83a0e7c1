"""What animals keep above: a smooth upper bound of the reef, without its plants."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from oysterbench.core.geometry import Array
from oysterbench.scene.terrain import sample_grid
from oysterbench.scene.world import World

CELL_M = 0.10  # of the bound that swimmers keep above
WIDEN_CELLS, BLUR_CELLS = 7, 2.0
FOOTING_BLUR_CELLS = 1.2  # of the envelope's cells: what feet feel of the ground under them


@dataclass(frozen=True)
class Ground:
    """over: heights (M, M) m on `lines`, an upper bound of all that is solid within 0.2 m, smooth over as much.
    footing: the solid surface on `footing_lines`, smooth over a foot."""

    lines: Array
    over: NDArray[np.float64]
    footing_lines: Array
    footing: NDArray[np.float64]

    def bound(self, x: Array, y: Array) -> Array:
        """Height (N,) m that swimmers keep above."""
        return sample_grid(self.lines, self.over, x, y)

    def foothold(self, x: Array, y: Array) -> Array:
        """Height (N,) m on which feet stand."""
        return sample_grid(self.footing_lines, self.footing, x, y)


def build_ground(world: World) -> Ground:
    """The ground of a world."""
    every = max(1, round(CELL_M / float(world.envelope_lines[1] - world.envelope_lines[0])))
    highest = ndimage.maximum_filter(world.solid.astype(float), size=every * 2 + 1)[::every, ::every]
    over = ndimage.gaussian_filter(ndimage.maximum_filter(highest, size=WIDEN_CELLS), BLUR_CELLS)
    footing = ndimage.gaussian_filter(world.solid.astype(float), FOOTING_BLUR_CELLS)
    return Ground(world.envelope_lines[::every], over, world.envelope_lines, footing)
