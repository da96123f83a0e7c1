"""Scale of each image, from values given for all images or for each one."""

from __future__ import annotations

import numpy as np

from oysterbench.core.errors import LabelError
from oysterbench.counting.lens import Lens
from oysterbench.counting.run import ScaleOf
from oysterbench.counting.scale import AltitudeScale, PlainScale, QuadratScale, Scale, check_quadrat
from oysterbench.counting.sources import Source
from oysterbench.counting.tables import PictureTable

CORNERS = tuple(f"{axis}{k}" for k in range(1, 5) for axis in "xy")
"""Columns of a table of quadrats: x1, y1, ..., x4, y4 in px of the upright image."""

ALTITUDE = ("altitude_m",)


def same_for_all(scale: Scale) -> ScaleOf:
    """Use one scale for all images."""
    return lambda source, name: scale


def plain(mm_per_px: float) -> ScaleOf:
    """Use a known size of a pixel, in mm, for all images."""
    return same_for_all(PlainScale(mm_per_px))


def quadrats(size_m: float, corners: PictureTable) -> ScaleOf:
    """Scale each image by a quadrat of one size, whose corners are in a table. Raises OptionError if the size seems to
    be in another unit, and LabelError if all corners are fractions of the image's size."""
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
    """Scale each image by the altitude of a calibrated camera that looks straight down; altitude: in m, for all images
    or in a table."""
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
