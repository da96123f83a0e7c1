"""Changes that know the form of what they change: text, JSON, arrays, pictures."""

from __future__ import annotations

import io
import json
import struct
import zlib
from collections.abc import Callable
from typing import Any, TypeVar

import numpy as np

T = TypeVar("T")
Rng = np.random.Generator

WORDS = (
    "nan",
    "-inf",
    "inf",
    "1e308",
    "-1e308",
    "1e-320",
    "1e999",
    "0",
    "-0",
    "-1",
    "9" * 400,
    "0x1F",
    "1_000",
    "²",
    "١٢",
    "1,5",
    "",
    " ",
    "\t",
    "\0",
    "\ufeff",
    "\u202e",
    "\x1b[2J",
    "\ud7ff",
    "=1+1",
    "#",
    "'",
    '"',
    "true",
    "None",
    "1e5",
    "18446744073709551616",
    "9223372036854775807",
    "-9223372036854775808",
    "1403636579763555584",
    "x" * 5000,
)
NUMBERS = (0, 1, 2, 0xFF, 0x7FFF, 0xFFFF, 1 << 20, (1 << 31) - 1, 1 << 31, (1 << 32) - 1, 1 << 40, 1 << 63)
VALUES: tuple[Any, ...] = (
    None,
    True,
    False,
    0,
    -1,
    1,
    1.5,
    float("nan"),
    float("inf"),
    -float("inf"),
    1e308,
    -1e308,
    1 << 31,
    1 << 64,
    10**400,
    "",
    "x",
    "x" * 3000,
    "\x1b[2J",
    "\u3164",
    "\ud800",
    "<script>",
    "../..",
    [],
    {},
    [[]],
    [None],
    {"": None},
    [0] * 5000,
)
DTYPES = ("?", "|b1", "u1", "i1", "<u2", ">u2", "<i8", ">i8", "<u8", "<f2", "<f4", ">f8", "<f8", "<c16", "U3", "S5")
"""That arrays can be turned into."""
DESCRIPTIONS = (
    "|O",
    "<M8[ns]",
    "<m8[s]",
    "|V8",
    "<f16",
    "|S0",
    "<U0",
    "|V0",
    "<U99999999",
    "[('a', '<f8')]",
    "(" * 200,
    "<f8, <f8",
    "9" * 5000,
    "[('a', '<f8', (1000000000,))]",
    "|S2147483647",
    "__import__('os')",
    "",
    "\ud7ff",
    "<i4\\n",
)
SHAPES = (
    "()",
    "(0,)",
    "(-1,)",
    "(1000000000000,)",
    "(9223372036854775807, 9)",
    "(0, 9223372036854775807)",
    "(1e3,)",
    "(True,)",
    "(48, 64, 1, 1)",
    "[48, 64]",
    "(3,) * 99",
    "(" * 100 + ")" * 100,
    f"({'1, ' * 70})",
    "None",
    "(99999, 99999)",
)


def one(rng: Rng, found: Any) -> Any:
    """One of them."""
    return found[int(rng.integers(len(found)))]


def raw(rng: Rng, data: bytes) -> bytes:
    """Other bytes at a few places, a part less, or a part twice."""
    out = bytearray(data)
    for _ in range(int(rng.integers(1, 6))):
        start, end = sorted(rng.integers(0, len(out) + 1, 2).tolist())
        kind = rng.integers(5)
        if kind == 0:
            new = struct.pack("<Q", one(rng, NUMBERS))[: one(rng, (1, 2, 4, 8))]
            out[start : start + len(new)] = new
        elif kind == 1:
            out[start : start + 1] = rng.bytes(1)
        elif kind == 2:
            del out[start : min(end, start + 200)]
        elif kind == 3:
            out[start:start] = out[start : min(end, start + 200)]
        else:
            del out[max(end, len(out) // 2) :]
    return bytes(out)


def text(rng: Rng, data: bytes) -> bytes:
    """Fields, lines and separators of a table."""
    lines = data.decode("utf-8", "replace").split("\n")
    separator = "," if "," in lines[0] else " "
    for _ in range(int(rng.integers(1, 5))):
        at = 0 if rng.random() < 0.2 else int(rng.integers(len(lines)))
        fields = lines[at].split(separator)
        column = int(rng.integers(len(fields)))
        kind = rng.integers(11)
        if kind < 4:
            fields[column] = one(rng, WORDS)
        elif kind == 4:
            fields.insert(column, one(rng, fields))
        elif kind == 5:
            del fields[column]
        elif kind == 6:
            lines.insert(at, one(rng, lines))
        elif kind == 7:
            lines = [_with(line.split(separator), column, one(rng, WORDS), separator) for line in lines]
        elif kind == 8:
            factor = one(rng, ("e300", "e-300", "e9", "e18", "000000000", "."))
            lines = [
                separator.join(field + factor * (k == column) for k, field in enumerate(line.split(separator)))
                for line in lines
            ]
        elif kind == 9:
            lines = lines * (1 if sum(map(len, lines)) > 100_000 else int(one(rng, (2, 30, 700))))
        else:
            lines = lines[::-1] if rng.random() < 0.5 else lines[: at + 1]
        if kind < 6:
            lines[min(at, len(lines) - 1)] = separator.join(fields)
    end = one(rng, ("\n", "\n", "\n", "\r\n", "\r", "\x0b", "\u2028", "\n\n"))
    encoding = one(rng, ("utf-8",) * 8 + ("utf-16", "utf-8-sig", "utf-32", "cp500"))
    return end.join(lines).encode(encoding, "replace")


def _with(fields: list[str], column: int, word: str, separator: str) -> str:
    return separator.join(word if k == column else field for k, field in enumerate(fields))


def document(rng: Rng, data: bytes) -> bytes:
    """Values, keys and lists of a JSON document, or what only its text can have."""
    value = json.loads(data)
    for step in range(int(rng.integers(1, 4))):
        holder, key = one(rng, _places(value))
        kind = rng.integers(8)
        if kind < 4:
            holder[key] = one(rng, VALUES)
        elif kind == 4:
            del holder[key]
        elif kind == 5:
            holder[key] = [holder[key]] * (1 if step else int(one(rng, (1, 2, 200))))
        elif kind == 6 and isinstance(holder, dict):
            holder[one(rng, WORDS)] = holder.pop(key)
        else:
            holder[key] = _scaled(rng, holder[key])
        if not value:
            break
    made = json.dumps(value)
    if rng.random() < 0.15:
        deep = one(rng, (200, 100_000))
        made = made.replace(
            ": ", one(rng, (": " + "[" * deep, ": " + '{"a":' * deep, ": 1e", ": -", ": 9" + "9" * 5000)), 1
        )
    return made.encode("utf-8", "surrogatepass")


def _places(value: Any) -> list[tuple[Any, Any]]:
    """Where a value stands: each holder, with each of its keys."""
    found: list[tuple[Any, Any]] = []
    waiting = [value]
    while waiting:
        holder = waiting.pop()
        keys = list(holder) if isinstance(holder, dict) else range(min(len(holder), 50))
        found += [(holder, key) for key in keys]
        waiting += [holder[key] for key in keys if isinstance(holder[key], dict | list)]
    return found or [([0], 0)]


def _scaled(rng: Rng, value: Any) -> Any:
    if isinstance(value, bool) or not isinstance(value, int | float):
        return str(value)
    return value * one(rng, (-1, 2, 10, 0.5, 1.0001, 1e300) if abs(value) < 1e300 else (-1, 2, 10))


def npy(rng: Rng, data: bytes) -> bytes:
    """An array: its type, shape, values, or what its header says of them."""
    array = np.load(io.BytesIO(data))
    kind = rng.integers(6)
    if kind == 0:
        with np.errstate(all="ignore"):
            array = np.resize(array, one(rng, ((), (0,), (1,), (48,), (64, 48), (1, 48, 64), (48, 64, 3), (0, 64))))
    elif kind == 1:
        values = array.astype(float).reshape(-1)
        some = rng.integers(0, max(values.size, 1), 1 + values.size // int(one(rng, (1, 10, 1000))))
        values[some % max(values.size, 1)] = one(rng, (np.nan, np.inf, -1.0, 1e308, 2.0, 0.5, 1e20))
        array = values.reshape(array.shape)
    elif kind == 2:
        with np.errstate(all="ignore"):
            array = array.astype(one(rng, DTYPES))
    elif kind == 3 and array.dtype == bool:
        array = rng.integers(0, 256, array.shape, dtype=np.uint8).view(bool)
    out = io.BytesIO()
    np.lib.format.write_array(out, array, allow_pickle=False)
    return _header(rng, out.getvalue()) if kind >= 4 else out.getvalue()


def _header(rng: Rng, data: bytes) -> bytes:
    """Another header before the same values."""
    version, length = data[6], struct.unpack_from("<H", data, 8)[0]
    header, body = data[10 : 10 + length].decode().strip(), data[10 + length :]
    words = {"'descr': '": one(rng, DESCRIPTIONS), "'shape': ": one(rng, SHAPES), "'fortran_order': ": one(rng, WORDS)}
    key = one(rng, list(words))
    start = header.index(key) + len(key)
    stop = {"'descr': '": "'", "'shape': ": "), }", "'fortran_order': ": ","}[key]
    end = header.index(stop, start) + (key == "'shape': ")
    header = header[:start] + words[key] + header[end:]
    encoded = (header + "\n").encode("latin-1", "replace")
    if rng.random() < 0.2:
        version = int(one(rng, (0, 1, 2, 3, 9, 255)))
    claimed = struct.pack("<I" if version in (2, 3) else "<H", min(len(encoded), 65535))
    if rng.random() < 0.2:
        claimed = struct.pack("<I", one(rng, (0, 10, 65535, (1 << 32) - 1)))[: len(claimed)]
    return b"\x93NUMPY" + bytes([version, 0]) + claimed + encoded + body


PNG = b"\x89PNG\r\n\x1a\n"


def png(rng: Rng, data: bytes) -> bytes:
    """A picture: its chunks, with their CRCs made right again, or pixels packed anew."""
    chunks, at = [], len(PNG)
    while at < len(data):
        length = struct.unpack_from(">I", data, at)[0]
        chunks.append((data[at + 4 : at + 8], data[at + 8 : at + 8 + length]))
        at += 12 + length
    kind = rng.integers(7)
    place = int(rng.integers(len(chunks)))
    name, body = chunks[place]
    if kind == 0:
        sizes = struct.pack(">II", *(one(rng, (0, 1, 48, 64, 65, 20_000, 100_000, (1 << 31) - 1)) for _ in range(2)))
        chunks[0] = (b"IHDR", sizes + chunks[0][1][8:])
    elif kind == 1:
        depth, colour, interlace = (int(one(rng, range(9))), int(one(rng, range(8))), int(rng.integers(3)))
        chunks[0] = (b"IHDR", chunks[0][1][:8] + bytes([one(rng, (1, 2, 4, 8, 16, depth)), colour, 0, 0, interlace]))
    elif kind == 2:
        pixels = one(
            rng, (b"", rng.bytes(3000), b"\0" * 20_000_000, b"\x05" * 3120, zlib.decompress(_idat(chunks))[:99])
        )
        chunks = [chunks[0], (b"IDAT", zlib.compress(pixels, 9)), (b"IEND", b"")]
    elif kind == 3:
        chunks.insert(
            place,
            one(
                rng,
                (
                    (b"PLTE", rng.bytes(int(rng.integers(800)))),
                    (b"tRNS", rng.bytes(6)),
                    (b"gAMA", b"\0" * 4),
                    (b"zTXt", b"a\0\0" + zlib.compress(b"\0" * 50_000_000)),
                    (b"iCCP", b"a\0\0" + zlib.compress(b"\0" * 9_000_000)),
                    (b"acTL", rng.bytes(8)),
                    (b"eXIf", rng.bytes(60)),
                    (b"tEXt", b"x" * 100_000),
                    chunks[0],
                ),
            ),
        )
    elif kind == 4:
        del chunks[place]
    elif kind == 5:
        chunks[place] = (name, raw(rng, body))
    else:
        chunks.insert(place, one(rng, chunks))
    out = PNG + b"".join(
        struct.pack(">I", len(body)) + name + body + struct.pack(">I", zlib.crc32(name + body)) for name, body in chunks
    )
    return out[: int(rng.integers(len(out)))] if rng.random() < 0.05 else out


def _idat(chunks: list[tuple[bytes, bytes]]) -> bytes:
    return b"".join(body for name, body in chunks if name == b"IDAT")


BY_SUFFIX: dict[str, Callable[[Rng, bytes], bytes]] = {
    ".tum": text,
    ".txt": text,
    ".csv": text,
    ".json": document,
    ".npy": npy,
    ".png": png,
}
