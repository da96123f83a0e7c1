"""The ground that was seen: a raster from above, with colours, built image by image.

Each image first makes its own tile, along the path as it is; where the tile belongs is known once all images have been
aligned (`mapping.pose_graph`).
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_closing

from oysterbench.core.errors import TrajectoryError
from oysterbench.core.geometry import Array, invert
from oysterbench.mapping.settings import MapSettings

CLOSED_M = 0.05  # smaller gaps in the cover lie between pixels, or behind single shells
MOST = 60_000_000  # squares of a raster: 0.7 GB
MOST_PARTS = 8  # of a square along its edge: a map of MOST squares takes another 0.5 GB
BLOCK = 256  # parts along the edge of the blocks in which gaps between parts are closed
DIVERGED = "has the trajectory diverged? If it is right, cut it into parts, and map each"

Squares = tuple[NDArray[np.int64], NDArray[np.int64]]
"""Rows and columns of a raster."""


@dataclass(frozen=True)
class Raster:
    """Raster of squares over the world frame's x and y: row 0 is the northernmost, column 0 the westernmost.

    west_m, north_m: position of the outer corner of the first square; edge_m: edge of a square
    """

    west_m: float
    north_m: float
    edge_m: float
    rows: int
    columns: int

    def index(self, xy: Array) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.bool_]]:
        """Row and column (N,) of points (N, 2) m, and whether each lies on the raster."""
        columns = np.floor((xy[:, 0] - self.west_m) / self.edge_m).astype(np.int64)
        rows = np.floor((self.north_m - xy[:, 1]) / self.edge_m).astype(np.int64)
        inside = (rows >= 0) & (rows < self.rows) & (columns >= 0) & (columns < self.columns)
        return rows, columns, inside

    def part(self, rows: slice, columns: slice) -> Raster:
        """Return some rows and columns as a raster."""
        west_m, north_m = self.west_m + columns.start * self.edge_m, self.north_m - rows.start * self.edge_m
        return Raster(west_m, north_m, self.edge_m, rows.stop - rows.start, columns.stop - columns.start)

    def between(self, low: Array, high: Array) -> tuple[slice, slice]:
        """Rows and columns of the squares whose centres lie between two corners (2,) m."""
        (last, first), (left, right), _ = self.index(np.array([low, high]) + self.edge_m * np.array([[0.5], [-0.5]]))
        rows, columns = (
            slice(max(0, int(begin)), max(0, min(n, int(end) + 1)))
            for begin, end, n in ((first, last, self.rows), (left, right, self.columns))
        )
        return rows, columns

    def touching(self, low: Array, high: Array) -> tuple[slice, slice]:
        """Rows and columns of the squares of which any part lies between two corners (2,) m."""
        half = 0.5 * self.edge_m
        return self.between(low - half, high + half)

    def bounds(self, move: Array) -> tuple[Array, Array]:
        """Minimum and maximum x and y, each (2,) m, of the outer corners after a move (4, 4) about the vertical."""
        east_m, south_m = self.west_m + self.columns * self.edge_m, self.north_m - self.rows * self.edge_m
        corners = np.array([(x, y) for x in (self.west_m, east_m) for y in (south_m, self.north_m)])
        there = corners @ move[:2, :2].T + move[:2, 3]
        return there.min(axis=0), there.max(axis=0)

    def holding(self, others: Iterable[tuple[Raster, Array]], whole_m: float, far_apart: str = DIVERGED) -> Raster:
        """Return the raster, enlarged by multiples of `whole_m` if needed so that it holds the centres of all squares
        within other rasters of the same edge after their moves (4, 4).

        Raises TrajectoryError like `raster_around`.
        """
        stays = np.eye(4)
        ends = np.array([raster.bounds(way) for raster, move in others if raster.rows for way in (move, stays)])
        if not len(ends):
            return self
        low, high = ends[:, 0].min(axis=0), ends[:, 1].max(axis=0)
        own_low, own_high = self.bounds(stays)
        half = 0.5 * self.edge_m
        beyond = [own_low - low, high - own_high]
        (west, south), (east, north) = np.ceil(np.maximum(np.array(beyond) - half, 0.0) / whole_m).astype(int).tolist()
        per_whole = round(whole_m / self.edge_m)
        return _fitting(
            Raster(
                self.west_m - west * whole_m,
                self.north_m + north * whole_m,
                self.edge_m,
                self.rows + (south + north) * per_whole,
                self.columns + (west + east) * per_whole,
            ),
            high - low,
            whole_m,
            far_apart,
        )


def raster_around(places: Array, margin_m: float, edge_m: float, whole_m: float, far_apart: str = DIVERGED) -> Raster:
    """Raster around places (N, 2) m with a margin; its outer edges are at multiples of `whole_m`.

    Raises TrajectoryError where the places are so far apart, which `far_apart` is said of, or `whole_m` is so large,
    that it would not fit into memory.
    """
    spans_m = np.ptp(places, axis=0) + 2 * margin_m
    return _fitting(lattice_around(places, margin_m, edge_m, whole_m), spans_m, whole_m, far_apart)


def lattice_around(places: Array, margin_m: float, edge_m: float, whole_m: float) -> Raster:
    """Raster as of `raster_around`, of any size: tiles are parts of it, but nothing as large as it fits into memory."""
    low = np.floor((places.min(axis=0) - margin_m) / whole_m) * whole_m
    high = np.ceil((places.max(axis=0) + margin_m) / whole_m) * whole_m
    columns, rows = (int(n) for n in np.rint((high - low) / edge_m))
    return Raster(float(low[0]), float(high[1]), edge_m, rows, columns)


def _fitting(raster: Raster, spans_m: Array, whole_m: float, far_apart: str) -> Raster:
    """Return the raster. Raises TrajectoryError where it would not fit into memory: because of the spans (2,) m of what
    it shows, or because it is made of whole squares of `whole_m`."""
    if raster.rows * raster.columns > MOST:
        cause = (
            far_apart
            if np.prod(spans_m) > MOST * raster.edge_m**2
            else f"are cells of {whole_m:g} m too large (--cell)?"
        )
        raise TrajectoryError(
            f"a map of the images' poses would be {raster.columns * raster.edge_m:.0f} x "
            f"{raster.rows * raster.edge_m:.0f} m: expected an area of at most {MOST * raster.edge_m**2:.0f} m^2 at a "
            f"raster of {raster.edge_m:g} m; {cause}"
        )
    return raster


def _length(part: slice) -> int:
    """Number of rows or columns of a slice that begins and ends on the raster."""
    return int(max(0, part.stop - part.start))


@dataclass(frozen=True)
class Tile:
    """The part of the ground that one image shows.

    raster: around it, along the path as it is; seen: (rows, columns), whether the image shows each square; distances_m,
    colours: (N,) and (N, 3) uint8 RGB, those of the nearest pixel in each of the N squares seen, row by row
    """

    raster: Raster
    seen: NDArray[np.bool_]
    distances_m: Array
    colours: NDArray[np.uint8]

    @property
    def numbers(self) -> NDArray[np.int64]:
        """Index (rows, columns) of each square among the N seen; -1 for those not seen."""
        return np.where(self.seen, np.cumsum(self.seen).reshape(self.seen.shape) - 1, -1)


def tile_of(raster: Raster, points: Array, distances_m: Array, colours: NDArray[np.uint8] | None = None) -> Tile:
    """Make the tile of an image from the points (N, 3) m of its pixels, their distances (N,) m and, optionally, colours
    (N, 3); what lies outside the raster is left out."""
    if colours is None:
        colours = np.zeros((len(points), 3), dtype=np.uint8)
    rows, columns, inside = raster.index(points[:, :2])
    rows, columns, distances_m, colours = rows[inside], columns[inside], distances_m[inside], colours[inside]
    if len(rows) == 0:
        return Tile(raster.part(slice(0, 0), slice(0, 0)), np.zeros((0, 0), dtype=bool), np.zeros(0), colours)
    part = raster.part(slice(int(rows.min()), int(rows.max()) + 1), slice(int(columns.min()), int(columns.max()) + 1))
    at = (rows - rows.min()) * part.columns + (columns - columns.min())
    nearest = np.full(part.rows * part.columns, np.inf)
    np.minimum.at(nearest, at, distances_m)
    stays = np.flatnonzero(distances_m == nearest[at])
    pixels = np.full(len(nearest), -1)
    pixels[at[stays]] = stays  # of several equally near pixels, the last one is kept
    seen = pixels >= 0
    return Tile(part, seen.reshape(part.rows, part.columns), nearest[seen], colours[pixels[seen]])


class Cover:
    """The squares seen: the number of images that show each, and its colour in the nearest of them."""

    def __init__(self, raster: Raster) -> None:
        shape = (raster.rows, raster.columns)
        self.raster = raster
        self.views: NDArray[np.uint16] = np.zeros(shape, dtype=np.uint16)
        self.colours: NDArray[np.uint8] = np.zeros((*shape, 3), dtype=np.uint8)
        self._nearest = np.full(shape, np.inf, dtype=np.float32)
        # Where squares are larger than those of the tiles: parts along an edge, and a bit for each part that is seen.
        self._parts = 1
        self._bits: NDArray[np.uint8] | None = None

    def lay(self, tile: Tile, move: Array) -> Squares:
        """Add an image's tile after a move (4, 4) about the vertical. Returns the squares that it shows.

        Each square of the raster takes what the tile has at the square's centre: if the tile's squares were moved
        instead, a rotation would leave gaps between them, and overlaps beside the gaps.
        """
        among, along = self.raster.between(*tile.raster.bounds(move))
        x = self.raster.west_m + self.raster.edge_m * (np.arange(along.start, along.stop) + 0.5)
        y = self.raster.north_m - self.raster.edge_m * (np.arange(among.start, among.stop) + 0.5)
        back = invert(move)
        middles = np.stack([way[0] * x + way[1] * y[:, None] + way[3] for way in back[:2]], axis=-1)
        rows, columns, inside = tile.raster.index(middles.reshape(-1, 2))
        shown = np.full(len(rows), -1)
        shown[inside] = tile.numbers[rows[inside], columns[inside]]
        there = np.flatnonzero(shown >= 0)
        at = among.start + there // len(x), along.start + there % len(x)
        self.views[at] += 1
        distances_m = tile.distances_m[shown[there]]
        better = distances_m <= self._nearest[at]
        best = at[0][better], at[1][better]
        self.colours[best] = tile.colours[shown[there[better]]]
        self._nearest[best] = distances_m[better]
        self._measure(tile, move)
        return at

    def _measure(self, tile: Tile, move: Array) -> None:
        """Note which parts of each square a tile shows whose own squares are smaller."""
        often = min(round(self.raster.edge_m / tile.raster.edge_m), MOST_PARTS)
        if often < 2 or not tile.raster.rows:
            return
        if self._bits is None:
            self._parts, self._bits = often, np.zeros((*self.views.shape, -(-(often**2) // 8)), dtype=np.uint8)
        among, along = self.raster.touching(*tile.raster.bounds(move))
        step = self.raster.edge_m / often
        x = self.raster.west_m + self.raster.edge_m * along.start + step * (np.arange(often * _length(along)) + 0.5)
        y = self.raster.north_m - self.raster.edge_m * among.start - step * (np.arange(often * _length(among)) + 0.5)
        seen, back = _closed(tile.seen, tile.raster.edge_m), invert(move)
        middles = np.stack([way[0] * x + way[1] * y[:, None] + way[3] for way in back[:2]], axis=-1)
        rows, columns, inside = tile.raster.index(middles.reshape(-1, 2))
        shown = np.zeros(len(rows), dtype=bool)
        shown[inside] = seen[rows[inside], columns[inside]]
        parts = shown.reshape(_length(among), often, _length(along), often).swapaxes(1, 2)
        self._bits[among, along] |= np.packbits(parts.reshape(_length(among), _length(along), often**2), axis=2)

    def closed(self) -> NDArray[np.bool_]:
        """Mask (rows, columns) of the squares that count as seen: small gaps are closed."""
        return _closed(self.views > 0, self.raster.edge_m)

    def seen(self) -> NDArray[Any]:
        """How much of each square was seen (rows, columns): all or nothing; shares where squares are larger than
        those of the tiles, and the edge of a strip would be off by half of one."""
        if self._bits is None:
            return self.closed()
        shares, parts = np.zeros(self.views.shape, dtype=np.float32), self._parts
        size, step = BLOCK // parts, self.raster.edge_m / parts
        beside = -(-2 * _closings(step) // parts)  # squares around a block that what is closed in it depends on
        for top, left in product(*(range(0, int(n), size) for n in self.views.shape)):
            first, start = max(0, top - beside), max(0, left - beside)
            bits = self._bits[first : top + size + beside, start : left + size + beside]
            if not bits.any():
                continue
            rows, columns, _ = bits.shape
            shown = np.unpackbits(bits, axis=2, count=parts**2).reshape(rows, columns, parts, parts).swapaxes(1, 2)
            seen = _closed(shown.reshape(rows * parts, columns * parts) > 0, step)
            share = seen.reshape(rows, parts, columns, parts).mean(axis=(1, 3), dtype=np.float32)
            shares[top : top + size, left : left + size] = share[top - first :, left - start :][:size, :size]
        return shares

    def holds(self, xy: Array) -> NDArray[np.bool_]:
        """Whether each of the points (N, 2) m lies in the area seen, (N,)."""
        rows, columns, inside = self.raster.index(xy)
        found = np.zeros(len(xy), dtype=bool)
        found[inside] = self.closed()[rows[inside], columns[inside]]
        return found


def _closings(edge_m: float) -> int:
    """By how many squares of an edge what was seen grows, and shrinks again, for its small gaps to close."""
    return max(1, round(CLOSED_M / edge_m / 2))


def _closed(seen: NDArray[np.bool_], edge_m: float) -> NDArray[np.bool_]:
    """A mask of squares of an edge with its small gaps closed."""
    times = _closings(edge_m)
    padded = np.pad(seen, times)
    return np.asarray(binary_closing(padded, np.ones((3, 3), dtype=bool), iterations=times)[times:-times, times:-times])


def covered_m2(raster: Raster, seen: NDArray[Any], settings: MapSettings) -> Array:
    """Area of each grid cell, (rows, columns) m^2, of what was `seen` of the raster's squares (`Cover.seen`). Its outer
    edges are those of cells."""
    per_cell = round(settings.cell_m / raster.edge_m)
    cells = seen.reshape(raster.rows // per_cell, per_cell, raster.columns // per_cell, per_cell)
    return np.asarray(cells.sum(axis=(1, 3), dtype=float) * raster.edge_m**2)


def units_of(raster: Raster, edge_m: float) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Row of each of the raster's rows, and column of each of its columns, in squares of another edge."""
    rows, columns = (
        np.floor((np.arange(n) + 0.5) * raster.edge_m / edge_m).astype(np.int64) for n in (raster.rows, raster.columns)
    )
    return rows, columns


def units_m2(raster: Raster, seen: NDArray[Any], edge_m: float) -> Array:
    """Area (rows, columns) m^2 of what was `seen` of the raster's squares, in squares of another edge."""
    sums: NDArray[Any] = seen
    for index in units_of(raster, edge_m):
        starts = np.flatnonzero(np.diff(index, prepend=-1))
        filled = np.zeros((int(index[-1]) + 1, sums.shape[1]))
        filled[index[starts]] = np.add.reduceat(sums, starts, axis=0, dtype=float)
        sums = filled.T
    return np.asarray(sums * raster.edge_m**2)
