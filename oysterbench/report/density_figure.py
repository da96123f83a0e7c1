"""The map as a figure: what was seen from above with every oyster on it, and oysters per square metre beside it."""

from __future__ import annotations

import math

import cv2
import numpy as np
from numpy.typing import NDArray

from oysterbench.core.geometry import Array
from oysterbench.mapping.grid import Total
from oysterbench.mapping.survey import OysterMap
from oysterbench.report.drawing import INK, SOFT, Drawing, rgb

COLOURS = ("#ffffcc", "#c7e9b4", "#7fcdbb", "#41b6c4", "#2c7fb8", "#253494")
"""YlGnBu of ColorBrewer, which the colour-blind can read, and a printer in grey: light is few."""
EDGES = (5.0, 15.0, 30.0, 50.0, 100.0)
"""Live oysters per m^2 between them; 15 and 50 divide the classes of restoration."""
LIVE, DEAD, UNKNOWN = "#f7f7f7", "#d95f02", "#ffd92f"
STATE_COLOURS = {"live": LIVE, "dead": DEAD, "unknown": UNKNOWN}
NONE = "#e5e8eb"
DEPTHS = {
    "stereo": "depth from the pair of cameras",
    "motion": "depth from the camera's way",
    "plane": "depth from echoes, as a plane",
    "layer": "true depth",
}

PANEL, MARGIN, TOP, FOOT = 560.0, 28.0, 118.0, 128.0
SQUARED = "\N{SUPERSCRIPT TWO}"
MOSAIC_PX = 1200  # along the longer side
TEXT_CELL = 26.0  # units of a cell's edge, from which on its number is written into it


def figure(found: OysterMap) -> Drawing:
    """Two panels of the same ground, north up, with scale bar, grid, legend and totals."""
    raster, seen = found.cover.raster, found.cover.closed()
    frame = _frame(seen, raster.edge_m, found.settings.cell_m)
    rows, columns = frame[1] - frame[0], frame[3] - frame[2]
    per_square = PANEL / max(rows, columns)
    width, height = max(columns * per_square, 380.0), rows * per_square
    sheet = Drawing(3 * MARGIN + 2 * width, TOP + height + FOOT, f"Oysters of {found.name}")
    _heading(sheet, found)
    lefts = (MARGIN, 2 * MARGIN + width)
    panels = [_Panel(found, frame, left + 0.5 * (width - columns * per_square), TOP, per_square) for left in lefts]
    _mosaic(sheet, panels[0], found, seen)
    _cells(sheet, panels[1], found, seen)
    for panel, title in zip(
        panels, ("Seen from above, every oyster a dot", f"Live oysters per m{SQUARED}"), strict=True
    ):
        sheet.rect(panel.left, panel.top, panel.width, panel.height, stroke=SOFT)
        sheet.text(panel.left, panel.top - 8, title, 14, bold=True)
    _scale_bar(sheet, panels[0])
    _north(sheet, panels[0].left + panels[0].width - 22, TOP + 34)
    _legends(sheet, lefts, TOP + height + 24, found)
    return sheet


class _Panel:
    """Where metres come to lie."""

    def __init__(
        self, found: OysterMap, frame: tuple[int, int, int, int], left: float, top: float, scale: float
    ) -> None:
        self.rows, self.columns = slice(*frame[:2]), slice(*frame[2:])
        raster = found.cover.raster
        self.left, self.top, self.per_m = left, top, scale / raster.edge_m
        self.west = raster.west_m + frame[2] * raster.edge_m
        self.north = raster.north_m - frame[0] * raster.edge_m
        self.width, self.height = (frame[3] - frame[2]) * scale, (frame[1] - frame[0]) * scale

    def place(self, x: float, y: float) -> tuple[float, float]:
        """Of metres of the world."""
        return self.left + (x - self.west) * self.per_m, self.top + (self.north - y) * self.per_m


def _frame(seen: NDArray[np.bool_], edge_m: float, cell_m: float) -> tuple[int, int, int, int]:
    """First and last row and column of whole cells that hold all that was seen."""
    per_cell = round(cell_m / edge_m)
    rows, columns = (np.flatnonzero(seen.any(axis=axis)) for axis in (1, 0))
    if not len(rows):
        return 0, seen.shape[0], 0, seen.shape[1]
    ends = [(a[0] // per_cell * per_cell, (a[-1] // per_cell + 1) * per_cell) for a in (rows, columns)]
    return int(ends[0][0]), int(ends[0][1]), int(ends[1][0]), int(ends[1][1])


def numbers(total: Total, shares: dict[str, float]) -> list[str]:
    """What the map says, in words."""
    said = [
        f"{_count(total.count)} oysters counted (95 %: {_count(total.count_low)} to {_count(total.count_high)}) on "
        f"{total.area_m2:.1f} m{SQUARED} of seen ground: {_states(total)}"
    ]
    if not math.isnan(total.live_per_m2):
        said.append(
            f"{total.live_per_m2:.1f} live oysters per m{SQUARED} (95 % for the reef that this is a sample of: "
            f"{total.low_per_m2:.1f} to {total.high_per_m2:.1f})"
        )
    if not any(math.isnan(share) for share in shares.values()):
        below, middle, target = (f"{100 * share:.0f} %" for share in shares.values())
        said.append(
            f"Of the area: {below} below the threshold of 15 live per m{SQUARED}, {middle} from 15 to 50, {target} at "
            "the target of 50 or more"
        )
    return said


def _states(total: Total) -> str:
    parts = [("live", total.live), ("dead", total.dead), ("not told whether live or dead", total.unknown)]
    return ", ".join(f"{_count(n)} {name}" for name, n in parts if n) or "none"


def _count(n: float) -> str:
    return f"{n:,.0f}".replace(",", " ")


def _heading(sheet: Drawing, found: OysterMap) -> None:
    sheet.text(MARGIN, 30, f"Oysters of {found.name}", 21, bold=True)
    for k, line in enumerate(numbers(found.total, found.grid.shares())):
        sheet.text(MARGIN, 52 + 18 * k, line, 13.5, fill=INK if k < 2 else SOFT)


def _mosaic(sheet: Drawing, panel: _Panel, found: OysterMap, seen: NDArray[np.bool_]) -> None:
    sheet.image(
        panel.left, panel.top, panel.width, panel.height, _small(mosaic(found, seen)[panel.rows, panel.columns])
    )
    radius = min(3.2, max(1.3, 0.025 * panel.per_m))
    oysters = sorted(found.oysters, key=lambda one: one.state == "live")
    places = [panel.place(float(one.centre[0]), float(one.centre[1])) for one in oysters]
    sheet.dots(places, radius, [STATE_COLOURS[one.state] for one in oysters], INK)


def mosaic(found: OysterMap, seen: NDArray[np.bool_]) -> NDArray[np.uint8]:
    """(rows, columns, 3): the colours of what was seen, stretched to the range that they have; light grey elsewhere."""
    known = found.cover.views > 0
    made = np.full((*seen.shape, 3), rgb(NONE), dtype=np.uint8)
    if known.any():
        colours = found.cover.colours[known].astype(float)
        low, high = np.percentile(colours, [1, 99.5], axis=0)
        made[known] = np.clip(30 + 200 * (colours - low) / np.maximum(high - low, 1.0), 0, 255).astype(np.uint8)
    made[seen & ~known] = 90
    return made


def _small(pixels: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """At most MOSAIC_PX along the longer side."""
    scale = MOSAIC_PX / max(pixels.shape[:2])
    if scale >= 1:
        return pixels
    return np.asarray(cv2.resize(pixels, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA), dtype=np.uint8)


def density_pixels(found: OysterMap, seen: NDArray[np.bool_]) -> NDArray[np.uint8]:
    """(rows, columns, 4) RGBA: the colours of the cells where it was seen; clear where there is no number."""
    per_cell = round(found.settings.cell_m / found.cover.raster.edge_m)
    density = found.grid.density
    palette = np.array([rgb(colour) for colour in COLOURS], dtype=np.uint8)
    coloured = palette[np.searchsorted(EDGES, np.nan_to_num(density), side="right")]
    cells = np.concatenate([coloured, np.where(np.isnan(density), 0, 255)[..., None].astype(np.uint8)], axis=-1)
    made: NDArray[np.uint8] = np.repeat(np.repeat(cells, per_cell, axis=0), per_cell, axis=1)
    made[~seen] = 0
    return made


def _cells(sheet: Drawing, panel: _Panel, found: OysterMap, seen: NDArray[np.bool_]) -> None:
    pixels = density_pixels(found, seen)[panel.rows, panel.columns]
    plain = np.where(pixels[..., 3:] > 0, pixels[..., :3], np.array(rgb(NONE), dtype=np.uint8))
    plain[(pixels[..., 3] == 0) & seen[panel.rows, panel.columns]] = rgb("#c5ccd3")
    sheet.image(panel.left, panel.top, panel.width, panel.height, _small(plain.astype(np.uint8)))
    grid, edge = found.grid, found.settings.cell_m * panel.per_m
    for k in range(1, round(panel.width / edge)):
        sheet.line(panel.left + k * edge, panel.top, panel.left + k * edge, panel.top + panel.height, "#9aa5b1", 0.5)
    for k in range(1, round(panel.height / edge)):
        sheet.line(panel.left, panel.top + k * edge, panel.left + panel.width, panel.top + k * edge, "#9aa5b1", 0.5)
    if edge < TEXT_CELL:
        return
    density: Array = grid.density
    per_cell = round(grid.cell_m / found.cover.raster.edge_m)
    for row, column in zip(*np.nonzero(grid.known), strict=True):
        part = seen[row * per_cell : (row + 1) * per_cell, column * per_cell : (column + 1) * per_cell]
        down, right = (float(np.mean(at) + 0.5) * found.cover.raster.edge_m for at in np.nonzero(part))
        x, y = panel.place(grid.west_m + column * grid.cell_m + right, grid.north_m - row * grid.cell_m - down)
        value = float(density[row, column])
        level = int(np.searchsorted(EDGES, value, side="right"))
        text = f"{value:.0f}" if value >= 9.95 or value == 0 else f"{value:.1f}"
        text += "" if grid.sure[row, column] else "?"
        fill = "#ffffff" if level >= 4 else INK
        # Where the cell is seen in shreds, letters would stand on the paper beside them.
        sheet.text(x, y + 4, text, min(14.0, 0.34 * edge), "middle", fill=fill, halo=COLOURS[level])


def _scale_bar(sheet: Drawing, panel: _Panel) -> None:
    wanted = 0.3 * panel.width / panel.per_m
    metres = max((m for m in (0.1, 0.2, 0.5, 1, 2, 5, 10, 20, 50, 100, 200, 500) if m <= wanted), default=0.1)
    length = metres * panel.per_m
    x, y = panel.left + 12, panel.top + panel.height - 14
    sheet.rect(x - 7, y - 24, length + 14, 32, "#ffffff", SOFT, 0.6)
    for k in range(4):
        sheet.rect(x + k * length / 4, y - 4, length / 4, 6, INK if k % 2 == 0 else "#ffffff", INK, 0.8)
    sheet.text(x + length / 2, y - 9, f"{metres:g} m", 13, "middle")


def _north(sheet: Drawing, x: float, y: float) -> None:
    sheet.polygon([(x, y - 22), (x + 7, y - 2), (x, y - 7), (x - 7, y - 2)], INK)
    sheet.text(x - 12, y - 4, "N", 14, "end", bold=True)


def _legends(sheet: Drawing, lefts: tuple[float, float], top: float, found: OysterMap) -> None:
    x = lefts[0]
    for state, name in (
        ("live", "live"),
        ("dead", "dead (boxes, single valves)"),
        ("unknown", "live or dead not told"),
    ):
        if any(one.state == state for one in found.oysters):
            sheet.dot(x + 6, top - 4, 5, STATE_COLOURS[state], INK)
            sheet.text(x + 17, top, name, 13)
            x += 34 + 7.2 * len(name)
    pictures = f"{len(found.path)} of {found.pictures} pictures of {found.camera}, {DEPTHS[found.depth]}"
    sheet.text(lefts[0], top + 26, pictures, 12.5, fill=SOFT)
    sheet.text(lefts[0], top + 44, "What no picture shows, as others lie on it, is not counted.", 12.5, fill=SOFT)
    sheet.text(lefts[0], top + 62, "An oyster that the edge always cuts counts a half.", 12.5, fill=SOFT)
    sheet.text(lefts[0], top + 80, "N is +y of the path.", 12.5, fill=SOFT)
    box = 56.0
    left = lefts[1]
    for k, colour in enumerate(COLOURS):
        sheet.rect(left + k * box, top - 14, box, 16, colour, SOFT, 0.6)
    for k, edge in enumerate((0.0, *EDGES)):
        sheet.text(left + k * box, top + 17, f"{edge:g}", 12.5, "start" if k == 0 else "middle")
    for first, last, name in ((0, 2, "below threshold"), (2, 4, "threshold"), (4, 6, "target")):
        sheet.line(left + first * box + 2, top + 25, left + last * box - 2, top + 25, INK, 1.4)
        sheet.text(left + (first + last) / 2 * box, top + 41, name, 12.5, "middle")
    sheet.text(left, top + 62, "? the 95 % interval reaches into another class.", 12.5, fill=SOFT)
    sheet.text(left, top + 80, "Grey: too little seen.", 12.5, fill=SOFT)
