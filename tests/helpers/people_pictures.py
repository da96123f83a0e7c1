"""Pictures and videos as people bring them, with light discs for oysters; and methods that count these."""

from __future__ import annotations

import struct
from pathlib import Path

import cv2
import numpy as np

from oysterbench.methods.images import Detections
from tests.helpers.image_methods import Light

SHAPE = (120, 160)


def discs(*places, shape=SHAPE, radius=10):
    """(H, W, 3) uint8 RGB: dark, with a light disc at each (x, y)."""
    pixels = np.zeros((*shape, 3), np.uint8)
    for place in places:
        cv2.circle(pixels, place, radius, (200, 200, 200), -1)
    return pixels


def write(path, pixels):
    """A picture under a name that OpenCV need not know how to open."""
    path.parent.mkdir(parents=True, exist_ok=True)
    done, data = cv2.imencode(path.suffix, pixels)
    assert done
    path.write_bytes(data.tobytes())
    return path


def turned(data, orientation):
    """The bytes of a JPEG with an EXIF orientation."""
    tag = struct.pack(">HHIHH", 0x0112, 3, 1, orientation, 0)
    exif = b"Exif\0\0MM\0*\0\0\0\x08" + struct.pack(">H", 1) + tag + b"\0\0\0\0"
    return data[:2] + b"\xff\xe1" + struct.pack(">H", len(exif) + 2) + exif + data[2:]


def write_video(path: Path, frames, rate_hz=10.0, codec="MJPG"):
    """An AVI or MP4 of frames (H, W, 3), which all codecs of OpenCV's wheels can write."""
    height, width = SHAPE
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*codec), rate_hz, (width, height))
    assert writer.isOpened()
    for frame in frames:
        writer.write(frame)
    writer.release()
    return path


def boxed(data: bytes, *kinds: bytes, content: bytes) -> bytes:
    """The bytes of an MP4 whose box at the end of a path of kinds has another content."""
    made, at = b"", 0
    while at < len(data):
        length, kind = int.from_bytes(data[at : at + 4], "big"), data[at + 4 : at + 8]
        body = data[at + 8 : at + length]
        if kind == kinds[0]:
            body = boxed(body, *kinds[1:], content=content) if kinds[1:] else content
        made += (len(body) + 8).to_bytes(4, "big") + kind + body
        at += length
    return made


class Discs(Light):
    """Finds discs one by one; those of even number live; `asked` counts the pictures that it was given."""

    name, track = "discs", "detection"
    asked = 0

    def predict(self, image):
        type(self).asked += 1
        count, numbers = cv2.connectedComponents((image.pixels[..., 0] > 120).astype(np.uint8))
        live = (np.arange(count - 1) % 2).astype(float)
        novelty = 2.0 if "strange" in image.name else 0.5
        return Detections(image.name, np.full(count - 1, 0.9), numbers=numbers, live=live, novelty=novelty)


class Overlapping(Light):
    """Two masks, one wholly under the other, and one that is not sure."""

    name, track = "overlapping", "detection"

    def predict(self, image):
        masks = np.zeros((3, *image.pixels.shape[:2]), bool)
        masks[0, 40:60, 40:60] = True
        masks[1, 30:80, 30:80] = True
        masks[2, :5, :5] = True
        return Detections(image.name, np.array([0.6, 0.9, 0.3]), masks=masks)


class FailsOnDark(Discs):
    """Cannot do with a picture that shows nothing."""

    name = "fails_on_dark"

    def predict(self, image):
        if not image.pixels.any():
            raise ZeroDivisionError("no contrast")
        return super().predict(image)
