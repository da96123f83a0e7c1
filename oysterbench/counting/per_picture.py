"""The scale of each picture, from what is given for all of them or for each."""

from __future__ import annotations

import numpy as np

from oysterbench.core.errors import LabelError
from oysterbench.counting.lens import Lens
from oysterbench.counting.run import ScaleOf
from oysterbench.counting.scale import AltitudeScale, PlainScale, QuadratScale, Scale, check_quadrat
from oysterbench.counting.sources import Source
from oysterbench.counting.tables import PictureTable

CORNERS = tuple(f"{axis}{k}" for k in range(1, 5) for axis in "xy")
"""Columns of a table of quadrats: x1, y1, ..., x4, y4 in px of the upright picture."""

ALTITUDE = ("altitude_m",)


def same_for_all(scale: Scale) -> ScaleOf:
    """One scale."""
    return lambda source, name: scale


def plain(mm_per_px: float) -> ScaleOf:
    """Of a length that is known."""
    return same_for_all(PlainScale(mm_per_px))


def quadrats(size_m: float, corners: PictureTable) -> ScaleOf:
    """Of quadrats of one size, whose corners are in a table. Raises OptionError where the size is in another unit, and
    LabelError where all corners are."""
    check_quadrat(size_m)
    if corners.rows and all(0 <= min(row) <= max(row) <= 1 for row in corners.rows.values()):
        name, row = next(iter(corners.rows.items()))
        QuadratScale(size_m, np.reshape(row, (4, 2)), f"{corners.path}: {name}")

    def scale(source: Source, name: str) -> Scale:
        return QuadratScale(
            size_m, np.reshape(_row(corners, source, name, "corners"), (4, 2)), f"{corners.path}: {name}"
        )

    return scale


def altitudes(lens: Lens, altitude: float | PictureTable) -> ScaleOf:
    """Of a calibrated camera that looks straight down; altitude: in m, of all pictures or in a table."""
    if not isinstance(altitude, PictureTable):
        return same_for_all(AltitudeScale(lens, altitude))
    table = altitude

    def scale(source: Source, name: str) -> Scale:
        return AltitudeScale(lens, _row(table, source, name, "altitude")[0])

    return scale


def _row(table: PictureTable, source: Source, name: str, what: str) -> tuple[float, ...]:
    row = table.of(source, name)
    if row is None:
        raise LabelError(f"{name}: {table.path} has no {what} for it, so it was not counted: add a line for it")
    return row
