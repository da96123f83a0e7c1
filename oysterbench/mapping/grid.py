"""Oysters per square metre on a grid, with confidence intervals, and the restoration classes."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from oysterbench.core.geometry import Array
from oysterbench.evaluate.density.restoration import RESTORATION_CLASSES, restoration_class
from oysterbench.evaluate.exact import count_interval
from oysterbench.mapping.cover import Cover, covered_m2
from oysterbench.mapping.intervals import clumping, doubt_variance
from oysterbench.mapping.settings import MapSettings

STATES = ("live", "dead", "unknown")


@dataclass(frozen=True)
class Oyster:
    """An oyster of a map.

    centre: (3,) m in the world frame of the trajectory; state: live, dead or unknown; views: number of images that show
    it; weight: what it counts, 1/2 if no image shows it whole; doubt, score: see `track.OysterTrack`
    """

    centre: Array
    state: str
    views: int
    weight: float = 1.0
    doubt: float = 0.0
    score: float = 1.0


@dataclass(frozen=True)
class Grid:
    """Grid of cells, with row 0 the northernmost; every array is (rows, columns).

    west_m, north_m:  position of the outer corner of the first cell
    area_m2:          area seen
    counts:           oysters on the area seen, by state
    live:             live oysters, with `live_share` of those of unknown state
    low, high:        95 % confidence interval of live oysters per m^2; NaN if the cell has no value
    known:            whether enough of the cell was seen for it to have a value
    """

    west_m: float
    north_m: float
    cell_m: float
    area_m2: Array
    counts: dict[str, Array]
    live: Array
    low: Array
    high: Array
    known: NDArray[np.bool_]
    live_share: float

    @property
    def density(self) -> Array:
        """Live oysters per m^2, NaN in cells without a value."""
        return self.per_m2(self.live)

    def per_m2(self, counts: Array) -> Array:
        """Divide counts by the area seen; NaN in cells without a value."""
        return np.where(self.known, counts / np.where(self.known, self.area_m2, 1.0), math.nan)

    @property
    def classes(self) -> NDArray[np.int64]:
        """Index of each cell's class in `RESTORATION_CLASSES`, -1 in cells without a value."""
        return restoration_class(self.density)

    @property
    def sure(self) -> NDArray[np.bool_]:
        """Whether the confidence interval of each cell lies within one class."""
        return np.asarray(self.known & (restoration_class(self.low) == restoration_class(self.high)))

    def shares(self) -> dict[str, float]:
        """Share of each class in the area of the cells with a value; NaN if there is none."""
        area = self.area_m2[self.known].sum()
        found = self.classes
        return {
            name: float(self.area_m2[found == k].sum() / area) if area > 0 else math.nan
            for k, name in enumerate(RESTORATION_CLASSES)
        }


@dataclass(frozen=True)
class Total:
    """Totals of the area seen: oysters counted, and live ones per m^2, each with a 95 % confidence interval.

    The interval of the count covers the uncertainty of edges, association and scores; that of the mean density also
    that the area seen is a sample of a reef with clumped oysters (clumping_k: k of the negative binomial, NaN with too
    few cells).
    """

    count: float
    count_low: float
    count_high: float
    live: float
    dead: float
    unknown: float
    area_m2: float
    live_per_m2: float
    low_per_m2: float
    high_per_m2: float
    clumping_k: float

    @property
    def told(self) -> bool:
        """Whether any oyster is known to be live or dead; if not, `live_per_m2` counts all of them."""
        return self.live + self.dead > 0 or self.unknown == 0


def make_grid(
    oysters: list[Oyster], cover: Cover, settings: MapSettings, depth_sigma: float, unassociated: float | None = None
) -> Grid:
    """Make the grid; cell edges are at multiples of `cell_m` in the world frame. unassociated: as for `total`."""
    raster = cover.raster
    area = covered_m2(cover, settings)
    known = area >= settings.least_cover * settings.cell_m**2
    counts = {state: np.zeros(area.shape) for state in STATES}
    spread = np.zeros(area.shape)
    per_cell = round(settings.cell_m / raster.edge_m)
    rows, columns, inside = raster.index(_places(oysters))
    for k in np.flatnonzero(inside):
        oyster, at = oysters[k], (rows[k] // per_cell, columns[k] // per_cell)
        counts[oyster.state][at] += oyster.weight
        spread[at] += _doubt([oyster])
    share = live_share(oysters)
    live = counts["live"] + share * counts["unknown"]
    low, high = (np.full(area.shape, math.nan) for _ in range(2))
    sigma, (least, most) = area_sigma(depth_sigma, 1), association_range(oysters, unassociated)
    for at in zip(*np.nonzero(known), strict=True):
        n = float(live[at])
        variance = n + float(spread[at]) + (n * sigma) ** 2
        ends = count_interval(n, variance)
        low[at], high[at] = least * ends[0] / area[at], most * ends[1] / area[at]
    return Grid(raster.west_m, raster.north_m, settings.cell_m, area, counts, live, low, high, known, share)


def live_share(oysters: list[Oyster]) -> float:
    """Share of live oysters among those whose state is known; 1 if none is (`Total.told`)."""
    live = sum(one.weight for one in oysters if one.state == "live")
    dead = sum(one.weight for one in oysters if one.state == "dead")
    return live / (live + dead) if live + dead > 0 else 1.0


def area_sigma(depth_sigma: float, pictures: int) -> float:
    """Relative standard deviation of an area: areas scale with the square of the depth, whose errors are assumed to be
    fully correlated within an image and independent between images."""
    return 2.0 * depth_sigma / math.sqrt(max(1, pictures))


def total(
    oysters: list[Oyster], grid: Grid, depth_sigma: float, pictures: int, unassociated: float | None = None
) -> Total:
    """Compute the totals of the area that `pictures` images have seen. unassociated: the count without association
    (`mapping.unassociated`); if given, the confidence intervals include it, too."""
    by_state = {state: sum(one.weight for one in oysters if one.state == state) for state in STATES}
    count, area = sum(by_state.values()), float(grid.area_m2.sum())
    doubt, (least, most) = _doubt(oysters), association_range(oysters, unassociated)
    half = 1.96 * math.sqrt(doubt)
    live = by_state["live"] + grid.live_share * by_state["unknown"]
    excess = clumping(grid.live[grid.known], grid.area_m2[grid.known])
    means = live / area * grid.area_m2 if area > 0 else np.zeros(0)
    scatter = float((means + (0.0 if math.isnan(excess) else excess) * means**2).sum())
    low, high = count_interval(live, scatter + doubt + (live * area_sigma(depth_sigma, pictures)) ** 2)
    return Total(
        count,
        max(0.0, least * count - half),
        most * count + half,
        by_state["live"],
        by_state["dead"],
        by_state["unknown"],
        area,
        live / area if area > 0 else math.nan,
        least * low / area if area > 0 else math.nan,
        most * high / area if area > 0 else math.nan,
        math.nan if math.isnan(excess) else (1.0 / excess if excess > 0 else math.inf),
    )


def association_range(oysters: list[Oyster], unassociated: float | None) -> tuple[float, float]:
    """Lowest and highest plausible number of oysters, as multiples of the count."""
    count = sum(one.weight for one in oysters)
    share = 1.0 if unassociated is None or count == 0 else unassociated / count
    return min(1.0, share), max(1.0, share)


def _places(oysters: list[Oyster]) -> Array:
    return np.array([one.centre[:2] for one in oysters]).reshape(-1, 2)


def _doubt(oysters: list[Oyster]) -> float:
    cut = np.array([one.weight < 1.0 for one in oysters], dtype=float)
    doubt, score = (np.array([getattr(one, key) for one in oysters], dtype=float) for key in ("doubt", "score"))
    return float(doubt_variance(cut, doubt, score).sum())
