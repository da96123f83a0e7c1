"""Cache of pages as bytes, ready to be sent: of one revision of the index, evicting the least recently used first."""

from __future__ import annotations

import gzip
import hashlib
from collections import OrderedDict
from collections.abc import Hashable
from dataclasses import dataclass

LEAST_GZIP = 600
"""Size in bytes below which compression saves nothing worth having."""

MOST_BYTES = 96_000_000


@dataclass(frozen=True)
class Kept:
    """A page as it is sent. small: the body compressed with gzip; empty where that is not worth it; tag: its ETag."""

    body: bytes
    media: str
    small: bytes
    tag: str

    @classmethod
    def of(cls, body: bytes, media: str) -> Kept:
        """Compress a page without a timestamp, so that the same page always gives the same bytes."""
        small = gzip.compress(body, 6, mtime=0) if len(body) >= LEAST_GZIP else b""
        return cls(body, media, small, hashlib.sha256(body).hexdigest()[:32])

    @property
    def size(self) -> int:
        """Approximate size in memory, bytes."""
        return len(self.body) + len(self.small) + 500


class PageCache:
    """At most `most_bytes` bytes of pages, all of one revision."""

    def __init__(self, most_bytes: int = MOST_BYTES) -> None:
        self.most_bytes = most_bytes
        self.bytes = 0
        self._revision = ""
        self._pages: OrderedDict[Hashable, Kept] = OrderedDict()

    def __len__(self) -> int:
        return len(self._pages)

    def get(self, revision: str, key: Hashable) -> Kept | None:
        """Return a page, if it is stored and of that revision. A new revision empties the cache."""
        self._turn_to(revision)
        kept = self._pages.get(key)
        if kept is not None:
            self._pages.move_to_end(key)
        return kept

    def put(self, revision: str, key: Hashable, kept: Kept) -> None:
        """Store a page, unless it is of another revision than the stored ones, or larger than the whole cache."""
        if revision != self._revision or kept.size > self.most_bytes:
            return
        old = self._pages.pop(key, None)
        self.bytes += kept.size - (old.size if old else 0)
        self._pages[key] = kept
        while self.bytes > self.most_bytes:
            self.bytes -= self._pages.popitem(last=False)[1].size

    def _turn_to(self, revision: str) -> None:
        if revision != self._revision:
            self._pages.clear()
            self.bytes, self._revision = 0, revision
