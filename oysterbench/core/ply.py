"""Point clouds as binary PLY, which every point cloud viewer opens."""

from __future__ import annotations

import os
from typing import Any

import numpy as np
from numpy.typing import NDArray

from oysterbench.core.atomic import write_atomically
from oysterbench.core.errors import OysterbenchError

TYPES = {"<f4": "float", "<f8": "double", "|u1": "uchar", "<u2": "ushort", "<i4": "int"}
"""Type of a field -> its name in the header."""
END = b"end_header\n"


def write_ply(path: str | os.PathLike[str], rows: NDArray[Any], comment: str) -> None:
    """Write a structured array (N,) as the vertices of a binary PLY, one property per field; atomically."""
    properties = [f"property {TYPES[rows.dtype[name].str]} {name}" for name in rows.dtype.names or ()]
    header = ["ply", "format binary_little_endian 1.0", f"comment {comment}", f"element vertex {len(rows)}"]
    write_atomically(path, "\n".join([*header, *properties, ""]).encode() + END + rows.tobytes())


def read_ply(path: str | os.PathLike[str]) -> NDArray[Any]:
    """Read the vertices (N,) of a file written by `write_ply`, one field per property. Raises OysterbenchError for any
    other."""
    with open(path, "rb") as file:
        data = file.read()
    header, found, body = data.partition(END)
    words = [line.split() for line in header.decode("latin-1").splitlines()]
    elements = [line for line in words if line[:1] == ["element"]]
    names = {name: key for key, name in TYPES.items()}
    properties = [line[1:] for line in words if line[:1] == ["property"]]
    if (
        not found
        or ["format", "binary_little_endian", "1.0"] not in words
        or [line[1] for line in elements] != ["vertex"]
        or not all(len(line) == 2 and line[0] in names for line in properties)
    ):
        raise OysterbenchError(f"{path}: expected vertices in a binary little-endian PLY, got another file")
    kind = np.dtype([(name, names[type_]) for type_, name in properties])
    count = int(elements[0][2])
    if len(body) != count * kind.itemsize:
        raise OysterbenchError(f"{path}: expected {count} vertices of {kind.itemsize} bytes, got {len(body)} bytes")
    return np.frombuffer(body, dtype=kind)
