"""Pictures of anybody's making, decoded in bounded memory."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

LARGEST_IMAGE_PX = 1 << 26
"""What claims to be larger is no image: nothing of that size is made to find out."""

# OpenCV reads this once, as it is loaded, which it is nowhere before this module; its own limit is 16 times as much.
os.environ.setdefault("OPENCV_IO_MAX_IMAGE_PIXELS", str(LARGEST_IMAGE_PX))


def decode_picture(data: bytes | NDArray[np.uint8], flags: int) -> NDArray[Any] | None:
    """(H, W) or (H, W, 3) of the bytes of an image file, by OpenCV's flags; None where it is none, or too large."""
    import cv2
    import numpy as np

    try:
        return cv2.imdecode(np.frombuffer(data, dtype=np.uint8), flags) if len(data) else None
    except cv2.error:
        return None
