"""Named random streams: the only place where random numbers come from.

A stream is keyed by a seed, a secret salt and a name, never by the order in which it is asked for. So a new
sensor changes no other sensor's bytes, and the number of workers changes nothing.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass

import numpy as np

Name = str | int


def stream(seed: int, salt: bytes, *name: Name) -> np.random.Generator:
    """Counter-based generator (Philox 4x64) keyed by BLAKE2b of seed, salt and name.

    Parts of a name are separated and typed, so ("a", 1) and ("a1",) and ("a", "1") are three streams.

    >>> float(stream(1, b"", "scene", "oyster", 17).random()) == float(stream(1, b"", "scene", "oyster", 17).random())
    True
    """
    digest = hashlib.blake2b(key=hashlib.sha256(salt).digest(), digest_size=16)
    for part in (seed, *name):
        text = part.encode() if isinstance(part, str) else str(int(part)).encode()
        kind = b"s" if isinstance(part, str) else b"i"
        digest.update(kind + len(text).to_bytes(4, "little") + text)
    key = np.frombuffer(digest.digest(), dtype="<u8")
    return np.random.Generator(np.random.Philox(key=key))


@dataclass(frozen=True)
class Streams:
    """A branch of the tree of streams: seed and salt of a split, and the names walked so far."""

    seed: int
    salt: bytes = b""
    path: tuple[Name, ...] = ()

    def at(self, *name: Name) -> Streams:
        """The branch below `name`."""
        return Streams(self.seed, self.salt, (*self.path, *name))

    def generator(self, *name: Name) -> np.random.Generator:
        """The stream at `name` of this branch, from its start."""
        return stream(self.seed, self.salt, *self.path, *name)
