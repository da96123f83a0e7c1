"""A file of a tree, in the pieces in which it is verified, resumed and fetched."""

from __future__ import annotations

import hashlib
from pathlib import Path
from typing import Annotated

import msgspec

from oysterbench.core.errors import IntegrityError
from oysterbench.hub.canonical import sha256

PIECE = 4 * 1024 * 1024
"""Size of a piece, bytes: the unit of verification, resumption and parallel transfer (a file's last is shorter)."""

PieceSize = Annotated[int, msgspec.Meta(ge=1 << 10, le=1 << 26)]
"""Size of a piece, 1 KiB to 64 MiB."""


class Pieced:
    """A file as documents describe it: its name, size in bytes, SHA-256 of the whole and of each piece."""

    __slots__ = ()

    name: str
    size: int
    sha256: str
    pieces: tuple[str, ...]
    piece_size: int

    def span(self, piece: int) -> tuple[int, int]:
        """Offsets of a piece's first byte, and of the byte after its last."""
        return piece * self.piece_size, min((piece + 1) * self.piece_size, self.size)

    def length(self, piece: int) -> int:
        """Length of a piece, bytes."""
        start, end = self.span(piece)
        return end - start

    def check(self, what: str) -> None:
        """Raise IntegrityError, naming `what`, unless the number of pieces matches the size."""
        if len(self.pieces) != -(-self.size // self.piece_size):
            raise IntegrityError(
                f"{what}: {self.name}: {len(self.pieces)} pieces do not make {self.size} bytes; it was not used"
            )


def hashed(path: Path, piece_size: int = PIECE) -> tuple[int, str, tuple[str, ...]]:
    """Hash a file: size in bytes, SHA-256 of the whole and of each piece."""
    whole = hashlib.sha256()
    pieces = []
    with open(path, "rb") as file:
        while piece := file.read(piece_size):
            whole.update(piece)
            pieces.append(sha256(piece))
        return file.tell(), whole.hexdigest(), tuple(pieces)
