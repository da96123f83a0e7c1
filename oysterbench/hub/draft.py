"""The start of a piece, which a process that is killed leaves to the next one.

Each connection keeps the piece that it is fetching in memory and, as it grows, in its own file next to the part:
`<part>.<own>.draft`, which starts with which piece it holds and how much of it. Bytes whose hash is not yet known stay
out of the part, where another process may already have put the right ones. The content of a draft is never trusted:
the piece is hashed once complete, and fetched completely if the hash is wrong.
"""

from __future__ import annotations

import contextlib
import glob
import os
import secrets
import struct
from collections.abc import Iterator
from pathlib import Path

from oysterbench.hub.pieces import Pieced

HEADER = struct.Struct("<qq")
"""Number of the piece, number of its bytes that follow."""


class Draft:
    """The piece that one connection is fetching."""

    def __init__(self, part: Path, entry: Pieced) -> None:
        self._entry = entry
        self._path = part.with_name(f"{part.name}.{secrets.token_hex(4)}.draft")
        self._file = os.open(self._path, os.O_RDWR | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, 0o666)
        self._on_disk = True
        self._buffer = memoryview(bytearray(min(entry.piece_size, entry.size)))
        self._view = self._buffer[:0]
        self._piece = 0
        self.filled = 0
        """Number of the piece's bytes that are there."""
        self.inherited = False
        """Whether its start is from another process, so that no mirror here is to blame for it."""

    @property
    def there(self) -> memoryview:
        """Bytes of the piece that are there, uint8."""
        return self._view[: self.filled]

    @property
    def free(self) -> memoryview:
        """Buffer for its next bytes; empty once it is complete."""
        return self._view[self.filled :]

    def begin(self, piece: int, on_disk: bool = True) -> None:
        """Discard what is there, and start a piece. on_disk: keep its bytes for the next process."""
        self._piece, self._on_disk = piece, on_disk
        self._view = self._buffer[: self._entry.length(piece)]
        self.clear()

    def inherit(self, left: Path) -> None:
        """Continue from the start of this piece that another process left."""
        with contextlib.suppress(FileNotFoundError), open(left, "rb") as file:
            piece, filled = _read_header(file.read(HEADER.size))
            if piece == self._piece:
                # Of a complete piece, take all but one byte, so that there is always something to request.
                n = file.readinto(self._view[: min(filled, len(self._view) - 1)])
                self.add(n)
                self.inherited = n > 0
        left.unlink(missing_ok=True)

    def add(self, n: int) -> None:
        """Account for `n` bytes put into `free`. A process that is killed meanwhile leaves what was there before."""
        start, self.filled = self.filled, self.filled + n
        if self._on_disk:
            write_all(self._file, self._view[start : self.filled], HEADER.size + start)
            self._write_header()

    def clear(self) -> None:
        """Discard what there is of the piece."""
        self.filled, self.inherited = 0, False
        self._write_header()

    def close(self) -> None:
        """Close the file; what there is of a piece is left to the next process."""
        os.close(self._file)
        if not (self.filled and self._on_disk):
            self._path.unlink(missing_ok=True)

    def _write_header(self) -> None:
        write_all(self._file, memoryview(HEADER.pack(self._piece, self.filled if self._on_disk else 0)), 0)


def write_all(file: int, data: memoryview, offset: int) -> None:
    """Write at an offset of a file, with as many calls as it takes."""
    while data:
        n = os.pwrite(file, data, offset)
        offset, data = offset + n, data[n:]


def _read_header(data: bytes) -> tuple[int, int]:
    """Piece of a draft and number of its bytes; (-1, 0) where the header is not valid."""
    piece, filled = HEADER.unpack(data) if len(data) == HEADER.size else (-1, 0)
    return (piece, filled) if piece >= 0 and filled > 0 else (-1, 0)


def _files(part: Path) -> Iterator[Path]:
    return part.parent.glob(f"{glob.escape(part.name)}.*.draft")


def drafts_left(part: Path) -> dict[int, Path]:
    """Drafts that other processes left next to a part: piece -> the file that has most of it. Others are deleted."""
    found = []
    for path in _files(part):
        with contextlib.suppress(FileNotFoundError), open(path, "rb") as file:
            piece, filled = _read_header(file.read(HEADER.size))
            found.append((filled, piece, path))
    left: dict[int, Path] = {}
    for filled, piece, path in sorted(found, reverse=True):
        if filled and piece not in left:
            left[piece] = path
        else:
            path.unlink(missing_ok=True)
    return left


def remove_drafts(part: Path) -> None:
    """Delete all drafts next to a part."""
    for path in _files(part):
        path.unlink(missing_ok=True)
