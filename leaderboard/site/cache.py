"""Pages kept as bytes, ready to be sent: of one revision of the index, the longest unused given up first."""

from __future__ import annotations

import gzip
import hashlib
from collections import OrderedDict
from collections.abc import Hashable
from dataclasses import dataclass

LEAST_GZIP = 600
"""Bytes below which compressing saves nothing to speak of."""

MOST_BYTES = 96_000_000


@dataclass(frozen=True)
class Kept:
    """A page as it is sent. small: compressed; empty where that is not worth it."""

    body: bytes
    media: str
    small: bytes
    tag: str

    @classmethod
    def of(cls, body: bytes, media: str) -> Kept:
        """Compressed with no time in it: the same page, the same bytes."""
        small = gzip.compress(body, 6, mtime=0) if len(body) >= LEAST_GZIP else b""
        return cls(body, media, small, hashlib.sha256(body).hexdigest()[:32])

    @property
    def size(self) -> int:
        """Bytes in memory, nearly."""
        return len(self.body) + len(self.small) + 500


class PageCache:
    """At most so many bytes of pages, all of one revision."""

    def __init__(self, most_bytes: int = MOST_BYTES) -> None:
        self.most_bytes = most_bytes
        self.bytes = 0
        self._revision = ""
        self._pages: OrderedDict[Hashable, Kept] = OrderedDict()

    def __len__(self) -> int:
        return len(self._pages)

    def get(self, revision: str, key: Hashable) -> Kept | None:
        """A page, if it is kept and of that revision."""
        self._turn_to(revision)
        kept = self._pages.get(key)
        if kept is not None:
            self._pages.move_to_end(key)
        return kept

    def put(self, revision: str, key: Hashable, kept: Kept) -> None:
        """Keep a page; one that was made of an older revision than is kept now is passed over."""
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
