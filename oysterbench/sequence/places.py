"""Random access to the messages of a sequence file by number, for training, which draws samples at random.

Decompressed chunks are cached up to a number of bytes; no file stays open. So these objects can be pickled, forked and
used in any number of processes, and hold no file descriptor in any of them.
"""

from __future__ import annotations

import os
from collections import OrderedDict
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from oysterbench.core.errors import SequenceError
from oysterbench.core.mcap import message_at, message_places, unpacked_chunk
from oysterbench.sequence.file import DAMAGE, Reading, damaged

CACHE_BYTES = 64 << 20
"""Default size of the chunk cache: 16 chunks of the size in sequence files."""


@dataclass(frozen=True)
class Places:
    """Locations of the messages of a topic: stamps (N,) int64 ns in order, offsets in the file of the chunks that hold
    them (N,) int64, and offsets within those chunks (N,) int64."""

    channel: int
    stamps_ns: NDArray[np.int64]
    chunks: NDArray[np.int64]
    places: NDArray[np.int64]

    def __len__(self) -> int:
        return len(self.stamps_ns)


class Chunks:
    """Cache of the most recently used decompressed chunks of any number of files."""

    def __init__(self, most_bytes: int = CACHE_BYTES) -> None:
        self.most_bytes = most_bytes
        self._kept: OrderedDict[tuple[Path, int], bytes] = OrderedDict()
        self._bytes = 0

    def get(self, file: IndexedFile, offset: int) -> bytes:
        """Records of a chunk, its CRC checked. Raises SequenceError where the file is gone, has changed or is
        damaged."""
        key = (file.path, offset)
        if key in self._kept:
            self._kept.move_to_end(key)
            return self._kept[key]
        data = file.read(offset)
        self._kept[key] = data
        self._bytes += len(data)
        while self._bytes > self.most_bytes and len(self._kept) > 1:
            _, dropped = self._kept.popitem(last=False)
            self._bytes -= len(dropped)
        return data

    def __getstate__(self) -> dict[str, object]:
        return {"most_bytes": self.most_bytes, "_kept": OrderedDict(), "_bytes": 0}


class IndexedFile:
    """A sequence file whose messages on some topics can be read by number.

    topics: those to be indexed; those that the file does not have are left out
    """

    def __init__(self, path: str | os.PathLike[str], topics: Iterable[str], chunks: Chunks | None = None) -> None:
        self.path = Path(path).absolute()
        self._chunks = chunks or Chunks()
        wanted = set(topics)
        self.topics: dict[str, Places] = {}
        with Reading(self.path) as (file, summary):
            self._identity = _identity(os.fstat(file.fileno()))
            for channel in summary.channels.values():
                if channel.topic in wanted:
                    found = [
                        (stamp, index.chunk_start_offset, place)
                        for index in summary.chunk_indexes
                        for stamp, place in message_places(file, index, channel.id)
                    ]
                    assert summary.statistics is not None
                    count = summary.statistics.channel_message_counts.get(channel.id, 0)
                    if len(found) != count:
                        raise ValueError(f"its index names {len(found)} of {count} messages on {channel.topic}")
                    columns = np.array(sorted(found), dtype=np.int64).reshape(-1, 3).T
                    self.topics[channel.topic] = Places(channel.id, *np.ascontiguousarray(columns))

    def __len__(self) -> int:
        return sum(map(len, self.topics.values()))

    def message(self, topic: str, number: int) -> bytes:
        """Data of a message of an indexed topic, by its number in the order of stamps.

        Raises SequenceError where the file is gone, has changed or is damaged.
        """
        known = self.topics[topic]
        data = self._chunks.get(self, int(known.chunks[number]))
        try:
            return message_at(data, int(known.places[number]), known.channel, int(known.stamps_ns[number]))
        except DAMAGE as error:
            raise SequenceError(damaged(self.path, str(error))) from None

    def read(self, offset: int) -> bytes:
        """Read the records of the chunk at an offset, past the cache; its CRC is checked. Raises SequenceError."""
        try:
            with open(self.path, "rb") as file:
                if _identity(os.fstat(file.fileno())) != self._identity:
                    raise SequenceError(f"{self.path}: has changed since it was opened; create the data set again")
                return unpacked_chunk(file, offset)
        except FileNotFoundError:
            raise SequenceError(
                f"{self.path}: no longer exists; it did when the data set was created: render or download it again"
            ) from None
        except SequenceError:
            raise
        except DAMAGE as error:
            raise SequenceError(damaged(self.path, str(error) or type(error).__name__)) from None


def _identity(stat: os.stat_result) -> tuple[int, int]:
    return stat.st_size, stat.st_mtime_ns
