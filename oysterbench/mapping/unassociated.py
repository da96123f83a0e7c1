"""A count without association: errors of depths and poses make association see further oysters, but not this count.

Every oyster in every image counts 1 / n, where n images saw its place (Horvitz & Thompson 1952, eq. 6): a shell that
depth errors put at two places counts twice in a map, and two halves here. The count is too low where shells hide one
another, as an image that covers a place does not always show what lies there, so it is no better than the map's count
where positions are exact.

This is how intervals account for errors of depth and path: association counts a shell again wherever an error puts it
beside itself, and so is biased upwards; this count is biased downwards, by occlusion; the truth lies between both, as
long as errors move a place by less than images see around it. A path that puts the same ground at two places, an
image's width apart, makes it count twice in both, and nothing in the positions of the images reveals that.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from oysterbench.core.geometry import Array
from oysterbench.mapping.cover import CLOSED_M, Raster, Squares
from oysterbench.mapping.projection import Patch


class UnassociatedCount:
    """The count, updated image by image. raster: that of the map; what was seen is recorded in squares of CLOSED_M."""

    def __init__(self, raster: Raster) -> None:
        self._raster = raster
        self._per_square = max(1, round(CLOSED_M / raster.edge_m))
        self._views = np.zeros((raster.rows // self._per_square + 1, raster.columns // self._per_square + 1), np.uint16)
        self._centres: list[Array] = []

    def add(self, squares: Squares, found: Sequence[Patch]) -> None:
        """Add an image: the raster's squares that it shows, and its oysters. Of those that its edge cuts, half have
        their centre inside."""
        rows, columns = squares
        seen = np.zeros(self._views.shape, dtype=bool)
        seen[rows // self._per_square, columns // self._per_square] = True
        self._views += seen
        self._centres += [np.append(one.centre[:2], 0.5 if one.cut else 1.0) for one in found]

    @property
    def count(self) -> float:
        """Number of oysters."""
        if not self._centres:
            return 0.0
        centres = np.array(self._centres)
        rows, columns, inside = self._raster.index(centres[:, :2])
        views = self._views[rows[inside] // self._per_square, columns[inside] // self._per_square]
        return float((centres[inside, 2] / np.maximum(views, 1)).sum())
