"""Storage for the tiles of a dive's images until it is known where they lie."""

from __future__ import annotations

import contextlib
import tempfile
import zlib
from collections.abc import Iterator
from contextlib import AbstractContextManager

import numpy as np

from oysterbench.mapping.cover import Raster, Tile

LEVEL = 1  # of zlib: distances and colours of neighbours are similar, and higher levels gain little


class Tiles(AbstractContextManager["Tiles"]):
    """Any number of tiles, 0.1 to 0.3 MB each, in an unnamed file in the folder TMPDIR: the file disappears when it is
    closed, or when its process ends in any way."""

    def __init__(self) -> None:
        self.rasters: list[Raster] = []
        self._sizes: list[int] = []
        self._file = tempfile.TemporaryFile(prefix="oysterbench-")  # noqa: SIM115

    def add(self, tile: Tile) -> None:
        """Add a tile. Raises OSError where the disk is full."""
        parts = (np.packbits(tile.seen), tile.distances_m, tile.colours)
        packed = zlib.compress(b"".join(part.tobytes() for part in parts), LEVEL)
        with _named():
            self._file.write(packed)
        self.rasters.append(tile.raster)
        self._sizes.append(len(packed))

    def __iter__(self) -> Iterator[Tile]:
        """Yield the tiles in the order in which they were added."""
        with _named():
            self._file.seek(0)
        for raster, size in zip(self.rasters, self._sizes, strict=True):
            data = np.frombuffer(zlib.decompress(self._file.read(size)), dtype=np.uint8)
            squares = raster.rows * raster.columns
            bits, rest = np.split(data, [-(-squares // 8)])
            seen = np.unpackbits(bits, count=squares).astype(bool).reshape(raster.rows, raster.columns)
            distances_m, colours = np.split(rest, [8 * int(seen.sum())])
            yield Tile(raster, seen, distances_m.view(np.float64), colours.reshape(-1, 3))

    def __exit__(self, *_: object) -> None:
        with contextlib.suppress(OSError):  # data that a full disk could not take
            self._file.close()


@contextlib.contextmanager
def _named() -> Iterator[None]:
    """Add the folder to errors of the file, as it has no name."""
    try:
        yield
    except OSError as error:
        raise OSError(error.errno, error.strerror, tempfile.gettempdir()) from error
