"""Oysters per square metre on a grid, with confidence intervals, and the restoration classes."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from oysterbench.core.geometry import Array
from oysterbench.evaluate.density.restoration import RESTORATION_CLASSES, restoration_class
from oysterbench.evaluate.exact import count_interval, share_interval
from oysterbench.mapping.cover import Cover, covered_m2, units_m2, units_of
from oysterbench.mapping.intervals import UNIT_M, Sampling, clumping, doubt_variance, sampling
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
    live_range:       95 % confidence interval of `live_share`
    sampling:         how much the live oysters scatter between parts of the reef, whatever the cells are
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
    live_range: tuple[float, float]
    sampling: Sampling

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
    the share of live ones among those of unknown state and, if `of_reef`, that the area seen is a sample of a reef with
    clumps and patches. clumping_k: k of the negative binomial of the cells, NaN with too few of them; block_m: see
    `intervals.Sampling`.
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
    block_m: float

    @property
    def of_reef(self) -> bool:
        """Whether the interval of the mean density is that of the sampled reef; if not, too little was seen to tell how
        much that scatters, and it is of the seen ground alone."""
        return not math.isnan(self.block_m)

    @property
    def told(self) -> bool:
        """Whether any oyster is known to be live or dead; if not, `live_per_m2` counts all of them."""
        return self.live + self.dead > 0 or self.unknown == 0


def make_grid(
    oysters: list[Oyster], cover: Cover, settings: MapSettings, depth_sigma: float, unassociated: float | None = None
) -> Grid:
    """Make the grid; cell edges are at multiples of `cell_m` in the world frame. unassociated: as for `total`."""
    raster, seen = cover.raster, cover.seen()
    area = covered_m2(raster, seen, settings)
    known = area >= settings.least_cover * settings.cell_m**2
    counts = {state: np.zeros(area.shape) for state in STATES}
    spread = np.zeros(area.shape)
    per_cell = round(settings.cell_m / raster.edge_m)
    rows, columns, inside = raster.index(_places(oysters))
    for k in np.flatnonzero(inside):
        oyster, at = oysters[k], (rows[k] // per_cell, columns[k] // per_cell)
        counts[oyster.state][at] += oyster.weight
        spread[at] += _doubt([oyster])
    share, shares = live_share(oysters), live_range(oysters)
    live, fewest, most_live = (counts["live"] + of_unknown * counts["unknown"] for of_unknown in (share, *shares))
    low, high = (np.full(area.shape, math.nan) for _ in range(2))
    sigma, (least, most) = area_sigma(depth_sigma, 1), association_range(oysters, unassociated)
    for at in zip(*np.nonzero(known), strict=True):
        ends = [
            count_interval(n, n + float(spread[at]) + (n * sigma) ** 2)
            for n in (float(fewest[at]), float(most_live[at]))
        ]
        low[at], high[at] = least * ends[0][0] / area[at], most * ends[1][1] / area[at]
    units = units_m2(raster, seen, UNIT_M)
    counted, (to_row, to_column) = np.zeros(units.shape), units_of(raster, UNIT_M)
    of_state = {"live": 1.0, "dead": 0.0, "unknown": share}
    for k in np.flatnonzero(inside):
        counted[to_row[rows[k]], to_column[columns[k]]] += of_state[oysters[k].state] * oysters[k].weight
    return Grid(
        raster.west_m, raster.north_m, settings.cell_m, area, counts, live, low, high, known, share, shares,
        sampling(counted, units),
    )  # fmt: skip


def known_states(oysters: list[Oyster]) -> tuple[float, float]:
    """Number of oysters known to be live, and of those known to be dead."""
    live, dead = (sum(one.weight for one in oysters if one.state == state) for state in ("live", "dead"))
    return live, dead


def live_share(oysters: list[Oyster]) -> float:
    """Share of live oysters among those whose state is known; 1 if none is (`Total.told`), or if masks tell one state
    alone, as where only empty shells are labelled: this says nothing of the others."""
    live, dead = known_states(oysters)
    return live / (live + dead) if live > 0 and dead > 0 else 1.0


def live_range(oysters: list[Oyster]) -> tuple[float, float]:
    """Ends of the 95 % confidence interval of `live_share`: from 0 to 1 if masks tell one state alone. If none is
    known, all oysters are counted, and none of them as live or dead: 1 and 1."""
    live, dead = known_states(oysters)
    if live > 0 and dead > 0:
        return share_interval(live, live + dead)
    return (0.0, 1.0) if live + dead > 0 else (1.0, 1.0)


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
    sigma, variance = area_sigma(depth_sigma, pictures), grid.sampling.variance
    times = 0.0 if math.isnan(variance) or live == 0 else variance / live
    low, high = (
        count_interval(n, times * n + doubt + (n * sigma) ** 2)[end]
        for end, n in enumerate(by_state["live"] + share * by_state["unknown"] for share in grid.live_range)
    )
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
        grid.sampling.block_m,
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
