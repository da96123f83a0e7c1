"""Images from untrusted sources, decoded in bounded memory."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

LARGEST_IMAGE_PX = 1 << 26
"""Pixel limit: a file that claims more is no image, and no memory of that size is allocated to find out."""

FEW = 32
"""Labels have at most so many different colours, and photographs have more."""
SAMPLE_PX = 100_000
"""So many evenly spaced pixels of an image are looked at to count its colours."""

# OpenCV reads this once, when it is loaded, and nothing loads it before this module; its own limit is 16 times larger.
os.environ.setdefault("OPENCV_IO_MAX_IMAGE_PIXELS", str(LARGEST_IMAGE_PX))


def decode_picture(data: bytes | NDArray[np.uint8], flags: int) -> NDArray[Any] | None:
    """Decode the bytes of an image file to (H, W) or (H, W, 3), by OpenCV's flags; None if it is no image, or too
    large."""
    import cv2
    import numpy as np

    try:
        return cv2.imdecode(np.frombuffer(data, dtype=np.uint8), flags) if len(data) else None
    except cv2.error:
        return None


def has_few_colours(pixels: NDArray[Any]) -> bool:
    """Whether an image of any shape (H, W, ...) has as few colours as labels have."""
    import numpy as np

    colours = pixels.reshape(pixels.shape[0] * pixels.shape[1], -1)
    return len(np.unique(colours[:: 1 + len(colours) // SAMPLE_PX], axis=0)) <= FEW


def upper_bits(pixels: NDArray[np.uint16]) -> NDArray[np.uint8]:
    """Upper 8 of the bits that an image of any shape uses: 8, or those of a camera stored in 16: 10, 12, 14 or 16.
    Taken as 16 bits, an image of 12 bits would be almost black. The bits are those of this image alone: a darker one of
    the same camera may use fewer, and becomes brighter.

    >>> import numpy as np
    >>> upper_bits(np.array([0, 2048, 4095], np.uint16)), upper_bits(np.array([0, 255], np.uint16))
    (array([  0, 128, 255], dtype=uint8), array([  0, 255], dtype=uint8))
    """
    import numpy as np

    return (pixels >> (used_bits(int(pixels.max(initial=0))) - 8)).astype(np.uint8)


def used_bits(most: int) -> int:
    """Bits of a camera whose brightest value is `most`: 8, 10, 12, 14 or 16."""
    bits = most.bit_length()
    return max(8, bits + bits % 2)


def jpeg_end(data: bytes) -> int:
    """Offset of the end marker of a JPEG after its first scan; -1 if there is none. A thumbnail may have an end marker
    before it, and cameras may append data after it, so that it need not be at the end of the file."""
    at = 2
    while at + 4 <= len(data) and data[at] == 0xFF:
        kind = data[at + 1]
        if kind == 0xFF:  # fill
            at += 1
            continue
        at += 2 + int.from_bytes(data[at + 2 : at + 4], "big")
        if kind == 0xDA:
            return data.find(b"\xff\xd9", at)
    return -1
