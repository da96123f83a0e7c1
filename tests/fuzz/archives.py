"""Zip archives with other names, more entries, or headers that lie."""

from __future__ import annotations

import io
import struct
import warnings
import zipfile

from tests.fuzz.mutations import NUMBERS, Rng, one

NAMES = (
    "../{}",
    "/{}",
    "{}/",
    "{}.exe",
    "{}\0",
    "{}\n",
    "\u202e{}",
    "C:{}",
    "\\\\host\\{}",
    "a/{}",
    "{}{}",
    "",
    "\x1b[2J{}",
    "é{}",
)


def archive(rng: Rng, files: dict[str, bytes]) -> bytes:
    """A zip archive of files, with other names, more of them, or headers that lie."""
    entries = list(files.items())
    kind = rng.integers(8)
    place = int(rng.integers(len(entries)))
    name, data = entries[place]
    if kind == 0:
        entries[place] = (one(rng, NAMES).format(name, name), data)
    elif kind == 1:
        entries.append((one(rng, entries)[0], data))
    elif kind == 2:
        entries.append((name, zipped([(name, data)])))
    elif kind == 3:
        del entries[place]
    elif kind == 4:
        entries += [(f"{k}{name}", b"") for k in range(int(one(rng, (3, 3000))))]
    elif kind == 5:
        entries[place] = (name, one(rng, (b"\0" * 60_000_000, b"", b"0" * 5_000_000, b"\n" * 1_000_000)))
    packing = one(rng, (zipfile.ZIP_DEFLATED,) * 6 + (zipfile.ZIP_STORED, zipfile.ZIP_BZIP2, zipfile.ZIP_LZMA))
    out = zipped(entries, packing)
    return _lying(rng, out) if kind >= 6 else out


def _lying(rng: Rng, data: bytes) -> bytes:
    """Other numbers in a header of an entry, in the directory or at the end."""
    magic = one(rng, (b"PK\x03\x04", b"PK\x01\x02", b"PK\x01\x02", b"PK\x05\x06"))
    places = [at for at in range(len(data)) if data.startswith(magic, at)]
    out = bytearray(data)
    at = one(rng, places) + int(rng.integers(4, {b"PK\x03\x04": 30, b"PK\x01\x02": 46}.get(magic, 22)))
    new = struct.pack("<Q", one(rng, NUMBERS))[: one(rng, (1, 2, 4))]
    out[at : at + len(new)] = new
    return bytes(out)


def zipped(entries: list[tuple[str, bytes]], packing: int = zipfile.ZIP_DEFLATED) -> bytes:
    """A zip archive, which may have a name twice."""
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w", packing) as made, warnings.catch_warnings(action="ignore"):
        for name, data in entries:
            info = zipfile.ZipInfo("x")
            info.filename = name
            info.compress_type = packing
            made.writestr(info, data)
    return out.getvalue()
