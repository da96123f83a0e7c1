"""Edit lists of MP4 and MOV files (ISO 14496-12, 8.6.6): which part of the stored frames is shown.

A video trimmed without encoding it again keeps the frames from the last keyframe on, and hides those before its start.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO

LARGEST_INDEX = 1 << 26
"""Maximum size of an index (moov) to read, bytes: that of a day at 60 Hz has a few MB."""


def shown_share(path: Path) -> float:
    """Share of a video's duration that its edit list shows; 1 without an edit list, or if it cannot be read."""
    try:
        with open(path, "rb") as file:
            index = _index(file)
        (movie_hz, _), *_ = map(_clock, _find(index, b"mvhd"))
        for track in _find(index, b"trak"):
            if [handler[8:12] for handler in _find(track, b"mdia", b"hdlr")] == [b"vide"]:
                (media_hz, stored), *_ = map(_clock, _find(track, b"mdia", b"mdhd"))
                shown = [duration for edits in _find(track, b"edts", b"elst") for duration in _durations(edits)]
                # A duration of 0 lasts to the end.
                return min(1.0, sum(shown) / movie_hz / (stored / media_hz)) if all(shown) and shown else 1.0
    except (ValueError, struct.error, ZeroDivisionError):
        pass
    return 1.0


def _index(file: BinaryIO) -> bytes:
    """Content of the box moov; empty if there is none."""
    while len(head := file.read(8)) == 8:
        length, kind, size = int.from_bytes(head[:4], "big"), head[4:], 8
        if length == 1:
            length, size = int.from_bytes(file.read(8), "big"), 16
        if kind == b"moov" and length <= LARGEST_INDEX:
            return file.read(max(0, length - size))
        if length < size:  # 0: to the end of the file
            break
        file.seek(length - size, 1)
    return b""


def _find(data: bytes, kind: bytes, *inner: bytes) -> Iterator[bytes]:
    """Yield the content of each box of a kind, or of those of further kinds in it."""
    at = 0
    while at + 8 <= len(data):
        length = int.from_bytes(data[at : at + 4], "big")
        if length < 8:
            return
        if data[at + 4 : at + 8] == kind:
            content = data[at + 8 : at + length]
            yield from _find(content, *inner) if inner else (content,)
        at += length


def _clock(header: bytes) -> tuple[int, int]:
    """Ticks per second and duration in ticks, of a header of the movie or of a track's media."""
    rate, duration = (
        struct.unpack_from(">IQ", header, 20) if header[:1] == b"\1" else struct.unpack_from(">II", header, 12)
    )
    return rate, duration


def _durations(edits: bytes) -> Iterator[int]:
    """Duration of each edit in ticks of the movie, except of empty ones, which only delay what follows."""
    entry = struct.Struct(">QqI" if edits[:1] == b"\1" else ">IiI")
    (count,) = struct.unpack_from(">I", edits, 4)
    for duration, start, _ in entry.iter_unpack(edits[8 : 8 + count * entry.size]):
        if start >= 0:
            yield duration
