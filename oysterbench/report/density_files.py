"""Files of a map: rasters with world files, tables, a summary, a figure, a page."""

from __future__ import annotations

import importlib.util
import json
import math
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from oysterbench.core.atomic import write_atomically
from oysterbench.core.html import environment
from oysterbench.evaluate.density.restoration import RESTORATION_CLASSES, TARGET_PER_M2, THRESHOLD_PER_M2
from oysterbench.evaluate.statistics import LEVEL
from oysterbench.mapping.survey import OysterMap
from oysterbench.report.density_figure import density_pixels, figure, mosaic, notes, numbers, panels, titles
from oysterbench.report.figures import encoded, png_of, svg_of
from oysterbench.report.formats import csv_of
from oysterbench.report.geotiff import Place, geotiff
from oysterbench.report.renderers.html import FOLDER
from oysterbench.results.records import plain

BANDS = ("low_per_m2", "high_per_m2", "seen_m2")
"""Bands of density.tif, in order, after the density itself (`density_name`)."""

FILES = {
    "grid.csv": "cells with counts, intervals and classes",
    "oysters.csv": "every oyster with its position",
    "summary.json": "totals, with the settings",
    "density.tif": "cells as GeoTIFF: density, " + ", ".join(BANDS),
    "mosaic.tif": "the seen ground, from above, as GeoTIFF",
    "density.png": "cells as an image, with density.pgw",
    "mosaic.png": "the seen ground as an image, with mosaic.pgw",
    "map.png": "both figures, for a document",
    "map.svg": "the same, scalable",
}
"""Files beside the page, with descriptions."""

FORMAT = "oysterbench-map/1"


def write_map(found: OysterMap, folder: Path, command: str = "") -> list[Path]:
    """Write all files of a map and return their paths. Rasters are in the world frame of the trajectory, m, +y up;
    GeoTIFFs are written only if tifffile is installed."""
    seen = found.cover.closed()
    drawn = figure(found)
    world = world_file(found)
    clear = np.where(found.cover.views > 0, 255, 0).astype(np.uint8)
    colours = np.dstack([mosaic(found, seen), clear])
    files: dict[str, bytes] = {
        "map.png": png_of(drawn),
        "map.svg": svg_of(drawn).encode(),
        "summary.json": (json.dumps(summary(found), indent=2, allow_nan=False) + "\n").encode(),
        "grid.csv": csv_of(list(grid_rows(found))).encode(),
        "oysters.csv": csv_of(list(oyster_rows(found))).encode(),
        **geotiffs(found, colours),
        "mosaic.png": encoded(colours),
        "mosaic.pgw": world,
        "density.png": encoded(density_pixels(found, seen)),
        "density.pgw": world,
    }
    files = {"map.html": map_page(found, command, list(files)).encode(), **files}
    folder.mkdir(parents=True, exist_ok=True)
    for name, data in files.items():
        write_atomically(folder / name, data)
    return [folder / name for name in files]


def geotiffs(found: OysterMap, colours: NDArray[np.uint8]) -> dict[str, bytes]:
    """GeoTIFFs of the mosaic (rows, columns, 4) and of the grid with one pixel per cell; none if tifffile is not
    installed."""
    if importlib.util.find_spec("tifffile") is None:
        return {}
    raster, grid = found.cover.raster, found.grid
    frame = f"local frame of the path of {found.name}: x, y in metres, not on the Earth".encode(
        "ascii", "replace"
    ).decode()
    bands = np.dstack([np.where(grid.known, band, np.nan) for band in (grid.density, grid.low, grid.high)])
    seen = np.where(grid.area_m2 > 0, grid.area_m2, np.nan)
    return {
        "mosaic.tif": geotiff(colours, Place(raster.west_m, raster.north_m, raster.edge_m, frame)),
        "density.tif": geotiff(
            np.dstack([bands, seen]),
            Place(grid.west_m, grid.north_m, grid.cell_m, frame),
            (density_name(found), *BANDS),
        ),
    }


def density_name(found: OysterMap) -> str:
    """Name of the density: of live oysters or, if no state is known, of all oysters."""
    return "live_per_m2" if found.total.told else "oysters_per_m2"


def world_file(found: OysterMap) -> bytes:
    """The six lines of an ESRI world file: pixel size, and position of the centre of the first pixel."""
    raster = found.cover.raster
    half = raster.edge_m / 2
    values = (raster.edge_m, 0.0, 0.0, -raster.edge_m, raster.west_m + half, raster.north_m - half)
    return "".join(f"{value:.10g}\n" for value in values).encode()


def grid_rows(found: OysterMap) -> Iterable[dict[str, Any]]:
    """One row per cell of which anything was seen; without densities where too little was seen."""
    grid, density = found.grid, density_name(found)
    for row, column in zip(*np.nonzero(grid.area_m2 > 0), strict=True):
        at = (row, column)
        known = bool(grid.known[at])
        yield {
            "west_m": round(grid.west_m + float(column) * grid.cell_m, 6),
            "south_m": round(grid.north_m - float(row + 1) * grid.cell_m, 6),
            "cell_m": grid.cell_m,
            "seen_m2": round(float(grid.area_m2[at]), 4),
            **{state: float(counts[at]) for state, counts in grid.counts.items()},
            density: round(float(grid.density[at]), 3) if known else "",
            "low_per_m2": round(float(grid.low[at]), 3) if known else "",
            "high_per_m2": round(float(grid.high[at]), 3) if known else "",
            "class": RESTORATION_CLASSES[int(grid.classes[at])] if known else "",
            "class_sure": ("yes" if grid.sure[at] else "no") if known else "",
        }


def oyster_rows(found: OysterMap) -> Iterable[dict[str, Any]]:
    """One row per oyster."""
    for k, one in enumerate(found.oysters, start=1):
        yield {
            "id": k,
            **{f"{axis}_m": round(float(value), 4) for axis, value in zip("xyz", one.centre, strict=True)},
            "state": one.state,
            "views": one.views,
            "weight": one.weight,
            "doubt": round(one.doubt, 3),
            "score": round(one.score, 3),
        }


def summary(found: OysterMap) -> dict[str, Any]:
    """Summary of the whole map, for JSON; null where there is no number."""
    total, grid, north = found.total, found.grid, found.magnetic_north_rad
    made: dict[str, Any] = plain(
        {
            "format": FORMAT,
            "sequence": found.name,
            "camera": found.camera,
            "depth": found.depth,
            "images": found.images,
            "images_without_pose": found.without_pose,
            "images_without_depth": found.without_depth,
            "seen_m2": total.area_m2,
            "magnetic_north_deg": None if north is None else math.degrees(north) % 360.0,  # clockwise from +y
            "oysters": {
                "count": total.count,
                "low": total.count_low,
                "high": total.count_high,
                "live": total.live,
                "dead": total.dead,
                "unknown": total.unknown,
                "entries": len(found.oysters),
                "cut": sum(one.weight < 1.0 for one in found.oysters),
            },
            "states_known": total.told,  # if not, all oysters count for the classes
            density_name(found): {
                "mean": total.live_per_m2,
                "low": total.low_per_m2,
                "high": total.high_per_m2,
                "interval_of": "reef" if total.of_reef else "seen ground",
                "block_m": total.block_m,
                "clumping_k": total.clumping_k,
            },
            "level": LEVEL,
            "classes": {
                "edges_per_m2": [THRESHOLD_PER_M2, TARGET_PER_M2],
                "shares_of_area": grid.shares(),
                "cells": int(grid.known.sum()),
                "cells_sure": int(grid.sure.sum()),
            },
            "notes": list(found.notes),
            "settings": found.settings.as_dict(),
        }
    )
    return made


def map_page(found: OysterMap, command: str, files: Sequence[str] = ()) -> str:
    """HTML page of a map: the figures, the same in words, the files beside it, the command, and the limitations."""
    context = {
        "title": f"Oysters of {found.name}",
        "warnings": found.notes,
        "names": [found.name],
        "panels": list(zip(titles(found), map(svg_of, panels(found)), strict=True)),
        "facts": facts(found),
        "numbers": numbers(found.total, found.grid.shares()),
        "notes": notes(found),
        "open": found.unassociated is not None,
        "of_reef": found.total.of_reef,
        "files": [(name, FILES[name]) for name in FILES if name in files],
        "command": command,
    }
    return environment(FOLDER).get_template("map.html").render(**context)


def facts(found: OysterMap) -> list[tuple[str, str, str]]:
    """Name, number, and its interval or a remark, of each key fact."""
    total = found.total
    rows = [("Oysters", f"{total.count:,.0f}", f"95 %: {total.count_low:,.0f} to {total.count_high:,.0f}")]
    if not math.isnan(total.live_per_m2):
        of = "reef" if total.of_reef else "seen ground alone"
        between = f"95 % for the {of}: {total.low_per_m2:.1f} to {total.high_per_m2:.1f}"
        what = "Live per" if total.told else "Live or dead, per"
        rows.append((f"{what} m\N{SUPERSCRIPT TWO}", f"{total.live_per_m2:.1f}", between))
    rows.append(("Seen ground", f"{total.area_m2:.1f} m\N{SUPERSCRIPT TWO}", f"in {len(found.path)} images"))
    return [(name, value.replace(",", " "), small.replace(",", " ")) for name, value, small in rows]
