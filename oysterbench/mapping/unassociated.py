"""A count that associates nothing: what depths and poses err by, association takes for other oysters; this does not.

Every oyster of every picture counts 1 / n, where n pictures saw its place (Horvitz & Thompson 1952, eq. 6): shells that
depths lay at two places are two in a map, and two halves here. It is low where shells hide one another, for a picture
that looks at a place does not always show what lies there, and so no better than the map's where places are exact.

This is the model by which intervals hold what depth and path err by: association counts a shell again wherever an error
lays it beside itself, and so errs upwards; this count errs downwards, by what hides; the truth lies between both, as
long as an error moves a place by less than pictures see around it. A path that lays the same ground at two places, a
picture's width apart, makes two grounds of it for either count, and nothing in the pictures' places shows that.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from oysterbench.core.geometry import Array
from oysterbench.mapping.cover import CLOSED_M, Raster, Squares
from oysterbench.mapping.projection import Patch


class UnassociatedCount:
    """The count, as pictures come in. raster: of the map; squares of CLOSED_M of it are seen or not."""

    def __init__(self, raster: Raster) -> None:
        self._raster = raster
        self._per_square = max(1, round(CLOSED_M / raster.edge_m))
        self._views = np.zeros((raster.rows // self._per_square + 1, raster.columns // self._per_square + 1), np.uint16)
        self._centres: list[Array] = []

    def add(self, squares: Squares, found: Sequence[Patch]) -> None:
        """A picture: the raster's squares that it shows, and its oysters. Of those that its edge cuts, half have their
        middle inside."""
        rows, columns = squares
        seen = np.zeros(self._views.shape, dtype=bool)
        seen[rows // self._per_square, columns // self._per_square] = True
        self._views += seen
        self._centres += [np.append(one.centre[:2], 0.5 if one.cut else 1.0) for one in found]

    @property
    def count(self) -> float:
        """So many oysters."""
        if not self._centres:
            return 0.0
        centres = np.array(self._centres)
        rows, columns, inside = self._raster.index(centres[:, :2])
        views = self._views[rows[inside] // self._per_square, columns[inside] // self._per_square]
        return float((centres[inside, 2] / np.maximum(views, 1)).sum())
