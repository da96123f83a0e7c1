"""A file of a tree, in the pieces that it is verified, resumed and fetched by."""

from __future__ import annotations

import hashlib
from pathlib import Path
from typing import Annotated

import msgspec

from oysterbench.core.errors import IntegrityError
from oysterbench.hub.canonical import sha256

PIECE = 4 * 1024 * 1024
"""Bytes of a piece, the unit of verification, resumption and parallel transfer (the last of a file is shorter)."""

PieceSize = Annotated[int, msgspec.Meta(ge=1 << 10, le=1 << 26)]
"""1 KiB to 64 MiB."""


class Pieced:
    """What documents say of a file: its name, size in bytes, SHA-256 of the whole and of each piece."""

    __slots__ = ()

    name: str
    size: int
    sha256: str
    pieces: tuple[str, ...]
    piece_size: int

    def span(self, piece: int) -> tuple[int, int]:
        """First byte of a piece, and the byte behind its last."""
        return piece * self.piece_size, min((piece + 1) * self.piece_size, self.size)

    def length(self, piece: int) -> int:
        """Bytes of a piece."""
        start, end = self.span(piece)
        return end - start

    def check(self, what: str) -> None:
        """Raise IntegrityError, naming `what`, unless so many pieces make so many bytes."""
        if len(self.pieces) != -(-self.size // self.piece_size):
            raise IntegrityError(
                f"{what}: {self.name}: {len(self.pieces)} pieces do not make {self.size} bytes; it was not used"
            )


def hashed(path: Path, piece_size: int = PIECE) -> tuple[int, str, tuple[str, ...]]:
    """Size of a file in bytes, SHA-256 of the whole and of each piece."""
    whole = hashlib.sha256()
    pieces = []
    with open(path, "rb") as file:
        while piece := file.read(piece_size):
            whole.update(piece)
            pieces.append(sha256(piece))
        return file.tell(), whole.hexdigest(), tuple(pieces)
