"""Rows of named numbers as sensor_msgs/PointCloud2, and back."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from oysterbench.sequence.names import CLOUD
from oysterbench.sequence.wire import decode, encode, header, make, stamp_of

_DATATYPES = {"i1": 1, "u1": 2, "i2": 3, "u2": 4, "i4": 5, "u4": 6, "f4": 7, "f8": 8}
"""Type of a number -> PointField's constant."""

_KINDS = {code: kind for kind, code in _DATATYPES.items()}


def points_bytes(stamp_ns: int, frame: str, rows: NDArray[Any]) -> bytes:
    """An unordered cloud (height 1) from a structured array (N,), its fields and their offsets as they are."""
    offsets: Any = rows.dtype.fields
    fields = [
        make(
            "sensor_msgs/msg/PointField",
            name=name,
            offset=offsets[name][1],
            datatype=_DATATYPES[rows.dtype[name].str[1:]],
            count=1,
        )
        for name in rows.dtype.names or ()
    ]
    xyz = np.stack([rows[axis] for axis in "xyz"])
    message = make(
        CLOUD,
        header=header(stamp_ns, frame),
        height=1,
        width=len(rows),
        fields=fields,
        is_bigendian=False,
        point_step=rows.dtype.itemsize,
        row_step=rows.dtype.itemsize * len(rows),
        data=np.frombuffer(rows.tobytes(), dtype=np.uint8),
        is_dense=bool(np.isfinite(xyz).all()),
    )
    return encode(message)


def read_points(data: bytes) -> tuple[int, NDArray[Any]]:
    """Stamp and structured array (N,) of a cloud. Raises ValueError where sizes do not fit."""
    message = decode(data, CLOUD)
    kind = np.dtype(
        {
            "names": [field.name for field in message.fields],
            "formats": ["<" + _KINDS[field.datatype] for field in message.fields],
            "offsets": [field.offset for field in message.fields],
            "itemsize": message.point_step,
        }
    )
    rows = np.frombuffer(np.asarray(message.data).tobytes(), dtype=kind)
    if len(rows) != message.height * message.width:
        raise ValueError(f"a cloud of {message.height} x {message.width} points holds {len(rows)}")
    return stamp_of(message.header), rows
