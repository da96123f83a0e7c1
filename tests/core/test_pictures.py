"""Pictures are decoded where they are no larger than any that there is."""

from __future__ import annotations

import struct
import zlib

import cv2
import numpy as np

from oysterbench.core.pictures import decode_picture


def test_a_picture_that_claims_more_than_any_has_is_refused():
    done, coded = cv2.imencode(".png", np.zeros((4, 4, 3), np.uint8))
    assert done
    data = bytearray(coded.tobytes())
    data[16:24] = struct.pack(">II", 1 << 14, 1 << 13)
    data[29:33] = struct.pack(">I", zlib.crc32(data[12:29]))
    assert decode_picture(coded, cv2.IMREAD_COLOR).shape == (4, 4, 3)
    for wrong in (bytes(data), b"", b"no picture"):
        assert decode_picture(wrong, cv2.IMREAD_COLOR) is None
