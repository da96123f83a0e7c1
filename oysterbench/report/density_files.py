"""The map as files: rasters with world files, tables, a summary, a figure, a page."""

from __future__ import annotations

import json
import math
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np

from oysterbench.core.files import write_atomically
from oysterbench.core.html import environment
from oysterbench.mapping.intervals import LEVEL
from oysterbench.mapping.settings import CLASSES, TARGET_PER_M2, THRESHOLD_PER_M2
from oysterbench.mapping.survey import OysterMap
from oysterbench.report.density_figure import density_pixels, figure, mosaic, numbers
from oysterbench.report.figures import encoded, png_of, svg_of
from oysterbench.report.formats import csv_of
from oysterbench.report.renderers.html import FOLDER
from oysterbench.results.records import plain

FORMAT = "oysterbench-map/1"


def write_map(found: OysterMap, folder: Path, command: str = "") -> list[Path]:
    """Write all files of a map; returns them. Rasters lie in the world frame of the trajectory, m, +y up."""
    seen = found.cover.closed()
    drawn = figure(found)
    svg = svg_of(drawn)
    world = world_file(found)
    clear = np.where(found.cover.views > 0, 255, 0).astype(np.uint8)
    files: dict[str, bytes] = {
        "map.html": map_page(found, svg, command).encode(),
        "map.png": png_of(drawn),
        "map.svg": svg.encode(),
        "summary.json": (json.dumps(summary(found), indent=2, allow_nan=False) + "\n").encode(),
        "grid.csv": csv_of(list(grid_rows(found))).encode(),
        "oysters.csv": csv_of(list(oyster_rows(found))).encode(),
        "mosaic.png": encoded(np.dstack([mosaic(found, seen), clear])),
        "mosaic.pgw": world,
        "density.png": encoded(density_pixels(found, seen)),
        "density.pgw": world,
    }
    folder.mkdir(parents=True, exist_ok=True)
    for name, data in files.items():
        write_atomically(folder / name, data)
    return [folder / name for name in files]


def world_file(found: OysterMap) -> bytes:
    """Six lines of a world file: size of a pixel, and where the middle of the first one lies (ESRI)."""
    raster = found.cover.raster
    half = raster.edge_m / 2
    values = (raster.edge_m, 0.0, 0.0, -raster.edge_m, raster.west_m + half, raster.north_m - half)
    return "".join(f"{value:.10g}\n" for value in values).encode()


def grid_rows(found: OysterMap) -> Iterable[dict[str, Any]]:
    """A line per cell of which anything was seen; no number where too little was."""
    grid = found.grid
    for row, column in zip(*np.nonzero(grid.area_m2 > 0), strict=True):
        at = (row, column)
        known = bool(grid.known[at])
        yield {
            "west_m": round(grid.west_m + float(column) * grid.cell_m, 6),
            "south_m": round(grid.north_m - float(row + 1) * grid.cell_m, 6),
            "cell_m": grid.cell_m,
            "seen_m2": round(float(grid.area_m2[at]), 4),
            **{state: float(counts[at]) for state, counts in grid.counts.items()},
            "live_per_m2": round(float(grid.density[at]), 3) if known else "",
            "low_per_m2": round(float(grid.low[at]), 3) if known else "",
            "high_per_m2": round(float(grid.high[at]), 3) if known else "",
            "class": CLASSES[int(grid.classes[at])] if known else "",
            "class_sure": ("yes" if grid.sure[at] else "no") if known else "",
        }


def oyster_rows(found: OysterMap) -> Iterable[dict[str, Any]]:
    """A line per oyster."""
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
    """What is known of the whole, for JSON; null where there is no number."""
    total, grid, north = found.total, found.grid, found.magnetic_north_rad
    made: dict[str, Any] = plain(
        {
            "format": FORMAT,
            "sequence": found.name,
            "camera": found.camera,
            "depth": found.depth,
            "pictures": found.pictures,
            "pictures_without_pose": found.without_pose,
            "pictures_without_depth": found.without_depth,
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
            "live_per_m2": {
                "mean": total.live_per_m2,
                "low": total.low_per_m2,
                "high": total.high_per_m2,
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


def map_page(found: OysterMap, drawn: str, command: str) -> str:
    """The figure, what it says in words, how it is made, and what it does not know."""
    context = {
        "title": f"Oysters of {found.name}",
        "notes": found.notes,
        "figure": drawn,
        "numbers": numbers(found.total, found.grid.shares()),
        "command": command,
    }
    return environment(FOLDER).get_template("map.html").render(**context)
