"""Images from untrusted sources, decoded in bounded memory."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

LARGEST_IMAGE_PX = 1 << 26
"""Pixel limit: a file that claims more is no image, and no memory of that size is allocated to find out."""

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
