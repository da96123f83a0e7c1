"""Camera frames as the bytes of image files, as the sequence stores them, for code that passes them on."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from oysterbench.core.errors import SequenceError
from oysterbench.core.ros import decode
from oysterbench.sensors.camera_messages import COLOUR
from oysterbench.sensors.kind import topic
from oysterbench.sequence.file import DAMAGE, damaged, read_messages
from oysterbench.sequence.read import McapSequence
from oysterbench.sequence.types import Sequence

MEDIA = {"jpeg": "image/jpeg", "png": "image/png"}
"""Format of images in sequences -> media type."""
PNG_LEVEL = 1  # of 9, all of them lossless; the higher ones take four times the time for 5 %


@dataclass(frozen=True)
class EncodedPicture:
    """An encoded camera frame. form: format, a key of MEDIA; data: content of an image file of that format"""

    stamp_ns: int
    form: str
    data: bytes


def encoded_pictures(
    sequence: Sequence, camera: str, start_ns: int | None = None, end_ns: int | None = None
) -> Iterator[EncodedPicture]:
    """Yield the colour frames of a camera with `start_ns <= stamp_ns < end_ns`, in time order: as stored if the
    sequence is a file (.mcap), otherwise as PNG. Raises SequenceError where there is no such camera, or the file is
    damaged."""
    if not isinstance(sequence, McapSequence):
        for image in sequence.images(camera, start_ns, end_ns):
            yield EncodedPicture(image.stamp_ns, "png", png_bytes(image.pixels))
        return
    if camera not in sequence.cameras:
        raise SequenceError(f"{sequence.path}: no camera {camera!r}; cameras: {', '.join(sequence.cameras) or 'none'}")
    for message in read_messages(sequence.path, [topic(camera, "image")], start_ns, end_ns):
        try:
            picture = decode(message.data, COLOUR)
        except DAMAGE as error:
            raise SequenceError(damaged(sequence.path, str(error))) from None
        if picture.format not in MEDIA:
            raise SequenceError(
                damaged(sequence.path, f"expected an image of {' or '.join(MEDIA)}, got {picture.format!s:.20}")
            )
        yield EncodedPicture(message.stamp_ns, picture.format, bytes(np.asarray(picture.data)))


def png_bytes(pixels: NDArray[np.uint8] | NDArray[np.uint16]) -> bytes:
    """Encode (H, W, 3) uint8 RGB, or (H, W) uint8 or uint16, as the bytes of a PNG file. Raises ValueError for other
    arrays."""
    ordered = cv2.cvtColor(pixels, cv2.COLOR_RGB2BGR) if pixels.ndim == 3 else pixels
    done, data = cv2.imencode(".png", ordered, [cv2.IMWRITE_PNG_COMPRESSION, PNG_LEVEL])
    if not done:
        raise ValueError(f"expected an image, got {pixels.dtype} of shape {pixels.shape}")
    return data.tobytes()
