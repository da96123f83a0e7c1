"""Rasters as GeoTIFF in a local metric frame (OGC 19-008r4, GeoTIFF 1.1): they open in QGIS and GDAL at the right scale
and relative position; their position on the Earth is unknown."""

from __future__ import annotations

import io
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

PIXEL_SCALE, TIEPOINT, KEYS, TEXTS, NO_DATA = 33550, 33922, 34735, 34737, 42113
"""TIFF tags: ModelPixelScale, ModelTiepoint, GeoKeyDirectory, GeoAsciiParams; and GDAL's tag for no-data values."""
MODEL_TYPE, RASTER_TYPE, CITATION, PROJECTED_UNITS = 1024, 1025, 1026, 3076
"""Keys in the GeoKeyDirectory."""
USER_DEFINED, PIXEL_IS_AREA, METRE = 32767, 1, 9001
"""Values of keys: a model that is in no register; pixels are areas, not points; EPSG code of the metre."""
DOUBLE, SHORT, ASCII = 12, 3, 2
"""Field types of TIFF 6.0."""


@dataclass(frozen=True)
class Place:
    """Position of a raster in the frame of a path.

    west_m, north_m: outer corner of its first pixel; edge_m: edge of a pixel; about: description of the frame, in ASCII
    """

    west_m: float
    north_m: float
    edge_m: float
    about: str


def geotiff(bands: NDArray[Any], place: Place, names: Sequence[str] = ()) -> bytes:
    """Encode a raster (rows, columns, bands) as GeoTIFF: float32 with NaN as no data, or uint8 RGB and alpha.

    names: of the bands. Raises ModuleNotFoundError without tifffile.
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
    """GeoKeyDirectory tags: a user-defined model in metres, with a citation."""
    text = f"{about}|"
    entries = (
        (MODEL_TYPE, 0, 1, USER_DEFINED),
        (RASTER_TYPE, 0, 1, PIXEL_IS_AREA),
        (CITATION, TEXTS, len(text), 0),
        (PROJECTED_UNITS, 0, 1, METRE),
    )
    directory = (1, 1, 1, len(entries), *(value for entry in entries for value in entry))
    return [(KEYS, SHORT, len(directory), directory, True), (TEXTS, ASCII, 0, text, True)]
