"""Rasters as GeoTIFF in a local frame of metres (OGC 19-008r4, GeoTIFF 1.1): they open in QGIS and GDAL at their scale
and beside one another; where on the Earth they lie nobody knows."""

from __future__ import annotations

import io
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

PIXEL_SCALE, TIEPOINT, KEYS, TEXTS, NO_DATA = 33550, 33922, 34735, 34737, 42113
"""Tags: ModelPixelScale, ModelTiepoint, GeoKeyDirectory, GeoAsciiParams; and GDAL's for what has no value."""
MODEL_TYPE, RASTER_TYPE, CITATION, PROJECTED_UNITS = 1024, 1025, 1026, 3076
"""Keys: of them in the directory."""
USER_DEFINED, PIXEL_IS_AREA, METRE = 32767, 1, 9001
"""Values: a model that no register has; pixels are squares, not points; EPSG's metre."""
DOUBLE, SHORT, ASCII = 12, 3, 2
"""Types of TIFF 6.0."""


@dataclass(frozen=True)
class Place:
    """Where a raster lies in the frame of a path.

    west_m, north_m: of the outer corner of its first pixel; edge_m: of a pixel; about: what the frame is, in ASCII
    """

    west_m: float
    north_m: float
    edge_m: float
    about: str


def geotiff(bands: NDArray[Any], place: Place, names: Sequence[str] = ()) -> bytes:
    """A raster (rows, columns, bands) as GeoTIFF: float32, whose NaN is no data, or uint8 of RGB and alpha.

    names: of the bands. Needs tifffile; ModuleNotFoundError without it.
    """
    import tifffile

    file = io.BytesIO()
    colours = bands.dtype == np.uint8
    extra: list[tuple[int, int, int, Any, bool]] = [
        (PIXEL_SCALE, DOUBLE, 3, (place.edge_m, place.edge_m, 0.0), True),
        (TIEPOINT, DOUBLE, 6, (0.0, 0.0, 0.0, place.west_m, place.north_m, 0.0), True),
        *_keys(place.about),
    ]
    if not colours:
        extra.append((NO_DATA, ASCII, 0, "nan", True))
    tifffile.imwrite(
        file,
        bands if colours else np.moveaxis(bands.astype(np.float32), -1, 0),
        photometric="rgb" if colours else "minisblack",
        extrasamples=("unassalpha",) if colours else None,
        planarconfig="contig" if colours else "separate",
        compression="zlib",
        metadata=None,
        description=", ".join(names),
        software="oysterbench",
        extratags=extra,
    )
    return file.getvalue()


def _keys(about: str) -> list[tuple[int, int, int, Any, bool]]:
    """The directory of geographic keys: a user-defined model in metres, with a citation."""
    text = f"{about}|"
    entries = (
        (MODEL_TYPE, 0, 1, USER_DEFINED),
        (RASTER_TYPE, 0, 1, PIXEL_IS_AREA),
        (CITATION, TEXTS, len(text), 0),
        (PROJECTED_UNITS, 0, 1, METRE),
    )
    directory = (1, 1, 1, len(entries), *(value for entry in entries for value in entry))
    return [(KEYS, SHORT, len(directory), directory, True), (TEXTS, ASCII, 0, text, True)]
