"""Files of random bytes, as a manifest names them; and patience that fits a test."""

from __future__ import annotations

import random
from dataclasses import replace
from pathlib import Path

from oysterbench.hub.canonical import sha256
from oysterbench.hub.draft import Draft, drafts_left
from oysterbench.hub.manifest import FileEntry
from oysterbench.hub.part import Part
from oysterbench.hub.sources import Patience, open_source
from oysterbench.hub.transfer import Mirror, Transfer

CALM = Patience(attempts=4, first_wait_s=0.001, longest_wait_s=0.01, least_bytes=1000)
"""For servers that answer, however busy the machine is: nothing is asked for twice because it came late."""

IMPATIENT = replace(CALM, connect_s=2.0, idle_s=0.2, window_s=0.15)
"""For servers that are silent or trickle."""


def blob(size: int, seed: int = 0, piece_size: int = 1 << 14) -> tuple[bytes, FileEntry]:
    """Random bytes and their entry."""
    data = random.Random(seed).randbytes(size)
    pieces = tuple(sha256(data[k : k + piece_size]) for k in range(0, size, piece_size))
    return data, FileEntry("dive-01.mcap", size, sha256(data), pieces, {}, {}, 0, piece_size)


def fetch(
    entry: FileEntry, target: Path, places: list[str], patience: Patience = CALM, connections: int = 4
) -> list[Mirror]:
    """Fetch a blob from mirrors to a file, as `download` does."""
    mirrors = [Mirror(open_source(place, connections, patience)) for place in places]
    part = Part(target.with_suffix(".part"), entry)
    try:
        Transfer(part, mirrors, connections, patience, lambda n: None).fetch(range(len(entry.pieces)))
        part.install(target)
    finally:
        part.close()
    return mirrors


def beginnings(part: Path, entry: FileEntry, data: bytes) -> tuple[int, bool]:
    """Bytes that the next download need not fetch of the pieces under way, and whether some of them are wrong."""
    begun, wrong = 0, False
    opened = Part(part, entry)
    for piece, left in drafts_left(part).items():
        if opened.is_right(piece):  # killed between writing it and clearing the draft
            continue
        copy = left.read_bytes()
        draft = Draft(part, entry)
        draft.begin(piece, on_disk=False)
        draft.inherit(left)
        start = entry.span(piece)[0]
        wrong |= bytes(draft.there) != data[start : start + draft.filled]
        begun += draft.filled
        draft.close()
        left.write_bytes(copy)  # inheriting takes it away
    opened.close()
    return begun, wrong
