"""What of the ground was seen: a raster from above, with colours."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_closing

from oysterbench.core.errors import TrajectoryError
from oysterbench.core.geometry import Array
from oysterbench.mapping.settings import MapSettings

CLOSED_M = 0.05  # gaps of the cover up to here are what lies between pixels, and behind single shells
MOST = 60_000_000  # squares: 0.7 GB


@dataclass(frozen=True)
class Raster:
    """Squares over the world frame's x and y: row 0 is the farthest north, column 0 the farthest west.

    west_m, north_m: of the outer corner of the first square; edge_m: of a square
    """

    west_m: float
    north_m: float
    edge_m: float
    rows: int
    columns: int

    def index(self, xy: Array) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.bool_]]:
        """Row and column of points (N, 2) m, and which of them lie on it."""
        columns = np.floor((xy[:, 0] - self.west_m) / self.edge_m).astype(np.int64)
        rows = np.floor((self.north_m - xy[:, 1]) / self.edge_m).astype(np.int64)
        inside = (rows >= 0) & (rows < self.rows) & (columns >= 0) & (columns < self.columns)
        return rows, columns, inside


def raster_around(places: Array, margin_m: float, edge_m: float, whole_m: float) -> Raster:
    """The squares around places (N, 2) m and a margin; its outer edges are at multiples of `whole_m`.

    Raises TrajectoryError where the places lie so far apart that it would not fit into memory.
    """
    low = np.floor((places.min(axis=0) - margin_m) / whole_m) * whole_m
    high = np.ceil((places.max(axis=0) + margin_m) / whole_m) * whole_m
    columns, rows = (int(n) for n in np.rint((high - low) / edge_m))
    if not np.isfinite(places).all() or rows * columns > MOST:
        raise TrajectoryError(
            f"the pictures' poses lie within {high[0] - low[0]:.0f} x {high[1] - low[1]:.0f} m: expected an area of at "
            f"most {MOST * edge_m**2:.0f} m^2 at a raster of {edge_m:g} m; has the trajectory diverged?"
        )
    return Raster(float(low[0]), float(high[1]), edge_m, rows, columns)


class Cover:
    """Squares that were seen: by how many pictures, and the colour in the nearest of them."""

    def __init__(self, raster: Raster) -> None:
        shape = (raster.rows, raster.columns)
        self.raster = raster
        self.views: NDArray[np.uint16] = np.zeros(shape, dtype=np.uint16)
        self.colours: NDArray[np.uint8] = np.zeros((*shape, 3), dtype=np.uint8)
        self._nearest = np.full(shape, np.inf, dtype=np.float32)

    def add(self, points: Array, distances_m: Array, colours: NDArray[np.uint8] | None) -> None:
        """A picture: points (N, 3) m of its pixels, their distances (N,), colours (N, 3)."""
        rows, columns, inside = self.raster.index(points[:, :2])
        order = np.argsort(-distances_m[inside], kind="stable")  # of several pixels on a square, the nearest stays
        rows, columns, near = rows[inside][order], columns[inside][order], distances_m[inside][order]
        seen = np.zeros_like(self.views, dtype=bool)
        seen[rows, columns] = True
        self.views += seen
        if colours is not None:
            better = near <= self._nearest[rows, columns]
            at = rows[better], columns[better]
            self.colours[at] = colours[inside][order][better]
            self._nearest[at] = near[better]

    def closed(self) -> NDArray[np.bool_]:
        """(rows, columns) that count as seen: small gaps are closed."""
        times = max(1, round(CLOSED_M / self.raster.edge_m / 2))
        padded = np.pad(self.views > 0, times)
        return np.asarray(
            binary_closing(padded, np.ones((3, 3), dtype=bool), iterations=times)[times:-times, times:-times]
        )

    def holds(self, xy: Array) -> NDArray[np.bool_]:
        """(N,) of points (N, 2) m: whether they lie where it was seen."""
        rows, columns, inside = self.raster.index(xy)
        found = np.zeros(len(xy), dtype=bool)
        found[inside] = self.closed()[rows[inside], columns[inside]]
        return found


def covered_m2(cover: Cover, settings: MapSettings) -> Array:
    """(rows, columns) m^2 of each cell of the grid that was seen. The raster's edges are those of cells."""
    raster = cover.raster
    per_cell = round(settings.cell_m / raster.edge_m)
    seen = cover.closed().reshape(raster.rows // per_cell, per_cell, raster.columns // per_cell, per_cell)
    return np.asarray(seen.sum(axis=(1, 3)) * raster.edge_m**2)
