"""Pixel samples of an image topic, at places drawn from the topic's name. They serve to judge a render whose images
resemble the released ones but are not identical, as those of a GPU do."""

from __future__ import annotations

import base64
from typing import Any

import numpy as np
from numpy.typing import NDArray

from oysterbench.core.errors import SequenceError
from oysterbench.core.ros import IMAGE, decode
from oysterbench.core.streams import stream
from oysterbench.sensors.camera_messages import COLOUR, read_colour

FRAMES = 32
"""Maximum number of a topic's frames that are sampled: decoding an image takes some ms."""

NUMBERS = 1024
"""Number of values kept for a topic, each from one channel of a pixel."""

TYPES = {"mono8": "u1", "16UC1": "<u2", "mono16": "<u2", "32FC1": "<f4", "32FC2": "<f4", "32FC3": "<f4"}
"""Encoding of an image -> type of its values."""

LEVEL = {"u1": 1.0, "u2": 257.0, "f4": 1.0 / 255.0}
"""Type of values -> one grey level, 1/255 of the range from black to white."""

LEVEL_OF = {"class": 0.0, "instance": 0.0, "dynamic": 0.0, "depth": 1.0}
"""Layer -> what counts as one grey level there: labels are the same or not, and depth is in mm."""

SHARE = 0.999
"""Fraction of the pixels that have to be within one grey level."""


class Sampler:
    """Collector of a topic's samples while its messages are read. kind: their type; messages: how many there are"""

    def __init__(self, topic: str, kind: str, messages: int) -> None:
        generator = stream(0, b"", "hub", "pixels", topic)
        frames = np.sort(generator.permutation(messages)[:FRAMES])
        share = np.array_split(generator.random((NUMBERS, 3)), len(frames))
        self._places = dict(zip(frames.tolist(), share, strict=True))
        self._kind = kind
        self._found: list[NDArray[Any]] = []

    def see(self, number: int, data: bytes) -> None:
        """Take samples from a message, if its number is among those drawn."""
        places = self._places.get(number)
        if places is None:
            return
        try:
            pixels = np.atleast_3d(read_colour(data)[1] if self._kind == COLOUR else _read_image(data))
        except (SequenceError, ValueError, KeyError):
            return  # not an image: the samples are then too few to match any
        row, column, channel = (places * pixels.shape).astype(int).T
        self._found.append(pixels[row, column, channel])

    def text(self) -> str:
        """Samples as text: their type as NumPy spells it, and their bytes in base64; empty where there are none."""
        if not self._found:
            return ""
        found = np.concatenate(self._found)
        found = found.astype(found.dtype.newbyteorder("<"))
        return f"{found.dtype.str} {base64.b64encode(found.tobytes()).decode()}"


def sampler(topic: str, kind: str, messages: int) -> Sampler | None:
    """Sampler for an image topic; None for other topics."""
    return Sampler(topic, kind, messages) if kind in (COLOUR, IMAGE) else None


def share_within(topic: str, ours: str, theirs: str) -> float:
    """Fraction of a topic's samples that are within one grey level of each other: 1/255 of the range from black to
    white, or a millimetre of depth; labels have to be equal. 0 where type or number of the samples differ."""
    try:
        here, there = _numbers(ours), _numbers(theirs)
    except (ValueError, TypeError):
        return 0.0
    if not len(here) or (here.dtype, here.shape) != (there.dtype, there.shape):
        return 0.0
    within = LEVEL_OF.get(topic.rpartition("/")[2], LEVEL[here.dtype.str[1:]])
    same = (here == there) | ((here != here) & (there != there))  # NaN equals NaN
    return float(np.mean(same | (np.abs(here.astype(np.float64) - there.astype(np.float64)) <= within)))


def _read_image(data: bytes) -> NDArray[Any]:
    """Values (H, W, channels) of an uncompressed image, in its encoding."""
    message = decode(data, IMAGE)
    return np.asarray(message.data).view(TYPES[message.encoding]).reshape(message.height, message.width, -1)


def _numbers(text: str) -> NDArray[Any]:
    kind, _, data = text.partition(" ")
    return np.frombuffer(base64.b64decode(data), dtype=np.dtype(kind))
