"""The beginning of a piece, which a process that is killed leaves to the next one.

Each connection keeps the piece that it fetches in memory and, as it grows, in a file of its own beside the part:
`<part>.<own>.draft`, which says first which piece it holds and how much of it. Bytes whose hash is not known yet stay
out of the part, where another process may have put the right ones already. What a draft says is believed by nobody: the
piece is hashed when it is whole, and fetched whole if the hash is wrong.
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
"""Number of the piece, bytes of it that follow."""


class Draft:
    """The piece that one connection fetches."""

    def __init__(self, part: Path, entry: Pieced) -> None:
        self._entry = entry
        self._path = part.with_name(f"{part.name}.{secrets.token_hex(4)}.draft")
        self._file = os.open(self._path, os.O_RDWR | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, 0o644)
        self._on_disk = True
        self._buffer = memoryview(bytearray(min(entry.piece_size, entry.size)))
        self._view = self._buffer[:0]
        self._piece = 0
        self.filled = 0
        """Bytes of the piece that are there."""
        self.inherited = False
        """Whether its beginning is another process's, so that nobody here is to blame for it."""

    @property
    def there(self) -> memoryview:
        """What there is of the piece, uint8."""
        return self._view[: self.filled]

    @property
    def free(self) -> memoryview:
        """Where its next bytes go; nothing once it is whole."""
        return self._view[self.filled :]

    def begin(self, piece: int, on_disk: bool = True) -> None:
        """Forget what there is, and start a piece. on_disk: keep what comes of it for the next process."""
        self._piece, self._on_disk = piece, on_disk
        self._view = self._buffer[: self._entry.length(piece)]
        self.clear()

    def inherit(self, left: Path) -> None:
        """Go on from the beginning that another process left of this piece."""
        with contextlib.suppress(FileNotFoundError), open(left, "rb") as file:
            piece, filled = _read_header(file.read(HEADER.size))
            if piece == self._piece:
                # Of a whole piece all but one byte, so that there is always something to ask for.
                n = file.readinto(self._view[: min(filled, len(self._view) - 1)])
                self.add(n)
                self.inherited = n > 0
        left.unlink(missing_ok=True)

    def add(self, n: int) -> None:
        """So many bytes were put into `free`. A process that is killed on the way leaves what was there before."""
        start, self.filled = self.filled, self.filled + n
        if self._on_disk:
            write_all(self._file, self._view[start : self.filled], HEADER.size + start)
            self._write_header()

    def clear(self) -> None:
        """Forget what there is of the piece."""
        self.filled, self.inherited = 0, False
        self._write_header()

    def close(self) -> None:
        """Let go of the file; what there is of a piece is left to the next process."""
        os.close(self._file)
        if not (self.filled and self._on_disk):
            self._path.unlink(missing_ok=True)

    def _write_header(self) -> None:
        write_all(self._file, memoryview(HEADER.pack(self._piece, self.filled if self._on_disk else 0)), 0)


def write_all(file: int, data: memoryview, offset: int) -> None:
    """Write at a place of a file, however many calls it takes."""
    while data:
        n = os.pwrite(file, data, offset)
        offset, data = offset + n, data[n:]


def _read_header(data: bytes) -> tuple[int, int]:
    """Piece and bytes of a draft; none of any piece where it does not say so."""
    piece, filled = HEADER.unpack(data) if len(data) == HEADER.size else (-1, 0)
    return (piece, filled) if piece >= 0 and filled > 0 else (-1, 0)


def _files(part: Path) -> Iterator[Path]:
    return part.parent.glob(f"{glob.escape(part.name)}.*.draft")


def drafts_left(part: Path) -> dict[int, Path]:
    """What other processes left beside a part, piece -> the file that has most of it. The others are deleted."""
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
    """Delete all drafts beside a part."""
    for path in _files(part):
        path.unlink(missing_ok=True)
