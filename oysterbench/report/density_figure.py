"""Figure of a map: the seen ground from above with every oyster on it, and oysters per square metre beside it."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from itertools import accumulate, pairwise
from textwrap import wrap
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np
from numpy.typing import NDArray

from oysterbench.mapping.grid import Total
from oysterbench.mapping.survey import OysterMap
from oysterbench.report.density import DensityRun
from oysterbench.report.figures import (
    INK,
    POINTS_PER_INCH,
    add_note,
    add_scale_bar,
    figure_style,
    new_figure,
    rgb,
    svg_of,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

COLOURS = ("#ffffcc", "#c7e9b4", "#7fcdbb", "#41b6c4", "#2c7fb8", "#253494")
"""YlGnBu of ColorBrewer, which is readable for the colour-blind and in greyscale: light is few."""
EDGES = (5.0, 15.0, 30.0, 50.0, 100.0)
"""Boundaries between them, live oysters per m^2; 15 and 50 separate the restoration classes."""
STATES = {
    "live": ("#f7f7f7", "live"),
    "dead": ("#d95f02", "dead (boxes, single valves)"),
    "unknown": ("#ffd92f", "live or dead unknown"),
}
"""State of an oyster -> its colour and name."""
NONE = "#e5e8eb"
DEPTHS = {
    "stereo": "depth from the stereo pair",
    "motion": "depth from camera motion",
    "plane": "depth from echoes, as a plane",
    "layer": "true depth",
}

NARROW = 4.6  # inches of the longer side of a panel by itself, as wide as a phone shows it

SQUARED = "\N{SUPERSCRIPT TWO}"
MOSAIC_PX = 1200  # maximum along the longer side
PANEL = 7.0  # inches of the longer side of a panel in the figure
LINE_SIZE = 12.5  # points, font size of the numbers below the headline
LINE = 1.6 * LINE_SIZE / POINTS_PER_INCH  # inches, height of a line
LETTERS = 10.5  # minimum number of letters of that size per inch
NO_NORTH = (
    "Up is +y of the path: north where the path is the ground truth of a rendered dive, any direction where it is an "
    "estimate. "
)
NO_MAGNETOMETER = "No magnetometer shows where north is."
NO_AGREEMENT = (
    "The magnetometer does not show where north is: along this path its readings disagree, or the vehicle turned too "
    "little to tell them from unknown iron on board."
)
ARROW = 20.0  # points, half the length of the north arrow
TEXT_CELL = 26.0  # points, minimum edge of a cell for its number to be written into it
WIDTH, HEIGHT = 0.64, 0.8  # of a digit, as shares of the size of the font


@figure_style()
def figure(found: OysterMap) -> Figure:
    """Draw a map: counts as headline; two panels of the same ground, +y of the path up, scale bar, grid and legend."""
    ground = _ground(found, PANEL)
    page = 2 * max(ground.width, 4.6) + 1.0
    said = [part for line in numbers(found.total, found.grid.shares()) for part in wrap(line, int(page * LETTERS))]
    made = new_figure(_headline(found), page, ground.height + 2.7 + len(said) * LINE)
    grid = made.add_gridspec(2, 2, height_ratios=[len(said) * LINE, ground.height + 1.0])
    _text(made.add_subplot(grid[0, :]), said)
    panels = [made.add_subplot(grid[1, k]) for k in range(2)]
    _seen_from_above(panels[0], found, ground)
    _density(panels[1], found, ground)
    add_note(made, *notes(found))
    return made


def titles(found: OysterMap) -> tuple[str, str]:
    """Titles of the two panels."""
    what = "Live oysters" if found.total.told else "Oysters, live or dead unknown,"
    return "From above, one dot per oyster", f"{what} per m{SQUARED}"


@figure_style()
def panels(found: OysterMap) -> tuple[Figure, Figure]:
    """Draw the same two panels separately and without text, so that they are also readable on a narrow screen."""
    ground = _ground(found, NARROW)
    made = []
    for title, draw, room in zip(titles(found), (_seen_from_above, _density), (0.5, 0.9), strict=True):
        one = new_figure(title, max(ground.width, 3.6) + 0.4, ground.height + room)
        draw(one.subplots(), found, ground)
        one.axes[0].set_title("")
        heading = one.suptitle(title)  # the page shows it; here it is the hidden text alternative of the figure
        heading.set(visible=False, in_layout=False)
        made.append(one)
    return made[0], made[1]


def drawn(run: DensityRun) -> DensityRun:
    """Replace the map of a run, which is large, by its figures; a failed run is returned unchanged."""
    if run.result is None:
        return run
    figures = tuple(zip(titles(run.result), map(svg_of, panels(run.result)), strict=True))
    return replace(run, result=None, panels=figures, said=f"{counted(run.result.total)}.")


def notes(found: OysterMap) -> list[str]:
    """Notes on a map, in sentences."""
    return [
        f"{len(found.path)} of {found.images} images of {found.camera} that have masks, {DEPTHS[found.depth]}",
        "Oysters hidden under others in every image are not counted.",
        "An oyster that the edge always cuts counts as half.",
        "? the 95 % interval extends into another class. Grey: too little seen.",
        _north(found),
    ]


def _north(found: OysterMap) -> str:
    if found.magnetic_north_rad is not None:
        return "N is magnetic north; up is +y of the path."
    return NO_NORTH + (NO_AGREEMENT if found.has_magnetometer else NO_MAGNETOMETER)


@dataclass(frozen=True)
class Ground:
    """The part of a map that is drawn. rows, columns: slices of the raster; extent: west, east, south, north, m;
    width, height: inches; inch_m: metres per inch."""

    seen: NDArray[np.bool_]
    rows: slice
    columns: slice
    extent: tuple[float, float, float, float]
    width: float
    height: float
    inch_m: float


def _ground(found: OysterMap, panel: float) -> Ground:
    """Choose the part of a map to draw. panel: its longer side in inches."""
    raster, seen = found.cover.raster, found.cover.closed()
    first, last, left, right = _frame(seen, raster.edge_m, found.settings.cell_m)
    inch_m = max(last - first, right - left) * raster.edge_m / panel
    height, width = (last - first) * raster.edge_m / inch_m, (right - left) * raster.edge_m / inch_m
    west, north = raster.west_m + left * raster.edge_m, raster.north_m - first * raster.edge_m
    extent = (west, west + width * inch_m, north - height * inch_m, north)
    return Ground(seen, slice(first, last), slice(left, right), extent, width, height, inch_m)


def _show(axes: Axes, pixels: NDArray[np.uint8], ground: Ground) -> None:
    axes.imshow(_small(pixels[ground.rows, ground.columns]), extent=ground.extent)
    axes.set(xticks=(), yticks=())
    axes.spines[:].set_visible(True)


def _seen_from_above(axes: Axes, found: OysterMap, ground: Ground) -> None:
    _show(axes, mosaic(found, ground.seen), ground)
    axes.set_title(titles(found)[0])
    _oysters(axes, found, POINTS_PER_INCH / ground.inch_m)
    add_scale_bar(axes, ground.extent[1] - ground.extent[0])
    _north_arrow(axes, found.magnetic_north_rad)


def _density(axes: Axes, found: OysterMap, ground: Ground) -> None:
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import from_levels_and_colors

    _show(axes, _cell_pixels(found, ground.seen), ground)
    axes.set_title(titles(found)[1])
    _cells(axes, found, ground.seen, found.settings.cell_m * POINTS_PER_INCH / ground.inch_m)
    cmap, norm = from_levels_and_colors((0.0, *EDGES), COLOURS, extend="max")
    classes = "below the threshold: under 15; at the target: from 50"
    axes.figure.colorbar(ScalarMappable(norm, cmap), ax=axes, location="bottom", label=classes, aspect=30)


def _north_arrow(axes: Axes, clockwise_rad: float | None) -> None:
    """Draw magnetic north in the upper right corner; nothing if it is not known."""
    from matplotlib.patheffects import withStroke

    if clockwise_rad is None:
        return
    way = ARROW * np.array([math.sin(clockwise_rad), math.cos(clockwise_rad)])
    middle = np.full(2, -2.0 * ARROW)  # from the right and from the top
    axes.annotate(
        "N",
        tuple(middle + way),
        tuple(middle - way),
        xycoords="axes points",
        ha="center",
        va="center",
        weight="bold",
        arrowprops={
            "arrowstyle": "-|>",
            "color": INK,
            "linewidth": 2,
            "path_effects": [withStroke(linewidth=5, foreground="white")],
        },
        bbox={"facecolor": "white", "edgecolor": "none", "pad": 2},
    )


def _frame(seen: NDArray[np.bool_], edge_m: float, cell_m: float) -> tuple[int, int, int, int]:
    """Bounds of the rows and columns of whole cells that contain everything that was seen."""
    per_cell = round(cell_m / edge_m)
    rows, columns = (np.flatnonzero(seen.any(axis=axis)) for axis in (1, 0))
    if not len(rows):
        return 0, seen.shape[0], 0, seen.shape[1]
    ends = [(a[0] // per_cell * per_cell, (a[-1] // per_cell + 1) * per_cell) for a in (rows, columns)]
    return int(ends[0][0]), int(ends[0][1]), int(ends[1][0]), int(ends[1][1])


def _headline(found: OysterMap) -> str:
    total = found.total
    counted = f"{_count(total.count)} oysters on {total.area_m2:.1f} m{SQUARED}"
    what = "live per" if total.told else "per"
    return f"{found.name}: {counted}" + (
        "" if math.isnan(total.live_per_m2) else f", {total.live_per_m2:.1f} {what} m{SQUARED}"
    )


def _text(axes: Axes, lines: list[str]) -> None:
    axes.set_axis_off()
    axes.text(0, 1, "\n".join(lines), va="top", size=LINE_SIZE, transform=axes.transAxes, linespacing=1.35)


def counted(total: Total) -> str:
    """The count with its interval, in words."""
    return (
        f"{_count(total.count)} oysters counted (95 %: {_count(total.count_low)} to {_count(total.count_high)}) on "
        f"{total.area_m2:.1f} m{SQUARED} of seen ground: {_states(total)}"
    )


def numbers(total: Total, shares: dict[str, float]) -> list[str]:
    """Results of the map, in words."""
    lines = [counted(total)]
    if not math.isnan(total.live_per_m2):
        what = "live oysters" if total.told else "oysters, live or dead unknown,"
        of = "sampled reef" if total.of_reef else "seen ground alone, as too little was seen to tell of the reef"
        lines.append(
            f"{total.live_per_m2:.1f} {what} per m{SQUARED} (95 % for the {of}: "
            f"{total.low_per_m2:.1f} to {total.high_per_m2:.1f})"
        )
    if not any(math.isnan(share) for share in shares.values()):
        what = "live per" if total.told else "per"
        below, middle, target = (f"{100 * share:.0f} %" for share in shares.values())
        lines.append(
            f"Of the area: {below} below the threshold of 15 {what} m{SQUARED}, {middle} from 15 to 50, {target} at "
            "the target of 50 or more"
        )
    return lines


def _states(total: Total) -> str:
    """Numbers by state, rounded such that they add up to the rounded total."""
    parts = {"live": total.live, "dead": total.dead, "live or dead unknown": total.unknown}
    ends = [0, *(round(end) for end in accumulate(parts.values()))]
    shown = zip(parts.items(), pairwise(ends), strict=True)
    return ", ".join(f"{_count(end - start)} {name}" for (name, n), (start, end) in shown if n) or "none"


def _count(n: float) -> str:
    return f"{n:,.0f}".replace(",", " ")


def _oysters(axes: Axes, found: OysterMap, points_per_m: float) -> None:
    radius = min(3.2, max(1.3, 0.025 * points_per_m))
    for state, (colour, name) in sorted(STATES.items(), key=lambda item: item[0] == "live"):
        places = np.array([one.centre[:2] for one in found.oysters if one.state == state])
        if len(places):
            look: dict[str, Any] = {"s": (2 * radius) ** 2, "color": colour, "edgecolors": INK, "linewidths": 0.6}
            axes.scatter(*places.T, label=name, **look)
    if found.oysters:
        axes.legend(loc="upper left", bbox_to_anchor=(0, 0), ncols=3, markerscale=2)


def mosaic(found: OysterMap, seen: NDArray[np.bool_]) -> NDArray[np.uint8]:
    """Mosaic (rows, columns, 3) of the seen ground, its colours stretched to their range; light grey elsewhere."""
    known = found.cover.views > 0
    made = np.full((*seen.shape, 3), rgb(NONE), dtype=np.uint8)
    if known.any():
        colours = found.cover.colours[known].astype(float)
        low, high = np.percentile(colours, [1, 99.5], axis=0)
        made[known] = np.clip(30 + 200 * (colours - low) / np.maximum(high - low, 1.0), 0, 255).astype(np.uint8)
    made[seen & ~known] = 90
    return made


def _small(pixels: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Shrink an image to at most MOSAIC_PX along the longer side."""
    scale = MOSAIC_PX / max(pixels.shape[:2])
    if scale >= 1:
        return pixels
    return np.asarray(cv2.resize(pixels, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA), dtype=np.uint8)


def density_pixels(found: OysterMap, seen: NDArray[np.bool_]) -> NDArray[np.uint8]:
    """Cell colours (rows, columns, 4) RGBA where the ground was seen; transparent where there is no number."""
    per_cell = round(found.settings.cell_m / found.cover.raster.edge_m)
    density = found.grid.density
    palette = np.array([rgb(colour) for colour in COLOURS], dtype=np.uint8)
    coloured = palette[np.searchsorted(EDGES, np.nan_to_num(density), side="right")]
    cells = np.concatenate([coloured, np.where(np.isnan(density), 0, 255)[..., None].astype(np.uint8)], axis=-1)
    made: NDArray[np.uint8] = np.repeat(np.repeat(cells, per_cell, axis=0), per_cell, axis=1)
    made[~seen] = 0
    return made


def _cell_pixels(found: OysterMap, seen: NDArray[np.bool_]) -> NDArray[np.uint8]:
    """Cell colours (rows, columns, 3) on an opaque background, with two greys where there is no number."""
    pixels = density_pixels(found, seen)
    clear = pixels[..., 3] == 0
    plain = np.where(clear[..., None], np.array(rgb(NONE), dtype=np.uint8), pixels[..., :3])
    plain[clear & seen] = rgb("#c5ccd3")
    return np.asarray(plain, dtype=np.uint8)


def _cells(axes: Axes, found: OysterMap, seen: NDArray[np.bool_], edge: float) -> None:
    """Draw the lines between cells, and the number of each if there is room for it. edge: edge of a cell, points."""
    from matplotlib.patheffects import withStroke

    grid, (west, east), (south, north) = found.grid, axes.get_xlim(), axes.get_ylim()
    axes.vlines(np.arange(west, east, grid.cell_m)[1:], south, north, color="#9aa5b1", linewidth=0.5)
    axes.hlines(np.arange(north, south, -grid.cell_m)[1:], west, east, color="#9aa5b1", linewidth=0.5)
    if edge < TEXT_CELL:
        return
    per_cell = round(grid.cell_m / found.cover.raster.edge_m)
    for row, column in zip(*np.nonzero(grid.known), strict=True):
        part = seen[row * per_cell : (row + 1) * per_cell, column * per_cell : (column + 1) * per_cell]
        down, right = (float(np.mean(at) + 0.5) * found.cover.raster.edge_m for at in np.nonzero(part))
        value = float(grid.density[row, column])
        level = int(np.searchsorted(EDGES, value, side="right"))
        text = f"{value:.0f}" if value >= 9.95 or value == 0 else f"{value:.1f}"
        text += "" if grid.sure[row, column] else "?"
        size = min(12.6, 0.31 * edge)
        x = grid.west_m + column * grid.cell_m + kept_within(right, grid.cell_m, WIDTH * size * len(text) / edge)
        y = grid.north_m - row * grid.cell_m - kept_within(down, grid.cell_m, HEIGHT * size / edge)
        # If only fragments of a cell were seen, the text would overlap the background beside them.
        halo = [withStroke(linewidth=3.2, foreground=COLOURS[level])]
        look: dict[str, Any] = {
            "size": size,
            "color": "white" if level >= 4 else INK,
            "path_effects": halo,
        }
        axes.text(x, y, text, ha="center", va="center", **look)


def kept_within(at: float, whole: float, share: float) -> float:
    """Move the middle of a text so that it stays within a cell. share: of the cell's edge that the text takes.

    >>> kept_within(0.1, 1.0, share=0.5), kept_within(0.6, 1.0, share=0.5), kept_within(0.1, 1.0, share=2.0)
    (0.25, 0.6, 0.5)
    """
    half = 0.5 * whole * min(share, 1.0)
    return min(max(at, half), whole - half)
